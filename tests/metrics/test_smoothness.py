from __future__ import annotations

import math

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.metrics.smoothness import jerk_extremes, mean_jerk, positions_at_rate


def polynomial(fps: float, power: int, seconds: float = 2.0) -> Array:
    """A joint at 100 t^power cm along Y; (T, 1, 3)."""
    time = np.arange(int(seconds * fps) + 1, dtype=np.float64) / fps
    positions = np.zeros((len(time), 1, 3), np.float64)
    positions[:, 0, 1] = 100.0 * time**power
    return positions


def test_a_cubic_has_a_constant_jerk_and_a_fall_has_none() -> None:
    assert mean_jerk(polynomial(60.0, 3)).value == pytest.approx(6.0, rel=1e-6)  # m/s^3
    assert mean_jerk(polynomial(60.0, 2)).value == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("fps", [120.0, 100.0, 72.0])
def test_other_rates_are_brought_over_without_corners(fps: float) -> None:
    assert mean_jerk(polynomial(fps, 3), fps).value == pytest.approx(6.0, rel=1e-5)


@pytest.mark.parametrize("frames", [4, 41])
def test_whole_ratios_take_the_frames_themselves(frames: int) -> None:
    positions = np.random.default_rng(0).standard_normal((frames, 2, 3), np.float64)
    assert positions_at_rate(positions, 120.0, 60.0) == pytest.approx(positions[::2], abs=1e-12)
    assert positions_at_rate(positions, 60.0, 60.0) is positions


def test_a_swing_between_frames_is_met_closely() -> None:
    time = np.arange(201, dtype=np.float64) / 100.0
    swing = np.sin(2 * math.pi * 2.0 * time)[:, None, None].repeat(3, axis=2)
    there = positions_at_rate(swing, 100.0, 60.0)
    expected = np.sin(2 * math.pi * 2.0 * np.arange(len(there)) / 60.0)
    assert float(np.abs(there[:, 0, 0] - expected).max()) < 2e-5


def test_trembling_raises_it() -> None:
    smooth = polynomial(60.0, 3)
    noise = 0.1 * np.random.default_rng(0).standard_normal(smooth.shape, np.float64)
    assert mean_jerk(smooth + noise).value > 50 * mean_jerk(smooth).value


@pytest.mark.parametrize(("scale", "away"), [(1.0, 0.0), (2.0, 6.0), (0.5, 3.0)])
def test_the_area_is_how_far_a_constant_jerk_is_from_the_usual_one(scale: float, away: float) -> None:
    """Of the joint that jerks most: the other one falls."""
    usual = np.concatenate([polynomial(60.0, 3), polynomial(60.0, 2)], axis=1)
    peak, area = jerk_extremes(scale * usual, 60.0, usual, 60.0)
    assert peak.value == pytest.approx(6.0 * scale, rel=1e-6)
    assert area.value == pytest.approx(away * (len(usual) - 3) / 60.0, rel=1e-5, abs=1e-5)


def test_three_frames_are_refused() -> None:
    with pytest.raises(MotionkitError, match="at least 4 frames"):
        mean_jerk(np.zeros((3, 23, 3), np.float32))
