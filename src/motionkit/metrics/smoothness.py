"""Jerk, the third derivative of joint positions: jitter raises it, over-smoothing lowers it."""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.metrics.value import FRAME_RATE, MetricValue


def positions_at_rate(positions: Array, fps: float, rate: float) -> Array:
    """Resample positions (T, ...) from fps to rate by cubic interpolation over the four nearest frames.

    The corners of linear interpolation would dominate a third derivative. If fps is a multiple of rate, the result is
    a subset of the frames.
    """
    frames = len(positions)
    if abs(fps - rate) < 1e-6 * rate or frames < 4:
        return positions
    count = int((frames - 1) * rate / fps + 1e-6) + 1
    times = np.arange(count, dtype=np.float64) * (fps / rate)
    first = np.clip(np.floor(times).astype(np.int64) - 1, 0, frames - 4)
    u = (times - first).reshape(count, *[1] * (positions.ndim - 1))
    weights = (
        -(u - 1) * (u - 2) * (u - 3) / 6,
        u * (u - 2) * (u - 3) / 2,
        -u * (u - 1) * (u - 3) / 2,
        u * (u - 1) * (u - 2) / 6,
    )
    positions = positions.astype(np.float64)
    return np.stack([w * positions[first + k] for k, w in enumerate(weights)]).sum(0)


def mean_jerk(global_positions: Array, fps: float = FRAME_RATE, rate: float = FRAME_RATE) -> MetricValue:
    """Mean length of the third derivative of joint positions, in m/s^3, over all joints and frames.

    Args:
        global_positions: (T, J, 3) in cm.
        rate: frame rate at which the derivative is taken; values at different rates are not comparable.

    Raises:
        MotionkitError: there are fewer than four frames at that rate.
    """
    lengths = _jerks(global_positions, fps, rate)
    return MetricValue("jerk", float(lengths.mean()), "m/s^3", {"fps": rate})


def jerk_extremes(
    global_positions: Array, fps: float, usual: Array, usual_fps: float, rate: float = FRAME_RATE
) -> tuple[MetricValue, MetricValue]:
    """Peak jerk and area under the jerk (Barquero et al. 2024), ids "jerk-peak" in m/s^3 and "jerk-area" in m/s^2.

    Both are of the joint that jerks most in each frame: its largest value, and how far it is from its mean in the usual
    motion, summed over time.

    Args:
        global_positions, usual: (T, J, 3) in cm, of the motion and of a recorded one.
        fps, usual_fps: frames per second of each.
        rate: frame rate at which the derivatives are taken.

    Raises:
        MotionkitError: either has fewer than four frames at that rate.
    """
    most, level = (
        _jerks(global_positions, fps, rate).max(axis=-1),
        _jerks(usual, usual_fps, rate).max(axis=-1),
    )
    area = float(np.abs(most - level.mean()).sum() / rate)
    return (
        MetricValue("jerk-peak", float(most.max()), "m/s^3", {"fps": rate}),
        MetricValue("jerk-area", area, "m/s^2", {"fps": rate}),
    )


def _jerks(global_positions: Array, fps: float, rate: float) -> Array:
    """Lengths (T - 3, J) in m/s^3 of the third derivative of positions (T, J, 3) in cm."""
    positions = positions_at_rate(global_positions, fps, rate).astype(np.float64)
    if len(positions) < 4:
        raise MotionkitError(f"jerk needs at least 4 frames at {rate:g} fps, found {len(positions)}")
    third = np.diff(positions, n=3, axis=0) * rate**3 / 100.0
    return np.asarray(np.linalg.norm(third, axis=-1))
