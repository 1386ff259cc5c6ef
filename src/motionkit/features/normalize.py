"""Per-column scaling of features and trajectories, gathered in one pass of constant memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array
from motionkit.features.layout import FeatureLayout

# Columns that hardly move (a rest rotation, a fixed joint) would be blown up by their own deviation;
# none is divided by less than this share of the RMS deviation of its block.
BLOCK_FLOOR = 0.1
TRAJECTORY_FLOOR = 5.0  # cm
DIRECTION_FLOOR = 0.05


@dataclass(frozen=True, eq=False)
class Scaling:
    """A mean and a deviation per column; normalised = (value - mean) / std."""

    mean: Array
    std: Array

    def normalize(self, values: Array) -> Array:
        """To zero mean and unit deviation."""
        return (values - self.mean) / self.std

    def denormalize(self, values: Array) -> Array:
        """Back to cm, radians and their rates."""
        return values * self.std + self.mean


class RunningMoments:
    """Mean and variance per column over batches of rows, in float64."""

    def __init__(self, columns: int) -> None:
        self.count = 0
        self.total = np.zeros(columns)
        self.squares = np.zeros(columns)

    def add(self, rows: np.ndarray) -> None:
        """Take in (N, columns) more rows."""
        rows = rows.astype(np.float64)
        self.count += len(rows)
        self.total += rows.sum(axis=0)
        self.squares += (rows**2).sum(axis=0)

    def mean_std(self) -> tuple[Array, Array]:
        """Mean and deviation (columns,) of all rows so far."""
        mean = self.total / max(self.count, 1)
        variance = np.maximum(self.squares / max(self.count, 1) - mean**2, 0.0)
        return mean.astype(np.float32), np.sqrt(variance).astype(np.float32)


def feature_scaling(moments: RunningMoments, layout: FeatureLayout) -> Scaling:
    """Scaling of the 276 features with the block floor."""
    mean, std = moments.mean_std()
    for block in layout.blocks.values():
        floor = BLOCK_FLOOR * np.sqrt(np.square(std[block]).mean())
        std[block] = np.maximum(std[block], max(float(floor), 1e-6))
    return Scaling(mean, std)


def trajectory_scaling(moments: RunningMoments) -> Scaling:
    """Scaling of the 24 trajectory numbers: positions at least 5 cm, directions at least 0.05."""
    mean, std = moments.mean_std()
    half = len(std) // 2
    std[:half] = np.maximum(std[:half], TRAJECTORY_FLOOR)
    std[half:] = np.maximum(std[half:], DIRECTION_FLOOR)
    return Scaling(mean, std)
