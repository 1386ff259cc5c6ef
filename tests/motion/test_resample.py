"""Resampling a motion to another frame rate."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motionkit.errors import MotionkitError
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion, resample
from motionkit.motion.rotations import quat_angle


@pytest.mark.parametrize("source, target", [(120, 60), (60, 120), (100, 60), (30, 60), (25, 60), (60, 29.97)])
def test_frames_duration_and_ends(make_motion: Callable[..., Motion], source: float, target: float) -> None:
    motion = make_motion(frames=101, fps=source)
    out = resample(motion, target)
    assert out.fps == target
    last, end = (len(out) - 1) / target, (len(motion) - 1) / source
    assert last <= end + 1e-9 and end - last < 1 / target
    assert np.array_equal(out.root_positions[0], motion.root_positions[0])
    assert quat_angle(out.local_rotations[0], motion.local_rotations[0]).max() < 1e-3
    assert np.abs(np.linalg.norm(out.local_rotations, axis=-1) - 1).max() < 1e-6


def test_whole_ratio_picks_the_frames_themselves(make_motion: Callable[..., Motion]) -> None:
    motion = make_motion(frames=121, fps=120)
    out = resample(motion, 60)
    assert len(out) == 61
    assert quat_angle(out.local_rotations, motion.local_rotations[::2]).max() < 1e-3
    assert np.abs(out.root_positions - motion.root_positions[::2]).max() < 1e-4


@pytest.mark.parametrize("fps", [0.0, -30.0, math.nan, math.inf])
def test_what_is_no_rate_is_refused(make_motion: Callable[..., Motion], fps: float) -> None:
    with pytest.raises(MotionkitError, match="expected a frame rate above 0"):
        resample(make_motion(frames=10), fps)


def test_there_and_back(make_motion: Callable[..., Motion]) -> None:
    motion = make_motion(frames=61, fps=60)
    back = resample(resample(motion, 240), 60)
    assert len(back) == len(motion)
    assert quat_angle(back.local_rotations, motion.local_rotations).max() < 1e-3
    assert np.abs(back.root_positions - motion.root_positions).max() < 1e-3


def test_smooth_motion_keeps_its_shape_at_an_odd_ratio(make_motion: Callable[..., Motion]) -> None:
    fine, coarse = make_motion(frames=241, fps=240), make_motion(frames=101, fps=100)
    _, expected = motion_kinematics(fine)
    _, positions = motion_kinematics(resample(coarse, 240))
    count = min(len(expected), len(positions))
    assert np.linalg.norm(positions[:count] - expected[:count], axis=-1).max() < 0.5


def test_same_rate_and_single_frame(make_motion: Callable[..., Motion]) -> None:
    motion = make_motion(frames=10)
    assert resample(motion, 60) is motion
    single = resample(motion.cut(0, 1), 30)
    assert len(single) == 1 and single.fps == 30


def test_signs_of_quaternions_do_not_matter(make_motion: Callable[..., Motion]) -> None:
    motion = make_motion(frames=50, fps=100)
    signs = np.where(np.arange(50) % 3 == 0, -1.0, 1.0)[:, None, None]
    flipped = replace(motion, local_rotations=motion.local_rotations * signs)
    assert (
        quat_angle(resample(flipped, 60).local_rotations, resample(motion, 60).local_rotations).max() < 1e-3
    )


def test_moving_joints_are_resampled_too(make_motion: Callable[..., Motion]) -> None:
    motion = make_motion(frames=11, fps=10)
    places = np.broadcast_to(np.arange(11.0, dtype=np.float32)[:, None, None], (11, 23, 3))
    out = resample(replace(motion, local_positions=places), 20)
    assert out.local_positions is not None
    assert np.allclose(out.local_positions[:, 3, 1], 0.5 * np.arange(21.0, dtype=np.float32))


@pytest.mark.parametrize("fps", [30.0, 24.0, 90.0])
def test_a_cycle_stays_closed(fps: float, make_motion: Callable[..., Motion]) -> None:
    motion = make_motion(frames=72)
    turns = motion.local_rotations.copy()
    turns[-1] = turns[0]
    closed = replace(motion, local_rotations=turns)
    made = resample(closed, fps, cyclic=True)
    assert np.allclose(np.abs((made.local_rotations[-1] * turns[0]).sum(axis=-1)), 1.0, atol=1e-6)
    assert abs(len(made) - 1 - 71 * fps / motion.fps) <= 0.5 and made.fps == fps
