"""PFNN, the phase-functioned neural network of Holden et al. 2017, on the features and controls of the paper's network.

Three layers of 512 with ELU, whose weights follow the phase of the gait along a cyclic Catmull-Rom spline with four
control points; dropout keeps 0.7; the mean absolute weight counts 0.01. The phase is that of footsteps: it is 0 where
the left foot touches down and half a turn where the right one does. It is made for gaits; where nobody steps it rests.
Shape legend: B batch, T frames, N rows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from motionkit.arrays import Array
from motionkit.features.layout import FEATURE_COUNT
from motionkit.lab.networks.baseline import (
    OUTPUTS,
    BaselineConfig,
    ExpertLayers,
    masked_mean,
    prediction_losses,
    split_outputs,
)
from motionkit.models.batch import Batch, FeatureSpace
from motionkit.models.predictor import NextFrame, Predictor

CONTROL_POINTS = 4
TURN = 2.0 * math.pi
USUAL_RATE = TURN / 60.0  # phase per frame before the first and after the last footstep of a window


@dataclass(frozen=True)
class PhaseFunctionedConfig(BaselineConfig):
    """Sizes of the network; the defaults are those of its paper."""

    architecture: str = "pfnn"
    hidden: int = 512
    dropout: float = 0.3
    weight_l1: float = 0.01


def spline_shares(phase: Tensor) -> Tensor:
    """Return the shares (N, 4) of the control points in the weights at phases (N,): Catmull-Rom, cyclic."""
    place = CONTROL_POINTS * torch.remainder(phase, TURN) / TURN
    first, t = place.floor().long() % CONTROL_POINTS, (place % 1.0)[:, None]
    powers = torch.cat([torch.ones_like(t), t, t * t, t * t * t], dim=1)
    spline = 0.5 * powers.new_tensor([[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]])
    shares = powers @ spline  # of the points before, at, after, and two after
    around = (first[:, None] + torch.arange(-1, 3, device=phase.device)) % CONTROL_POINTS
    return torch.zeros_like(shares).scatter_add_(1, around, shares)


def gait_phase(contacts: Array) -> Array:
    """Return the phase (T,) in radians, not wrapped, of contacts (T, 4) of left foot and toe, right foot and toe."""
    frames = np.arange(len(contacts))
    events: list[tuple[int, float]] = []
    for side, half in ((slice(0, 2), 0.0), (slice(2, 4), math.pi)):
        down = contacts[:, side].max(axis=1) > 0.5
        events += [(int(t), half) for t in np.flatnonzero(down[1:] & ~down[:-1]) + 1]
    if not events:
        return np.zeros(len(contacts))
    events.sort()
    phases = [events[0][1]]
    for _, next_phase in events[1:]:  # the next time this foot's phase comes up
        ahead = (next_phase - phases[-1]) % TURN
        phases.append(phases[-1] + (ahead if ahead > 1e-6 else TURN))
    times = [t for t, _ in events]
    inside = np.interp(frames, times, phases)
    before = np.minimum(frames - times[0], 0) * USUAL_RATE
    return inside + before + np.maximum(frames - times[-1], 0) * USUAL_RATE


class PhaseFunctionedNetwork(Predictor):
    """Features, controls and a phase in, the next features and the step of the phase out."""

    config: PhaseFunctionedConfig
    config_class = PhaseFunctionedConfig

    def __init__(self, config: PhaseFunctionedConfig, control_size: int) -> None:
        super().__init__(config, control_size)
        sizes = (FEATURE_COUNT + control_size, config.hidden, config.hidden, OUTPUTS + 1)
        self.layers = ExpertLayers(CONTROL_POINTS, pairwise(sizes))

    def run(self, x: Tensor, controls: Tensor, phase: Tensor) -> tuple[NextFrame, Tensor]:
        """Return the prediction and the step of the phase (...) in units of USUAL_RATE."""
        shape, shares = x.shape[:-1], spline_shares(phase.reshape(-1))
        out = torch.cat([x, controls], dim=-1).reshape(-1, FEATURE_COUNT + self.control_size)
        out = self.layers(out, shares, dropout=self.config.dropout)
        out = out.reshape(*shape, OUTPUTS + 1)
        return split_outputs(out[..., :-1]), out[..., -1].float()

    def losses(self, batch: Batch, space: FeatureSpace, progress: float) -> dict[str, Tensor]:
        """Return squared errors, those of the phase's steps, and the mean absolute weight."""
        steps = torch.cat([batch.contacts, batch.next_contacts[:, -1:]], dim=1).cpu().numpy()
        phase = torch.tensor(np.stack([gait_phase(each) for each in steps]), dtype=torch.float32)
        phase = phase.to(batch.inputs.device)
        made, turn = self.run(batch.inputs, batch.controls, phase[:, :-1])
        target = (phase[:, 1:] - phase[:, :-1]) / USUAL_RATE
        weights = torch.stack([layer.weight.abs().mean() for layer in self.layers]).sum()  # type: ignore[operator,union-attr]
        return {
            **prediction_losses(made, batch),
            "phase": masked_mean((turn - target).square(), batch.mask),
            "weights": self.config.weight_l1 * weights,
        }

    def stream(self, batch: int) -> PhaseStream:
        """Return the state of a batch of characters: their phases."""
        return PhaseStream(self, batch)


class PhaseStream:
    """Phases of B characters: by footsteps in the given frames, by the network's steps after them."""

    def __init__(self, network: PhaseFunctionedNetwork, batch: int) -> None:
        self.network, self.batch = network, batch
        self.reset()

    def reset(self, warmup: int = 0) -> None:
        """Forget all frames; the contacts of the next given + 1 frames are recorded."""
        self.warmup = warmup + 1
        self.seen: list[Tensor] = []
        self.phase = torch.zeros(self.batch)

    def step(
        self, x_BF: Tensor, contacts_B4: Tensor, controls_BC: Tensor, latent_BZ: Tensor | None = None
    ) -> NextFrame:
        """Predict the next frame, and go on to its phase."""
        if len(self.seen) < self.warmup:
            self.seen.append(contacts_B4.cpu())
            known = torch.stack(self.seen, dim=1).numpy()
            self.phase = torch.tensor([gait_phase(each)[-1] for each in known], dtype=torch.float32)
        made, turn = self.network.run(x_BF, controls_BC, self.phase.to(x_BF.device))
        self.phase = self.phase + USUAL_RATE * turn.clamp(min=0.0).cpu()
        return made
