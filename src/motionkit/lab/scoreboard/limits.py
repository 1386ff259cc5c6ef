"""What recordings keep below: limits of joint speed and of acceleration over the ground.

A few recorded frames contain jumps of one joint by up to half a turn. Compared with them every motion would be
smooth. The limits are therefore values that 99.9 % of the recorded frames stay below.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from motionkit.arrays import Array
from motionkit.metrics.body import Body
from motionkit.metrics.body_movement import geodesic_movement
from motionkit.metrics.pace import ground_acceleration
from motionkit.training.verdict.real import RealMotion

REAL_SHARE = 0.999  # share of the recorded frames that are below a limit


def turn_limit(real: RealMotion) -> tuple[float, float]:
    """Return the limit and the largest speed of the fastest joint over the recorded frames, in degrees per second."""
    frames = np.concatenate(
        [geodesic_movement(s.body.rotations).max(axis=1) * s.body.fps for s in real.stretches]
    )
    return _limit(frames), float(frames.max())


def acceleration_limit(real: RealMotion, kinds: Collection[str] | None = None) -> float | None:
    """Return the limit of acceleration over the ground in m/s^2, over recordings of some types or all; None without."""
    chosen = [s.body for s in real.stretches if kinds is None or s.type in kinds]
    frames = np.concatenate([np.zeros(0), *map(accelerations, chosen)])
    return _limit(frames) if len(frames) else None


def accelerations(body: Body) -> Array:
    """Return the accelerations (T',) of a body over the ground in m/s^2."""
    return ground_acceleration(body.positions[:, 0], body.fps)


def _limit(values: Array) -> float:
    ordered = np.sort(values)
    return float(ordered[int(REAL_SHARE * (len(ordered) - 1))])
