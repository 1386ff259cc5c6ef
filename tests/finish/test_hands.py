"""Wrists bend where fingers would be below the ground, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motionkit.finish.hands import FINGERS, HANDS, fingers_above
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_from_yaw, quat_multiply, quat_rotate
from motionkit.motion.skeleton import JOINT_NAMES
from synthetic_motions import make_walk

ARMS = tuple(JOINT_NAMES.index(name) for name in ("LeftArm", "RightArm"))


def on_hands(height: float, frames: int = 60, aside: float = 0.0) -> Motion:
    """A body whose arms point down, wrists at a height in cm, turned about the vertical by an angle."""
    motion = make_walk(frames, speed=0.0, turn=0.0, swing=0.0, cadence=0.3)
    rotations = motion.local_rotations.copy()
    for arm, side in zip(ARMS, (-1.0, 1.0), strict=True):
        half = side * np.pi / 4.0
        rotations[:, arm] = [np.cos(half), 0.0, 0.0, np.sin(half)]
    yaw = quat_from_yaw(np.full(frames, aside))
    rotations[:, 0] = quat_multiply(yaw, rotations[:, 0])
    roots = motion.root_positions.copy()
    wrists = motion_kinematics(replace(motion, local_rotations=rotations.astype(np.float32)))[1][
        :, HANDS[0], 1
    ]
    roots[:, 1] += height - wrists
    return replace(motion, local_rotations=rotations.astype(np.float32), root_positions=roots)


def tips(motion: Motion) -> np.ndarray:
    """Heights (T, 2) of the finger tips in cm."""
    turns, positions = motion_kinematics(motion)
    ends = [FINGERS * np.array(motion.skeleton.end_sites[hand]) for hand in HANDS]
    return np.stack(
        [(positions[:, h] + quat_rotate(turns[:, h], e))[:, 1] for h, e in zip(HANDS, ends, strict=True)], 1
    )


@pytest.mark.parametrize("aside", [0.0, 2.0])
@pytest.mark.parametrize("height", [3.0, 10.0])
def test_fingers_of_hands_on_the_ground_lie_on_it(height: float, aside: float) -> None:
    motion = on_hands(height, aside=aside)
    assert tips(motion).max() < -5.0
    bent = fingers_above(motion)
    assert tips(bent).min() > 0.0
    others = np.delete(np.arange(len(JOINT_NAMES)), HANDS)
    assert np.array_equal(bent.local_rotations[:, others], motion.local_rotations[:, others])
    assert np.array_equal(motion_kinematics(bent)[1], motion_kinematics(motion)[1]), (
        "wrists have no joints below"
    )


def test_hands_in_the_air_stay() -> None:
    motion = on_hands(40.0)
    assert fingers_above(motion) is motion or np.array_equal(
        fingers_above(motion).local_rotations, motion.local_rotations
    )


def test_a_hand_that_comes_down_bends_without_a_jerk() -> None:
    motion = on_hands(3.0, 90)
    roots = motion.root_positions.copy()
    roots[:, 1] += np.abs(np.linspace(-40.0, 40.0, 90))
    bent = (
        fingers_above(replace(motion, root_positions=roots)).local_rotations[:, HANDS[0]].astype(np.float64)
    )
    steps = 2.0 * np.degrees(np.arccos(np.clip(np.abs((bent[1:] * bent[:-1]).sum(axis=1)), 0.0, 1.0)))
    assert steps.sum() > 100.0 and steps.max() < 12.0
