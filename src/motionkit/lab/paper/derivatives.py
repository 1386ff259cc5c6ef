"""How strongly predictions depend on controls: the paper's reason why a fed-back trajectory does not explode.

Paper section 5.5, "Where and how to input the control signals": derivatives of the output by the controls around 150
exploded within a few frames, those around 4 did not. The norm is not given there; here it is the largest singular
value of the Jacobian at the last frame of a window, in normalised units.
"""

from __future__ import annotations

import numpy as np
import torch

from motionkit.data.dataset import Dataset
from motionkit.features.control import control_vector, skeleton_signal
from motionkit.lab.held_out import HeldOut
from motionkit.lab.paper.protocol import sequence_controls
from motionkit.lab.statistics import rounded
from motionkit.models.model import MotionModel
from motionkit.models.network import PartTransformer


def control_derivatives(model: MotionModel, dataset: Dataset, sequence: HeldOut) -> dict[str, float]:
    """Return the gain of the predicted trajectory on the trajectory fed in, and on the features fed in.

    Of part transformers only; other networks return nothing.
    """
    if model.config.architecture != "part-transformer":
        return {}
    network = PartTransformer.from_weights(model.network)
    frames = slice(0, sequence.initial)
    x = model.scaling.normalize(sequence.data.features[frames])
    asked = sequence_controls(dataset, sequence, model).at(frames)
    skeleton = skeleton_signal(dataset.skeleton(sequence.clip))
    controls = control_vector(
        model.controls, skeleton, asked, x, model.trajectory_scaling, model.reference_map
    )
    given = torch.tensor(x[None].astype(np.float32), requires_grad=True)
    shown = torch.tensor(controls[None].astype(np.float32), requires_grad=True)
    contacts = torch.tensor(sequence.data.contacts[None, frames])
    made = network(given, contacts, shown).trajectory_mean[0, -1]
    rows = [torch.autograd.grad(value, (given, shown), retain_graph=True) for value in made]
    by_features = torch.stack([row[0][0, -1] for row in rows])
    by_trajectory = torch.stack([row[1][0, -1, model.controls.trajectory] for row in rows])
    return {
        name: rounded(torch.linalg.matrix_norm(matrix, 2).item())
        for name, matrix in (("trajectory", by_trajectory), ("features", by_features))
    }
