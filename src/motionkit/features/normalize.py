"""Per-column scaling of features and trajectories, computed in one pass with constant memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array
from motionkit.features.layout import FeatureLayout

# Smallest standard deviation of a column, as a share of its block's RMS deviation. Without it, noise of a joint that
# hardly moves would be amplified.
BLOCK_FLOOR = 0.1
# The same for the positions (cm) and directions of trajectories.
TRAJECTORY_FLOOR = 5.0
DIRECTION_FLOOR = 0.05


@dataclass(frozen=True, eq=False)
class Scaling:
    """Mean and standard deviation per column; normalised = (value - mean) / std."""

    mean: Array
    std: Array

    def normalize(self, values: Array) -> Array:
        """Scale values (..., columns) to zero mean and unit deviation."""
        return (values - self.mean) / self.std

    def denormalize(self, values: Array) -> Array:
        """Scale normalised values (..., columns) back to cm, radians and their rates."""
        return values * self.std + self.mean


class RunningMoments:
    """Mean and variance per column over batches of rows, in float64."""

    def __init__(self, columns: int) -> None:
        self.count = 0
        self.total = np.zeros(columns)
        self.squares = np.zeros(columns)

    def add(self, rows: np.ndarray) -> None:
        """Add rows (N, columns)."""
        rows = rows.astype(np.float64)
        self.count += len(rows)
        self.total += rows.sum(axis=0)
        self.squares += (rows**2).sum(axis=0)

    def mean_std(self) -> tuple[Array, Array]:
        """Mean and standard deviation (columns,) of all rows so far."""
        mean = self.total / max(self.count, 1)
        variance = np.maximum(self.squares / max(self.count, 1) - mean**2, 0.0)
        return mean.astype(np.float32), np.sqrt(variance).astype(np.float32)


def feature_scaling(moments: RunningMoments, layout: FeatureLayout) -> Scaling:
    """Scaling of the features; deviations are at least BLOCK_FLOOR of their block's."""
    mean, std = moments.mean_std()
    for block in layout.blocks.values():
        floor = BLOCK_FLOOR * np.sqrt(np.square(std[block]).mean())
        std[block] = np.maximum(std[block], max(float(floor), 1e-6))
    return Scaling(mean, std)


def trajectory_scaling(moments: RunningMoments) -> Scaling:
    """Scaling of the trajectory values; deviations are at least TRAJECTORY_FLOOR and DIRECTION_FLOOR."""
    mean, std = moments.mean_std()
    half = len(std) // 2
    std[:half] = np.maximum(std[:half], TRAJECTORY_FLOOR)
    std[half:] = np.maximum(std[half:], DIRECTION_FLOOR)
    return Scaling(mean, std)
