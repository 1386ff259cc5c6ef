"""What a gait can be asked for: speeds and directions at which its feet do not glide."""

from __future__ import annotations

import math

from motionkit.control.steering import STANDS_BELOW, Pair, nearest_turn
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind

# Radians between the facing and a gait's usual one; beyond them walks hardly lift their feet and runs slide. Measured
# on roll-outs.
MOST_ASIDE, MOST_ASIDE_RUNNING = math.pi / 4, math.pi / 6


def speed_limits(model: MotionModel, kind: str) -> Pair:
    """Slowest and fastest speed of a type in cm/s; 0 and infinity where its recordings do not say."""
    return model.speed_range(kind) or (0.0, math.inf)


def within_limits(
    model: MotionModel, kind: str, velocity: Pair, facing: float | None
) -> tuple[Pair, float | None]:
    """Return the velocity and facing nearest to a wish at which a steered type steps.

    A standing body is not moved. A gait goes no slower and no faster than recorded, and turns towards its direction as
    far as it has to.

    Args:
        kind: a type; others than steered ones get what is wished.
        velocity: x and z in cm/s.
        facing: radians, None for any.
    """
    known, speed = model.types[kind], math.hypot(*velocity)
    if known.kind is MotionKind.STANCE:
        return (0.0, 0.0), facing
    if speed < STANDS_BELOW or known.kind is not MotionKind.GAIT or known.gait is None:
        return velocity, facing
    slowest, fastest = speed_limits(model, kind)
    share = min(max(speed, slowest), fastest) / speed
    if facing is not None:
        own = math.atan2(*velocity) - known.gait.facing
        aside = nearest_turn(facing - own)
        most = MOST_ASIDE_RUNNING if known.gait.runs else MOST_ASIDE
        if abs(aside) > most:
            facing = own + math.copysign(most, aside)
    return (share * velocity[0], share * velocity[1]), facing
