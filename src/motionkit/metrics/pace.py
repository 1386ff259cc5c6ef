"""Speed and acceleration of a body over the ground."""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Array, length

PACE_SECONDS = 0.2  # time over which velocities are measured, and between the two of an acceleration


def ground_velocity(root_positions: Array, fps: float) -> Array:
    """Velocity (T - n, 2) in m/s over the ground of a root (T, 3) in cm, each measured over n frames, PACE_SECONDS."""
    frames = max(1, round(PACE_SECONDS * fps))
    track = root_positions[:, [0, 2]].astype(np.float64)
    return (track[frames:] - track[:-frames]) * (fps / frames / 100.0)


def ground_acceleration(root_positions: Array, fps: float) -> Array:
    """Size (T - 2 n,) in m/s^2 of the acceleration over the ground of a root (T, 3), from velocities n frames apart."""
    frames = max(1, round(PACE_SECONDS * fps))
    velocity = ground_velocity(root_positions, fps)
    return length(velocity[frames:] - velocity[:-frames]) * (fps / frames)
