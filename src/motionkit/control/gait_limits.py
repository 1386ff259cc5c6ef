"""Limits of a gait: speeds and directions at which its feet do not glide."""

from __future__ import annotations

import math

from motionkit.control.steering import STANDS_BELOW, Pair, nearest_turn
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind

# Largest angle (radians) between the wished facing and the usual one of the gait. Beyond it, walks hardly lift their
# feet and runs slide; measured on roll-outs.
MOST_ASIDE, MOST_ASIDE_RUNNING = math.pi / 4, math.pi / 6


def speed_limits(model: MotionModel, kind: str) -> Pair:
    """Slowest and fastest speed of a type in cm/s; 0 and infinity if its recordings show none."""
    return model.speed_range(kind) or (0.0, math.inf)


def within_limits(
    model: MotionModel, kind: str, velocity: Pair, facing: float | None
) -> tuple[Pair, float | None]:
    """Return the velocity and facing nearest to a wish at which a steered type takes proper steps.

    Standing gets no velocity. A gait keeps within its recorded speeds, and its facing within a limit of its direction.

    Args:
        kind: a type; the wish stays as it is for types that are not steered.
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
