"""MVAE, the motion VAE of Ling et al. 2020, as the paper compares with it: with controls, and without the policy.

Controls stand beside the past pose in encoder and decoder, and the present pose is no input, which closes the gap
between training and inference (paper section 5.3). The encoder gives 32 latent Gaussians; the decoder is a mixture of
six experts of 256, to each layer of which the latent numbers are fed again, with a gate of 64-64. Training unrolls
eight frames, first on recorded poses, then ever more on its own (scheduled sampling, 20 : 20 : 100).
Shape legend: B batch, T frames, N rows, Z latent numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from motionkit.features.layout import FEATURE_COUNT
from motionkit.lab.networks.baseline import (
    OUTPUTS,
    BaselineConfig,
    ExpertLayers,
    MemorylessStream,
    masked_mean,
    mlp,
    prediction_losses,
    split_outputs,
)
from motionkit.models.batch import Batch, FeatureSpace
from motionkit.models.predictor import NextFrame, Predictor, stacked

UNROLLED = 8  # frames
TEACHER, RAMP = 20.0 / 140.0, 20.0 / 140.0  # shares of the run on recorded poses, and until none is recorded


@dataclass(frozen=True)
class MotionVaeConfig(BaselineConfig):
    """Sizes of the network; the defaults are those of its paper."""

    architecture: str = "mvae"
    latent: int = 32
    hidden: int = 256
    experts: int = 6
    gate: int = 64
    kl_weight: float = 0.2


def teacher_share(progress: float) -> float:
    """Return the share of recorded poses among the inputs at a share of the run."""
    return min(1.0, max(0.0, 1.0 - (progress - TEACHER) / RAMP))


class MotionVae(Predictor):
    """The past pose, controls and latent numbers in, the next pose out."""

    config: MotionVaeConfig
    config_class = MotionVaeConfig

    def __init__(self, config: MotionVaeConfig, control_size: int) -> None:
        super().__init__(config, control_size)
        inputs, hidden, latent = FEATURE_COUNT + control_size, config.hidden, config.latent
        self.latent_size = latent
        self.encoder = mlp((inputs, hidden, hidden))
        self.to_latent = nn.Linear(hidden, 2 * latent)
        self.gate = mlp((inputs + latent, config.gate, config.gate, config.experts))
        sizes = ((inputs + latent, hidden), (hidden + latent, hidden), (hidden + latent, OUTPUTS))
        self.decoder = ExpertLayers(config.experts, sizes)

    def encode(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean and log variance (N, Z) of the latent numbers for past poses with controls."""
        mean, log_variance = self.to_latent(F.elu(self.encoder(inputs))).float().chunk(2, dim=-1)
        return mean, log_variance.clamp(-10.0, 10.0)

    def decode(self, inputs: Tensor, latent: Tensor) -> NextFrame:
        """Return the next frame for past poses with controls (N, ...) and latent numbers (N, Z)."""
        shares = torch.softmax(self.gate(torch.cat([inputs, latent], dim=-1)), dim=-1)
        return split_outputs(self.decoder(inputs, shares, again=latent))

    def next(self, x: Tensor, contacts: Tensor, controls: Tensor, latent: Tensor | None) -> NextFrame:
        """Predict from one frame (N, ...), with latent numbers of unit size, or with their mean."""
        inputs = torch.cat([x, controls], dim=-1)
        mean, log_variance = self.encode(inputs)
        drawn = mean if latent is None else mean + torch.exp(0.5 * log_variance) * latent
        return self.decode(inputs, drawn)

    def losses(self, batch: Batch, space: FeatureSpace, progress: float) -> dict[str, Tensor]:
        """Return squared errors over unrolled frames, and the divergence from unit Gaussians."""
        runs = _unrolled(batch)
        share = teacher_share(progress)
        x, frames, divergences = runs.inputs[:, 0], [], []
        for t in range(UNROLLED):
            recorded = torch.rand(len(x), 1, device=x.device) < share
            x = torch.where(recorded, runs.inputs[:, t], x) if t else x
            inputs = torch.cat([x, runs.controls[:, t]], dim=-1)
            mean, log_variance = self.encode(inputs)
            drawn = mean + torch.exp(0.5 * log_variance) * torch.randn_like(mean)
            frames.append(self.decode(inputs, drawn))
            divergences.append(0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance))
            x = frames[-1].mean
        kl = masked_mean(torch.stack(divergences, dim=1), runs.mask)
        return {**prediction_losses(stacked(frames), runs), "kl": self.config.kl_weight * kl}

    def stream(self, batch: int) -> MemorylessStream:
        """Return a stream; the network keeps no state."""
        return MemorylessStream(self.next)


def _unrolled(batch: Batch) -> Batch:
    """Return windows (B, T) as runs of UNROLLED frames one after another; a shorter rest is left out."""
    runs = batch.mask.shape[1] // UNROLLED
    count = len(batch.mask) * runs
    cut = {
        name: value[:, : runs * UNROLLED].reshape(count, UNROLLED, *value.shape[2:])
        for name, value in vars(batch).items()
        if name != "offsets"
    }
    return Batch(**cut, offsets=batch.offsets.repeat_interleave(runs, dim=0))
