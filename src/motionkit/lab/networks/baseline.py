"""What the baselines share: their config's checks, mixtures of experts, and a stream for networks without memory.

Shape legend: B batch, T frames, K experts, N rows (any leading shape, flattened).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, fields
from typing import Any, TypeVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from motionkit.errors import ModelError
from motionkit.features.control import TRAJECTORY_COUNT
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.models.batch import Batch
from motionkit.models.config import CHOICES
from motionkit.models.predictor import NextFrame

MOST = 8192  # largest layer size, because model files may come from untrusted sources
OUTPUTS = FEATURE_COUNT + CONTACT_COUNT + TRAJECTORY_COUNT
NO_SIGMA = -9.2  # log sigma of networks that predict no distribution: drawn frames are the mean

Config = TypeVar("Config", bound="BaselineConfig")


@dataclass(frozen=True)
class BaselineConfig:
    """Fields that every baseline has. Subclasses add sizes as whole numbers, and shares from 0 to 1."""

    architecture: str = ""
    layout: str = "expmap-root-1"
    controls: str = "paper"

    def __post_init__(self) -> None:
        for field in fields(self):
            value, default = getattr(self, field.name), field.default
            if field.name in CHOICES:
                allowed = isinstance(value, str) and value in CHOICES[field.name]
            elif isinstance(default, str):
                allowed = value == default
            elif isinstance(default, int):
                allowed = isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= MOST
            else:
                allowed = isinstance(value, (int, float)) and 0.0 <= value <= 1.0
            if not allowed:
                raise ModelError(f"{field.name} is {value!r:.60}, expected a value like {default!r}")

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, for a model file."""
        return asdict(self)

    @classmethod
    def from_dict(cls: type[Config], values: dict[str, Any]) -> Config:
        """Return the config of a model file. Raises ModelError for unknown fields or bad values."""
        unknown = set(values) - {field.name for field in fields(cls)}
        if unknown:
            raise ModelError(f"unknown settings {', '.join(sorted(map(ascii, unknown))):.200}")
        return cls(**values)


class Experts(nn.Module):
    """K linear maps whose results are blended row by row: sum over k of weight_k (x W_k + b_k)."""

    def __init__(self, count: int, inputs: int, outputs: int) -> None:
        super().__init__()
        bound = math.sqrt(6.0 / (inputs + outputs))
        self.weight = nn.Parameter(torch.empty(count, inputs, outputs).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.zeros(count, outputs))

    def forward(self, x: Tensor, shares: Tensor) -> Tensor:
        """Map rows x (N, inputs) by shares (N, K)."""
        each = torch.matmul(x, self.weight.to(x.dtype)) + self.bias[:, None].to(x.dtype)  # (K, N, outputs)
        return (shares.T.to(x.dtype)[..., None] * each).sum(0)


class ExpertLayers(nn.ModuleList):
    """Layers of K experts, blended by the same shares, with ELU between them."""

    def __init__(self, count: int, sizes: Iterable[tuple[int, int]]) -> None:
        super().__init__(Experts(count, inputs, outputs) for inputs, outputs in sizes)

    def forward(self, x: Tensor, shares: Tensor, again: Tensor | None = None, dropout: float = 0.0) -> Tensor:
        """Map rows x (N, ...) by shares (N, K); the numbers again (N, ...) are fed to every layer."""
        for i, layer in enumerate(self):
            x = F.dropout(x, dropout, self.training)
            x = layer(x if again is None else torch.cat([x, again], dim=-1), shares)
            x = F.elu(x) if i < len(self) - 1 else x
        return x


def mlp(sizes: tuple[int, ...], activation: type[nn.Module] = nn.ELU) -> nn.Sequential:
    """Return linear layers with an activation between them."""
    layers: list[nn.Module] = []
    for i in range(len(sizes) - 1):
        layers += [nn.Linear(sizes[i], sizes[i + 1])] + ([activation()] if i < len(sizes) - 2 else [])
    return nn.Sequential(*layers)


def split_outputs(out: Tensor) -> NextFrame:
    """Return the prediction in outputs (..., 304): features, contacts, trajectory."""
    mean, contacts, trajectory = out.float().split([FEATURE_COUNT, CONTACT_COUNT, TRAJECTORY_COUNT], dim=-1)
    return NextFrame(mean, torch.full_like(mean, NO_SIGMA), contacts, trajectory)


def prediction_losses(made: NextFrame, batch: Batch) -> dict[str, Tensor]:
    """Return mean squared errors of features and trajectory, and the cross-entropy of contacts."""
    assert made.trajectory_mean is not None
    errors = {
        "mse": (made.mean - batch.targets).square(),
        "trajectory": (made.trajectory_mean - batch.trajectory).square(),
    }
    means = {name: masked_mean(error, batch.mask) for name, error in errors.items()}
    return {**means, "contact": contact_loss(made, batch)}


def contact_loss(made: NextFrame, batch: Batch) -> Tensor:
    """Return the cross-entropy of contacts."""
    loss = F.binary_cross_entropy_with_logits(made.contact_logits, batch.next_contacts, reduction="none")
    return masked_mean(loss, batch.mask)


def steps(frames: Tensor) -> Tensor:
    """Return the differences (B, T - 1, ...) between frames (B, T, ...)."""
    return frames[:, 1:] - frames[:, :-1]


def masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """Return the mean of values (B, T, ...) over frames by a mask (B, T), and over the rest."""
    per_frame = values.flatten(2).mean(-1) if values.dim() > 2 else values
    return (per_frame * mask).mean()


class MemorylessStream:
    """The stream of a network whose prediction depends on the present frame alone."""

    def __init__(self, predict: Callable[[Tensor, Tensor, Tensor, Tensor | None], NextFrame]) -> None:
        """predict: called with features, contacts, controls and latent numbers of one frame."""
        self.predict = predict

    def reset(self, warmup: int = 0) -> None:
        """There is nothing to forget."""

    def step(
        self, x_BF: Tensor, contacts_B4: Tensor, controls_BC: Tensor, latent_BZ: Tensor | None = None
    ) -> NextFrame:
        """Predict the next frame."""
        return self.predict(x_BF, contacts_B4, controls_BC, latent_BZ)
