"""Input of a training step: a batch of windows, and the meaning of their normalised features."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from motionkit.data.dataset import Dataset
from motionkit.features.layout import feature_layout
from motionkit.motion.rotations import quat_to_matrix


@dataclass(frozen=True, eq=False)
class Batch:
    """A batch of windows of normalised features; targets are one frame ahead of inputs.

    Attributes:
        inputs, targets: (B, T, 276).
        contacts, next_contacts: (B, T, 4).
        trajectory: (B, T, 24) trajectory of the target frame.
        offsets: (B, 23, 3) bone offsets in cm.
        mask: (B, T) weight of each frame.
    """

    inputs: Tensor
    targets: Tensor
    contacts: Tensor
    next_contacts: Tensor
    controls: Tensor
    trajectory: Tensor
    offsets: Tensor
    mask: Tensor

    def to(self, device: torch.device | str) -> Batch:
        """Return the batch on another device."""
        return Batch(*(value.to(device, non_blocking=True) for value in vars(self).values()))

    def __getitem__(self, places: Any) -> Batch:
        """Return some windows of the batch; of stacked batches, that of one seed."""
        return Batch(*(value[places] for value in vars(self).values()))

    @staticmethod
    def joined(batches: Sequence[Batch], join: Callable[[list[Tensor]], Tensor] = torch.cat) -> Batch:
        """Return one batch of all windows in order, or with another way to join tensors."""
        return Batch(*map(join, map(list, zip(*(vars(each).values() for each in batches), strict=True))))


@dataclass(frozen=True, eq=False)
class FeatureSpace:
    """The meaning of normalised features.

    Attributes:
        mean, std: (276,) scaling of the features.
        reference_matrices: (3, 3, 23) reference rotations of the joints.
    """

    mean: Tensor
    std: Tensor
    reference_matrices: Tensor
    layout: str
    fps: float

    @classmethod
    def of(cls, dataset: Dataset) -> FeatureSpace:
        """Return the feature space of a dataset, on the CPU."""
        matrices = np.moveaxis(quat_to_matrix(dataset.reference_rotations), 0, -1)
        mean, std, references = map(torch.from_numpy, (dataset.scaling.mean, dataset.scaling.std, matrices))
        return cls(mean, std, references, dataset.layout.version, dataset.fps)

    def to(self, device: torch.device) -> FeatureSpace:
        """Return the feature space on another device."""
        mean, std, references = (x.to(device) for x in (self.mean, self.std, self.reference_matrices))
        return FeatureSpace(mean, std, references, self.layout, self.fps)

    def denormalize(self, values: Tensor) -> Tensor:
        """Return features (..., 276) in cm, radians and their rates."""
        return values * self.std + self.mean

    def root_height(self, features: Tensor) -> Tensor:
        """Return the height (...) of the root in cm from unnormalised features."""
        return features[..., feature_layout(self.layout).root_height]
