"""Leaps of knees and elbows, and the fastest turn of a joint."""

from __future__ import annotations

import math

import numpy as np
import pytest

from motionkit.errors import MotionkitError
from motionkit.metrics.leaps import KNEES, SAME_LEAP, fastest_turn, leap_frames, leaps
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.rotations import quat_multiply
from synthetic_motions import make_walk


def test_a_smooth_track_has_no_leaps_however_fast() -> None:
    time = np.arange(120) / 60.0
    track = np.stack([500.0 * time, 30.0 * np.sin(12.0 * time), 4000.0 * time**2], axis=-1)
    assert len(leap_frames(track)) == 0


@pytest.mark.parametrize(("size", "count"), [(5.9, 0), (6.1, 1), (30.0, 1)])
def test_a_jump_to_another_place_is_one_leap(size: float, count: int) -> None:
    track = np.zeros((60, 3))
    track[30:, 0] = size
    assert leap_frames(track).tolist() == [30] * count


def test_a_jump_away_and_back_is_one_leap_and_two_flips_are_two() -> None:
    track = np.zeros((60, 3))
    track[30, 2] = 20.0
    assert len(leap_frames(track)) == 1
    track[40:50, 2] = 20.0
    assert leap_frames(track).tolist() == [30, 40, 50]


@pytest.mark.parametrize(("apart", "count"), [(SAME_LEAP, 1), (SAME_LEAP + 1, 2)])
def test_jumps_that_follow_at_once_are_one_leap(apart: int, count: int) -> None:
    track = np.zeros((60, 3))
    track[30:, 0] += 20.0
    track[30 + apart :, 2] += 20.0
    assert len(leap_frames(track)) == count and SAME_LEAP == 3


def test_trembling_leaps_again_and_again() -> None:
    track = np.zeros((120, 3))
    track[::2, 0] = 10.0
    assert len(leap_frames(track)) == 30


def test_a_low_rate_has_no_leaps_to_count() -> None:
    positions = motion_kinematics(make_walk(60))[1]
    with pytest.raises(MotionkitError, match="a file at 30 fps lacks"):
        leaps(positions, 30.0)
    assert leaps(positions, 120.0).value == 0.0


def test_leaps_are_counted_a_minute_over_knees_and_elbows() -> None:
    positions = motion_kinematics(make_walk(180))[1]
    assert leaps(positions).value == 0.0
    positions[90:, KNEES[0]] += np.array([0.0, 0.0, 25.0], np.float32)
    assert leaps(positions).value == pytest.approx(20.0)  # one in three seconds
    positions[:, 1] += 50.0 * (np.arange(180) % 2)[:, None]  # hips are no knees
    assert leaps(positions).value == pytest.approx(20.0)


def test_the_fastest_turn_names_joint_and_frame() -> None:
    rotations = make_walk(120).local_rotations.copy()
    turn = np.array([math.cos(0.5), math.sin(0.5), 0.0, 0.0], np.float32)
    rotations[60:, 2] = quat_multiply(rotations[60:, 2], turn)
    value = fastest_turn(rotations)
    assert value.parameters == {"joint": "LeftLeg", "frame": 60.0}
    assert fastest_turn(rotations[20:], start=20).parameters == value.parameters
    assert value.value == pytest.approx(math.degrees(1.0) * 60.0, rel=0.05)


def test_refusals() -> None:
    positions = motion_kinematics(make_walk(3))[1]
    with pytest.raises(MotionkitError, match="at least 4 frames"):
        leaps(positions)
    with pytest.raises(MotionkitError, match="at least 2 frames"):
        fastest_turn(make_walk(2).local_rotations[:1])
