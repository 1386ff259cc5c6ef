"""Feet beyond the range of the ankle, recorded and drawn."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from motionkit.arrays import normalized
from motionkit.motion.ankles import ANKLES, FEET, ankles_in_range, repair_ankles
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_about, quat_angle, quat_identity, quat_multiply, quat_normalize
from synthetic_motions import make_walk

ANKLE, TOE = FEET[1]


def spoilt(motion: Motion, angle: np.ndarray, axis: np.ndarray, joint: int = ANKLE) -> Motion:
    """The motion with a joint turned further by angles (T,) about an axis (3,) of its own."""
    rotations = motion.local_rotations.astype(np.float64)
    rotations[:, joint] = quat_multiply(rotations[:, joint], quat_about(axis, angle))
    return replace(motion, local_rotations=rotations)


def length_of(motion: Motion) -> np.ndarray:
    return normalized(motion.skeleton.offsets[TOE].astype(np.float64))


def apart(one: Motion, other: Motion) -> np.ndarray:
    """Degrees (T,) between the right feet."""
    return np.degrees(
        quat_angle(*(each.local_rotations[:, ANKLE].astype(np.float64) for each in (one, other)))
    )


def test_a_foot_that_is_turned_over_turns_back() -> None:
    walk = make_walk(90)
    over = np.zeros(90)
    over[40:] = math.pi
    bad = spoilt(walk, over, length_of(walk))
    made, repaired = repair_ankles(bad)
    assert repaired == [(frame, "RightFoot") for frame in range(40, 90)]
    assert apart(bad, walk)[40:].min() > 170.0 and apart(made, walk).max() < 0.1
    assert repair_ankles(made) == (made, [])


def test_on_another_rig_its_own_foot_turns_about_its_own_length() -> None:
    walk = make_walk(60)
    over = np.full(60, math.pi)
    bad = spoilt(walk, over, length_of(walk))
    # The same motion on a rig whose foot joint has other axes in the rest pose: all of them turned by a third.
    other = quat_normalize(np.ones(4))
    turns = bad.local_rotations.astype(np.float64).copy()
    turns[:, ANKLE] = quat_multiply(turns[:, ANKLE], other)
    offsets = walk.skeleton.offsets.astype(np.float64).copy()
    offsets[TOE] = np.roll(offsets[TOE], -1)  # turned back by the same third
    rig = replace(bad, local_rotations=turns, skeleton=replace(walk.skeleton, offsets=offsets))
    made, repaired = repair_ankles(rig, bad, (None, (ANKLE, TOE)))
    assert len(repaired) == 60
    expected = quat_multiply(walk.local_rotations[:, ANKLE].astype(np.float64), other)
    assert np.degrees(quat_angle(made.local_rotations[:, ANKLE], expected)).max() < 0.1


@pytest.mark.parametrize(("frames", "mended"), [(12, True), (40, False)])
def test_a_foot_that_is_bent_back_for_a_moment_is_interpolated(frames: int, mended: bool) -> None:
    walk = make_walk(120)
    walk = replace(walk, local_rotations=quat_identity(walk.local_rotations.shape[:2]))
    bent = np.zeros(120)
    bent[50 : 50 + frames] = math.radians(150.0)
    bad = spoilt(walk, bent, np.array([1.0, 0.0, 0.0]))
    made, repaired = repair_ankles(bad)
    assert bool(repaired) == mended and apart(bad, walk).max() == pytest.approx(150.0, abs=0.1)
    assert (apart(made, walk).max() < 1e-3) == mended
    if mended:
        margin = round(ANKLES.margin * 60)
        assert [frame for frame, _ in repaired] == list(range(50 - margin, 50 + frames + margin))


def test_feet_of_a_walk_and_retargeted_feet_stay() -> None:
    walk = make_walk(90)
    assert repair_ankles(walk) == (walk, []) and ankles_in_range(walk) is walk
    steep = spoilt(walk, np.full(90, math.radians(120.0)), length_of(walk))
    assert repair_ankles(steep) == (steep, [])


def test_a_drawn_foot_rolls_back_without_a_jump() -> None:
    walk = make_walk(240)
    still = replace(walk, local_rotations=quat_identity(walk.local_rotations.shape[:2]))
    roll = np.linspace(0.0, 2.0 * math.pi, 240)
    made = ankles_in_range(spoilt(still, roll, length_of(walk)))
    away, step = apart(made, still), np.degrees(roll[1])
    usual, most = (math.degrees(each) for each in (ANKLES.usual_roll, ANKLES.most_roll))
    assert away[:10] == pytest.approx(np.degrees(roll[:10]), abs=0.1)
    assert away.max() == pytest.approx(usual, abs=step)
    beyond = (roll > math.radians(most)) & (roll < 2.0 * math.pi - math.radians(most))
    assert away[beyond].max() < 0.1
    feet = made.local_rotations[:, ANKLE].astype(np.float64)
    assert np.degrees(quat_angle(feet[1:], feet[:-1])).max() < 1.01 * step
