"""How strongly predictions depend on controls: the paper's reason why a fed-back trajectory does not explode.

Paper section 5.5, "Where and how to input the control signals": derivatives of the output by the controls around 150
exploded within a few frames, those around 4 did not. The norm is not given there; here it is the largest singular
value of the Jacobian at the last frame of a window, in normalised units.
"""

from __future__ import annotations

import torch

from motionkit.data.dataset import Dataset
from motionkit.lab.held_out import HeldOut
from motionkit.lab.paper.batched_rollouts import recorded
from motionkit.lab.statistics import rounded
from motionkit.models.network import PartTransformer
from motionkit.models.predictor import Predictor


def control_derivatives(network: Predictor, dataset: Dataset, sequence: HeldOut) -> dict[str, float]:
    """Return the gain of the predicted trajectory on the trajectory fed in, and on the features fed in.

    Of part transformers only; other networks return nothing.
    """
    if not isinstance(network, PartTransformer):
        return {}
    device = network.aggregate.weight.device
    whole = recorded(dataset, sequence.clip, sequence.data, network.config.controls)
    given, contacts, shown = (
        torch.tensor(each[None, : sequence.initial], device=device)
        for each in (whole.x, whole.contacts, whole.controls)
    )
    given.requires_grad_()
    shown.requires_grad_()
    with torch.backends.cudnn.flags(enabled=False):  # recurrent layers have no gradients in evaluation mode
        made = network(given, contacts, shown).trajectory_mean[0, -1]
        rows = [torch.autograd.grad(value, (given, shown), retain_graph=True) for value in made]
    by_features = torch.stack([row[0][0, -1] for row in rows])
    by_trajectory = torch.stack([row[1][0, -1, network.given_trajectory] for row in rows])
    return {
        name: rounded(torch.linalg.matrix_norm(matrix, 2).item())
        for name, matrix in (("trajectory", by_trajectory), ("features", by_features))
    }
