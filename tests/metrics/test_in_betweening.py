"""The protocol of LaFAN1: gaps whose errors are known, and windows that do not depend on place and heading."""

from __future__ import annotations

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.metrics.in_betweening import (
    PAST,
    TEST,
    TRAINING,
    Scale,
    gap_errors,
    interpolated,
    last_pose,
    spectrum_distance,
    windows_of,
)
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_from_yaw
from motionkit.motion.skeleton import Skeleton

BODY = Skeleton(
    ("hips", "head", "hand"), (-1, 0, 1), np.array([[0, 0, 0], [0, 40, 0], [30, 0, 0]], np.float32)
)
FRAMES = 150


def moving(speed: float = 0.0, turn: float = 0.0) -> Motion:
    """A stiff body that goes along X by `speed` and turns about Y by `turn` in each frame."""
    time = np.arange(FRAMES, dtype=np.float64)
    rotations = np.zeros((FRAMES, 3, 4))
    rotations[..., 0] = 1.0
    rotations[:, 0] = quat_from_yaw(turn * time)
    return Motion(BODY, rotations, np.stack([speed * time, np.full(FRAMES, 90.0), 0.0 * time], axis=-1), 30.0)


def errors(motion: Motion, gap: int, fill) -> list[float | None]:
    windows = windows_of([motion], *TEST)
    scale = Scale.of(windows_of([motion], *TRAINING))
    return [v.value for v in gap_errors(fill(windows, gap), windows.part(PAST, PAST + gap), scale)]


@pytest.mark.parametrize("gap", [5, 15, 30, 45])
def test_standing_still_is_off_by_the_way_and_interpolation_is_not(gap: int) -> None:
    """Places over 50 frames of equal steps have the deviation sqrt((50^2 - 1) / 12) steps."""
    way = np.sqrt(3) * np.arange(1, gap + 1).mean() / np.sqrt((50**2 - 1) / 12)
    assert errors(moving(speed=4.0), gap, last_pose) == pytest.approx([way, 0.0, 0.0], abs=1e-6)
    assert errors(moving(speed=4.0), gap, interpolated) == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("gap", [5, 30])
def test_quaternions_of_a_turn_are_a_chord_apart(gap: int) -> None:
    turn = 0.04
    chords = 2.0 * np.sqrt(3) * np.sin(turn * np.arange(1, gap + 1) / 4)
    assert errors(moving(turn=turn), gap, last_pose)[1] == pytest.approx(chords.mean(), rel=1e-6)
    assert errors(moving(turn=turn), gap, interpolated)[1] == pytest.approx(0.0, abs=1e-6)


def wave(frequency: int) -> Array:
    return np.cos(2 * np.pi * frequency * np.arange(32) / 32)[None, :, None]


@pytest.mark.parametrize(("made", "distance"), [(3, 0.0), (4, 1.0), (8, 5.0)])
def test_spectra_are_as_far_apart_as_their_frequencies(made: int, distance: float) -> None:
    assert spectrum_distance(wave(made), wave(3)) == pytest.approx(distance, abs=1e-9)


def test_channels_count_by_their_power() -> None:
    made = np.concatenate([wave(3), wave(8)], axis=2)
    truth = np.concatenate([3.0 * wave(3), wave(3)], axis=2)
    assert spectrum_distance(made, truth) == pytest.approx(5.0 / 10.0)


def test_place_and_heading_of_a_recording_do_not_matter() -> None:
    lying = moving(speed=2.0, turn=0.01)
    lying.local_rotations[:, 0] = np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0])  # Y points along Z
    there = lying.turned(1.3)
    there.root_positions[:] += np.array([50.0, 0.0, -7.0])
    here, away = (windows_of([each], *TEST) for each in (lying, there))
    assert away.roots == pytest.approx(here.roots, abs=1e-4)
    assert away.rotations == pytest.approx(here.rotations, abs=1e-6)
    ahead = here.globally()[1][:, PAST - 1, 3:5] - here.globally()[1][:, PAST - 1, 0:2]
    assert ahead == pytest.approx(np.array([[40.0, 0.0]] * len(ahead)), abs=1e-4)  # the head lies along X


def test_windows_need_motion_of_one_skeleton() -> None:
    with pytest.raises(MotionkitError, match="longer than the 65 frames"):
        windows_of([moving().cut(0, 65)], *TEST)
    names = Skeleton(("a", "b", "c"), BODY.parents, BODY.offsets)
    other = Motion(names, moving().local_rotations, moving().root_positions, 30.0)
    with pytest.raises(MotionkitError, match="different joints"):
        windows_of([moving(), other], *TEST)
