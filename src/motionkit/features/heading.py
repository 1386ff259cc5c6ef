"""The heading of a body: its facing direction on the ground, continuous even while it is upside down."""

from __future__ import annotations

import math

import numpy as np

from motionkit.arrays import Array, normalized
from motionkit.motion.rotations import wrap_angle
from motionkit.motion.skeleton import JOINT_NAMES

# A trunk within 60 degrees of vertical is upright. Beyond that, the left-right axis does not show the facing direction.
UPRIGHT_COSINE = 0.5
SMOOTHING_SECONDS = 0.08  # standard deviation of the Gaussian that smooths the heading


def heading_angles(global_positions: Array, fps: float) -> Array:
    """Heading (T,) in radians of canonical joints (T, 23, 3), continuous over time; 0 faces +Z, pi/2 faces +X.

    In upright frames it follows from the mean of the axes across hips and shoulders. Between them, it takes the
    shortest arc from one upright frame to the next. The result is smoothed lightly.
    """
    yaw, upright = _raw_heading(global_positions.astype(np.float64))
    yaw = _bridge(yaw, upright)
    return _smooth(yaw, SMOOTHING_SECONDS * fps).astype(global_positions.dtype)


def _raw_heading(positions: Array) -> tuple[Array, Array]:
    at = JOINT_NAMES.index
    across_hips = positions[:, at("LeftUpLeg")] - positions[:, at("RightUpLeg")]
    across_shoulders = positions[:, at("LeftArm")] - positions[:, at("RightArm")]
    across = normalized(across_hips) + normalized(across_shoulders)
    trunk = normalized(positions[:, at("Neck")] - positions[:, 0])
    # The facing direction is across x up: left along +X and up along +Y give +Z.
    yaw = np.arctan2(-across[:, 2], across[:, 0])
    level = np.linalg.norm(across[:, [0, 2]], axis=-1) > 0.6
    return yaw, (trunk[:, 1] > UPRIGHT_COSINE) & level


def _bridge(yaw: Array, upright: Array) -> Array:
    """Unwrap the headings of upright frames and interpolate between them."""
    known = np.flatnonzero(upright)
    if len(known) == 0:
        known = np.arange(len(yaw))
    steps = wrap_angle(np.diff(yaw[known]))
    unrolled = np.concatenate([yaw[known[:1]], yaw[known[:1]] + np.cumsum(steps, 0)])
    frames = np.arange(len(yaw))
    right = np.minimum(np.searchsorted(known, frames), len(known) - 1)
    left = np.maximum(right - 1, 0)
    left = np.where(frames >= known[right], right, left)
    span = np.maximum(known[right] - known[left], 1)
    weight = np.clip((frames - known[left]).astype(np.float64) / span, 0.0, 1.0)
    return unrolled[left] * (1 - weight) + unrolled[right] * weight


def _smooth(values: Array, sigma: float) -> Array:
    """Smooth values (T,) by a Gaussian, extrapolated linearly beyond their ends; sigma is in frames."""
    radius = max(1, math.ceil(3 * sigma))
    if len(values) < 3:
        return values
    kernel = np.exp(-0.5 * (np.arange(-radius, radius + 1, dtype=values.dtype) / sigma) ** 2)
    kernel = kernel / kernel.sum()
    before = values[0] - (values[1] - values[0]) * np.arange(radius, 0, -1, dtype=values.dtype)
    after = values[-1] + (values[-1] - values[-2]) * np.arange(1, radius + 1, dtype=values.dtype)
    padded = np.concatenate([before, values, after])
    return np.convolve(padded, kernel, mode="valid")
