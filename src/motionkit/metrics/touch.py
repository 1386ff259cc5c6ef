"""Contact with the ground: planted toes, hovering, and the lowest points of the body.

Positions are (T, 23, 3) global positions in cm, at 60 fps. ground is the height in cm of the ground under the soles,
unlike the floor of metrics.ground, which is the height of standing toe joints.
"""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.metrics.flight import centre_of_mass, flights, vertical_acceleration
from motionkit.metrics.ground import TOES
from motionkit.metrics.value import FRAME_RATE, MetricValue, need
from motionkit.motion.contacts import foot_contacts
from motionkit.motion.skeleton import JOINT_NAMES

# Height in cm below which a joint may touch the ground. Recorded toes stand at 3 to 5 cm, ankles at 7 to 10, wrists
# that bear weight at 3 to 15; values of the other joints are the thickness of the body around them.
_TOUCHES = {
    "ToeBase": 6.0, "Foot": 12.5, "Leg": 10.0, "UpLeg": 16.0, "Hips": 18.0, "LowerBack": 18.0, "Spine": 18.0,
    "Spine1": 20.0, "Neck": 16.0, "Neck1": 14.0, "Head": 16.0, "Shoulder": 16.0, "Arm": 12.0, "ForeArm": 10.0,
    "Hand": 15.0,
}  # fmt: skip
TOUCH_HEIGHTS = np.array([_TOUCHES[name.removeprefix("Left").removeprefix("Right")] for name in JOINT_NAMES])

GROUPS: dict[str, tuple[str, ...]] = {
    "feet": ("LeftFoot", "LeftToeBase", "RightFoot", "RightToeBase"),
    "hands": ("LeftHand", "RightHand"),
    "head": ("Head",),
    "body": JOINT_NAMES,
}
FALL_ERROR = 1.5  # m/s^2 by which the acceleration of a flight may differ from free fall
# m/s^2, half of free fall. A body in the air hovers if its centre of mass accelerates downwards by less.
FALLING = -4.9


def touching(positions: Array, ground: float = 0.0) -> Array:
    """Flags (T,): whether a joint is low enough to touch the ground."""
    low: Array = positions[..., 1] - ground < TOUCH_HEIGHTS
    return np.asarray(low.any(axis=-1))


def planted_share(positions: Array, ground: float = 0.0) -> MetricValue:
    """Share of frames in which a toe is planted, low and slow by the rule of the contact labels."""
    above = positions - np.array([0.0, ground, 0.0])
    planted = foot_contacts(above, FRAME_RATE)[:, list(TOES)].any(axis=-1)
    return MetricValue("planted-share", float(planted.mean()), "", {"ground_cm": ground})


def hover_share(positions: Array, ground: float = 0.0) -> MetricValue:
    """Share of frames in which nothing touches the ground, and yet the body does not fall freely.

    Raises:
        MotionkitError: there are too few frames to measure an acceleration.
    """
    fall = vertical_acceleration(centre_of_mass(positions)[:, 1])
    hovers = ~touching(positions, ground) & (fall > FALLING)
    return MetricValue("hover-share", float(hovers.mean()), "", {"ground_cm": ground})


def lowest_points(positions: Array, ground: float = 0.0) -> tuple[MetricValue, ...]:
    """Height in cm of the lowest joint of feet, hands, head and whole body above the ground; negative below it.

    Raises:
        MotionkitError: there are no frames.
    """
    need(len(positions), 1, "lowest points need")
    out = []
    for group, names in GROUPS.items():
        joints = [JOINT_NAMES.index(name) for name in names]
        lowest = float(positions[:, joints, 1].min() - ground)
        out.append(MetricValue(f"lowest-{group}", lowest, "cm", {"ground_cm": ground}))
    return tuple(out)


def flight_acceleration(positions: Array, ground: float = 0.0, start: int = 0) -> MetricValue:
    """Vertical acceleration in m/s^2 of the centre of mass, in the flight that differs most from free fall.

    A flight is a stretch of at least flight.LEAST_SECONDS in which nothing touches the ground. The parameter "frame" is
    its first frame; start is the number of the first frame of positions.

    Raises:
        MotionkitError: there is no flight.
    """
    found = flights(positions, ~touching(positions, ground))
    if not found:
        raise MotionkitError("no flight")
    worst = max(found, key=lambda flight: abs(flight.error))
    parameters: dict[str, float | str] = {"flights": float(len(found)), "frame": float(start + worst.start)}
    return MetricValue(
        "flight-acceleration", worst.acceleration, "m/s^2", {**parameters, "ground_cm": ground}
    )
