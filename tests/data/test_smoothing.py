"""The filter against marker jitter."""

import math

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.data.smoothing import WINDOW, smooth, smooth_rotations
from motionkit.motion.rotations import expmap_to_quat


def wave(hertz: float, frames: int = 240) -> Array:
    return np.sin(2 * math.pi * hertz * np.arange(frames) / 60.0)[:, None]


def passed(hertz: float) -> float:
    middle = slice(30, -30)
    return float(np.linalg.norm(smooth(wave(hertz))[middle]) / np.linalg.norm(wave(hertz)[middle]))


def test_cubics_come_back_as_they_are() -> None:
    t = np.linspace(-1, 1, 60, dtype=np.float64)
    curve = np.stack([1 + t, t**2 - t**3], axis=-1)
    inner = slice(WINDOW // 2, -(WINDOW // 2))
    assert np.allclose(smooth(curve)[inner], curve[inner], atol=1e-12)


def test_movement_passes_and_trembling_does_not() -> None:
    assert passed(2.0) > 0.99 and passed(5.0) > 0.9
    assert 0.5 < passed(8.0) < 0.85
    assert passed(12.0) < 0.2 and passed(20.0) < 0.2 and passed(30.0) < 0.4


def test_ends_stay_where_they_are() -> None:
    values = wave(3.0, 50)
    assert np.allclose(smooth(values)[[0, -1]], values[[0, -1]], atol=1e-6)


@pytest.mark.parametrize("frames", [1, 3, WINDOW // 2])
def test_a_few_frames_come_back_as_they_are(frames: int) -> None:
    values = np.random.default_rng(0).standard_normal((frames, 2), np.float32)
    assert np.array_equal(smooth(values), values)


def test_rotations_stay_unit_whatever_their_signs() -> None:
    turn = np.stack([wave(1.5), np.zeros((240, 1), np.float32), wave(0.5)], axis=-1).reshape(240, 1, 3)
    rotations = expmap_to_quat(turn)
    signs = np.where(np.random.default_rng(0).random((240, 1, 1), np.float32) < 0.5, -1.0, 1.0)
    smoothed = smooth_rotations(rotations * signs)
    assert np.allclose(np.linalg.norm(smoothed, axis=-1), np.ones((240, 1), np.float32), atol=1e-6)
    assert (np.abs((smoothed * rotations).sum(-1)) > 0.9999).all()
