"""Inputs the network made itself: what it will meet in a roll-out, and recordings do not show.

In training every input frame is real, in a roll-out none is. A network that is slightly too slow on real
frames is slower on its own, and in the end stands still. Here part of the windows is run frame by frame:
the prediction becomes the next input, until by chance, or because it is too far off, the real frame takes
over again. The target stays the real next frame, so the network learns the way back (cf. Bengio et al. 2015,
"Scheduled Sampling"). The runs must be short: against the real frame of a motion whose rhythm has been
lost, the best guess is the mean pose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from motionkit.features.reference import REFERENCE_COUNT
from motionkit.models.network import PartTransformer
from motionkit.models.stream import NetworkStream
from motionkit.training.losses import Batch


@dataclass(frozen=True)
class ScheduledSamplingOptions:
    """How windows feed on themselves. With share 0 none does."""

    share: float = 0.4  # of the windows
    period: int = 16  # steps whose windows are run together, with the weights at their beginning
    back: float = 0.08  # probability per frame of going back to the real one
    limit: float = 0.5  # RMS of the normalised error beyond which the real frame takes over
    # The same with a reference, which keeps the rhythm, so that the runs can be long.
    reference_back: float = 0.02
    reference_limit: float = 1.0
    temperature: float = 0.2  # of the noise on predictions, correlated in time as in synthesis
    rho: float = 0.95


@torch.no_grad()
def run_on_predictions(
    network: PartTransformer,
    batch: Batch,
    options: ScheduledSamplingOptions,
    generators: list[torch.Generator],
    reference_matrix: Tensor,
) -> Batch:
    """A batch whose inputs and contacts are, in short runs, predictions of the network.

    Guides are shown as seen from these predictions; reference_matrix (276, 72) is that of the ReferenceMap.

    Each window has its own generator, so that it does not matter which windows are run together. Frames at
    which the real frame takes over do not count in the losses: the step between them and the frame before
    is none that a body takes.
    """
    was_training = network.training
    network.eval()
    B, T, F = batch.inputs.shape
    device = batch.inputs.device
    stream = NetworkStream(network, B)
    inputs, contacts, mask = batch.inputs.clone(), batch.contacts.clone(), batch.mask.clone()
    controls = batch.controls.clone()
    shown = slice(network.control_size - 1 - REFERENCE_COUNT, network.control_size - 1)
    own = torch.zeros(B, dtype=torch.bool, device=device)
    fresh = torch.stack([torch.randn(T, F, generator=g) for g in generators]).to(device)
    reference_gain = batch.controls[..., network.control_size - 1] > 0
    back = torch.where(reference_gain, options.reference_back, options.back)
    limit = torch.where(reference_gain, options.reference_limit, options.limit)
    stays = torch.stack([torch.rand(T, generator=g) for g in generators]).to(device) >= back
    noise, rho = fresh[:, 0], options.rho
    for t in range(T - 1):
        made = stream.step(inputs[:, t], contacts[:, t], controls[:, t])
        noise = rho * noise + (1.0 - rho * rho) ** 0.5 * fresh[:, t]
        frame = made.mean + options.temperature * noise * torch.exp(made.log_sigma)
        error = (frame - batch.targets[:, t]).square().mean(dim=-1).sqrt()
        now = stays[:, t] & (error < limit[:, t])
        mask[:, t + 1] *= ~(own & ~now)
        chosen = now[:, None]
        moved = torch.where(chosen, frame - inputs[:, t + 1], 0.0)
        inputs[:, t + 1] += moved
        controls[:, t + 1, shown] -= reference_gain[:, t + 1, None] * (moved @ reference_matrix)
        contacts[:, t + 1] = torch.where(chosen, torch.sigmoid(made.contact_logits), contacts[:, t + 1])
        own = now
    network.train(was_training)
    return replace(batch, inputs=inputs, contacts=contacts, controls=controls, mask=mask)


def join_batches(batches: list[Batch]) -> Batch:
    """One batch of all windows, in order."""
    names = vars(batches[0])
    return Batch(**{name: torch.cat([getattr(b, name) for b in batches]) for name in names})


def take_windows(batch: Batch, indices: list[int] | slice) -> Batch:
    """Some windows of a batch."""
    return Batch(**{name: value[indices] for name, value in vars(batch).items()})


def sampled_windows(first: int, count: int, share: float) -> list[int]:
    """Which of the windows first to first + count of a step feed on themselves, counted from first."""
    return [i for i in range(count) if int((first + i + 1) * share) > int((first + i) * share)]
