"""What recordings keep below: limits of joint speed and of acceleration over the ground.

A few recorded frames contain jumps of one joint by up to half a turn. Compared with them every motion would be
smooth. The limits are therefore values that 99.9 % of the recorded frames stay below.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

import numpy as np

from motionkit.arrays import Array
from motionkit.metrics.body import Body
from motionkit.metrics.body_movement import geodesic_movement
from motionkit.metrics.pace import ground_acceleration
from motionkit.training.verdict.real import RealMotion

REAL_SHARE = 0.999  # share of the recorded frames that are below a limit


def turn_limit(real: RealMotion, kinds: Collection[str]) -> float | None:
    """Return the limit of the fastest joint in degrees per second, over recordings of some types; None without."""
    return _limit(
        geodesic_movement(s.body.rotations).max(axis=1) * s.body.fps
        for s in real.stretches
        if s.type in kinds
    )


def acceleration_limit(real: RealMotion, kinds: Collection[str]) -> float | None:
    """Return the limit of acceleration over the ground in m/s^2, over recordings of some types; None without."""
    return _limit(accelerations(s.body) for s in real.stretches if s.type in kinds)


def accelerations(body: Body) -> Array:
    """Return the accelerations (T',) of a body over the ground in m/s^2."""
    return ground_acceleration(body.positions[:, 0], body.fps)


def _limit(values: Iterable[Array]) -> float | None:
    ordered = np.sort(np.concatenate([np.zeros(0), *values]))
    return float(ordered[int(REAL_SHARE * (len(ordered) - 1))]) if len(ordered) else None
