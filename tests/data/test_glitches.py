from __future__ import annotations

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.data.cleaning import LEAP_DISTANCE, cut_at_leaps, find_leaps
from motionkit.motion.kinematics import motion_kinematics
from synthetic_motions import make_cartwheel, make_walk


def walk_positions(frames: int = 60) -> Array:
    return motion_kinematics(make_walk(frames))[1].copy()


def test_honest_motion_has_no_leaps() -> None:
    assert find_leaps(walk_positions()) == []
    assert find_leaps(motion_kinematics(make_cartwheel(70))[1]) == []


def test_a_joint_that_leaps_and_goes_on_is_found() -> None:
    positions = walk_positions()
    positions[30:, 4] += np.array([0.0, 1.6 * LEAP_DISTANCE, 0.0], np.float32)
    assert find_leaps(positions) == [30]


def test_a_root_that_leaps_with_the_whole_body_is_found() -> None:
    positions = walk_positions()
    positions[30:, :, 0] += 2.0 * LEAP_DISTANCE
    assert find_leaps(positions) == [30]
    fast = walk_positions()
    fast[..., 2] += 0.9 * LEAP_DISTANCE * np.arange(len(fast), dtype=np.float32)[:, None]
    assert find_leaps(fast) == [], "a body that is as fast all the time does not leap"


def test_a_body_that_leaps_ten_metres_is_cut_there() -> None:
    positions = walk_positions()
    positions[30] += 1e7  # there and back
    positions[40:] += np.array([0.0, 0.0, 2000.0], np.float32)
    assert find_leaps(positions) == [30, 31, 40]


def test_a_few_frames_have_no_leaps() -> None:
    assert find_leaps(walk_positions(6)) == []


@pytest.mark.parametrize(
    ("leaps", "stretches"),
    [
        ([], [(10, 50)]),
        ([30], [(10, 29), (31, 50)]),
        ([30, 33], [(10, 29), (34, 50)]),  # what is left between is too short
        ([10], [(11, 50)]),
        ([50], [(10, 49)]),
        ([5, 70], [(10, 50)]),
        ([40, 20], [(10, 19), (21, 39), (41, 50)]),
    ],
)
def test_cut_at_leaps(leaps: list[int], stretches: list[tuple[int, int]]) -> None:
    assert cut_at_leaps(10, 50, leaps) == stretches
