"""Bodies that obey the steering of live characters."""

from __future__ import annotations

import math

from motionkit.control.steering import Pair, Steering, SteeringOptions

FPS = 60.0
FREE = "cartwheel"  # a type whose wishes have no limits and no speed controller
# A body that turns at once is asked for just what its wish has become.
AT_ONCE = SteeringOptions(turn_speed=math.inf, turn_aside=math.pi, smoothing=1.0)


def asked_of(steering: Steering, kind: str, velocity: Pair, facing: float | None) -> tuple[Pair, float]:
    """The velocity, in the heading frame, and the turn that a trajectory ends with."""
    numbers = steering.trajectory(kind, velocity, facing)[0][0].tolist()
    ahead = [(numbers[10 + axis] - numbers[8 + axis]) * FPS / 10.0 for axis in (0, 1)]
    return (ahead[0], ahead[1]), math.atan2(numbers[22], numbers[23])


def walk_as_told(steering: Steering, velocity: Pair, facing: float | None, frames: int) -> list:
    """Ground places of a body that does what its trajectory says, frame by frame."""
    x = z = heading = 0.0
    out = []
    for _ in range(frames):
        steering.observe(x, z, heading, False)
        numbers = steering.trajectory(FREE, velocity, facing)[0][0].tolist()
        ahead_x, ahead_z, sine, cosine = numbers[0] / 10, numbers[1] / 10, numbers[12], numbers[13]
        turn = math.atan2(sine, cosine) / 10
        x += math.cos(heading) * ahead_x + math.sin(heading) * ahead_z
        z += -math.sin(heading) * ahead_x + math.cos(heading) * ahead_z
        heading += turn
        out.append((x, z, heading))
    return out
