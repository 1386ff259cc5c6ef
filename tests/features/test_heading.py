from __future__ import annotations

import math

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.features.heading import heading_angles
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from synthetic_motions import make_cartwheel, make_dance, make_walk, placed


def heading(motion: Motion) -> Array:
    return heading_angles(motion_kinematics(motion)[1], motion.fps)


@pytest.mark.parametrize("yaw", [0.0, 1.0, math.pi / 2, -2.5])
def test_heading_is_the_way_a_standing_body_faces(yaw: float) -> None:
    angles = heading(placed(make_walk(60, speed=0.0, turn=0.0, swing=0.0), yaw))
    difference = np.remainder(angles - yaw + math.pi, 2 * math.pi) - math.pi
    assert np.abs(difference).max() < 1e-3


def test_heading_follows_a_turn_beyond_a_full_circle_without_a_jump() -> None:
    angles = heading(make_walk(400, turn=2.0, swing=0.1))
    assert np.abs(np.diff(angles)).max() < 0.08
    assert float(angles[-1] - angles[0]) == pytest.approx(2.0 * 399 / 60, abs=0.1)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("yaw", [0.0, 3.0, -1.7])
@pytest.mark.parametrize("turns", [1.0, 2.0])
def test_heading_does_not_flip_while_the_body_is_upside_down(side: float, yaw: float, turns: float) -> None:
    motion = make_cartwheel(240, yaw=yaw, side=side, turns=turns)
    _, positions = motion_kinematics(motion)
    trunk = positions[:, 12] - positions[:, 0]
    assert float(trunk[:, 1].min()) < -10.0, "the body is not upside down: the test shows nothing"
    angles = heading(motion)
    assert np.abs(np.diff(angles)).max() < 0.085
    difference = np.remainder(angles - yaw + math.pi, 2 * math.pi) - math.pi
    assert np.abs(difference).max() < 0.35


def test_heading_of_a_spinning_dance_turns_at_its_rate() -> None:
    angles = heading(make_dance())
    steps = np.diff(angles)
    assert np.abs(steps).max() < 0.085
    assert float(steps.mean()) * 60 == pytest.approx(2.5, abs=0.1)


def test_a_body_that_is_never_upright_still_has_a_finite_heading() -> None:
    motion = make_cartwheel(40, turns=0.0)
    lying = motion.local_rotations.copy()
    lying[:, 0] = np.array([math.cos(math.pi / 4), math.sin(math.pi / 4), 0.0, 0.0], np.float32)
    angles = heading(Motion(motion.skeleton, lying, motion.root_positions, motion.fps))
    assert np.isfinite(angles).all()


@pytest.mark.parametrize("frames", [2, 3, 5])
def test_heading_of_a_few_frames(frames: int) -> None:
    angles = heading(make_walk(frames, turn=0.0))
    assert angles.shape == (frames,)
    assert np.abs(angles).max() < 0.2
