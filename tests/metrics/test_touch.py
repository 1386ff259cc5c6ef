"""Planted toes, hovering, lowest points, and flights against free fall."""

from __future__ import annotations

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.metrics.flight import FREE_FALL, JOINT_MASSES, centre_of_mass, flights, vertical_acceleration
from motionkit.metrics.touch import (
    flight_acceleration,
    hover_share,
    lowest_points,
    planted_share,
    touching,
)
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.skeleton import JOINT_NAMES
from synthetic_motions import make_idle, make_walk


def standing(frames: int = 120) -> Array:
    """A body that stands still (T, 23, 3), in double precision."""
    return motion_kinematics(make_idle(2))[1].astype(np.float64)[:1].repeat(frames, axis=0)


def thrown(frames: int = 30, acceleration: float = FREE_FALL, before: int = 45) -> Array:
    """A standing body that is in the air for some frames, accelerated by so many m/s^2."""
    positions = standing(before + frames + before)
    time = np.arange(frames + 2) / 60.0
    height = (
        20.0 + 50.0 * acceleration * (time - time[-1] / 2) ** 2 - 50.0 * acceleration * (time[-1] / 2) ** 2
    )
    positions[before : before + frames, :, 1] += height[1:-1, None]
    return positions


def test_masses_are_those_of_one_body_and_move_with_it() -> None:
    assert JOINT_MASSES.sum() == pytest.approx(1.0) and (JOINT_MASSES >= 0.0).all()
    positions = standing(3)
    centre = centre_of_mass(positions)
    assert 80.0 < centre[0, 1] < 105.0  # just above the hips at 95 cm
    assert np.allclose(centre_of_mass(positions + 10.0), centre + 10.0)


def test_the_acceleration_of_a_parabola_is_its_own() -> None:
    time = np.arange(60) / 60.0
    assert np.allclose(vertical_acceleration(100.0 - 490.5 * time**2), -9.81)
    assert np.allclose(vertical_acceleration(30.0 * time), 0.0)
    with pytest.raises(MotionkitError, match="at least 7 frames"):
        vertical_acceleration(np.zeros(6))


@pytest.mark.parametrize("acceleration", [FREE_FALL, -4.0, 0.0])
def test_the_acceleration_of_a_flight_is_found(acceleration: float) -> None:
    positions = thrown(30, acceleration)
    value = flight_acceleration(positions)
    assert value.value == pytest.approx(acceleration, abs=0.01)
    assert value.parameters["flights"] == 1.0 and value.parameters["frame"] == 45.0
    assert flight_acceleration(positions[20:], start=20).parameters == value.parameters


def test_the_worst_flight_counts_and_short_ones_do_not() -> None:
    both = np.concatenate([thrown(30), thrown(30, -5.0), thrown(8, 0.0)])
    assert flight_acceleration(both).value == pytest.approx(-5.0, abs=0.01)
    assert len(flights(both, ~touching(both))) == 2
    with pytest.raises(MotionkitError, match="no flight"):
        flight_acceleration(standing())


def test_who_falls_freely_does_not_hover_and_who_floats_does() -> None:
    assert hover_share(standing()).value == 0.0
    floating = standing(100)
    floating[40:60, :, 1] += 15.0
    share = hover_share(floating).value
    assert share is not None and 0.14 <= share <= 0.2  # its first and last frames seem to leap
    leap = hover_share(thrown(30)).value
    assert leap is not None and leap < 0.05  # the frames of take-off and landing


def test_a_higher_ground_raises_the_limits() -> None:
    floating = standing(60)
    floating[..., 1] += 15.0
    assert hover_share(floating).value == 1.0 and hover_share(floating, 15.0).value == 0.0
    assert planted_share(floating).value == 0.0 and planted_share(floating, 15.0).value == 1.0


def test_hands_and_heads_touch_too() -> None:
    lying = standing(60)
    lying[..., 1] += 50.0
    assert not touching(lying).any()
    for name in ("LeftHand", "Head", "RightLeg"):
        down = lying.copy()
        down[:, JOINT_NAMES.index(name), 1] = 8.0
        assert touching(down).all()


def test_toes_are_planted_while_they_are_low_and_slow() -> None:
    positions = standing(120)
    assert planted_share(positions).value == 1.0
    positions[60:, :, 2] += 2.0 * np.arange(60)[:, None]  # 120 cm/s
    assert planted_share(positions).value == pytest.approx(0.5, abs=0.03)
    walk = planted_share(motion_kinematics(make_walk(180))[1]).value
    assert walk is not None and walk < 0.9


def test_lowest_points_are_signed() -> None:
    positions = standing(60)
    hand, head = JOINT_NAMES.index("LeftHand"), JOINT_NAMES.index("Head")
    positions[10, hand, 1], positions[20, head, 1] = -8.0, 3.0
    found = {value.id: value.value for value in lowest_points(positions)}
    assert found["lowest-hands"] == -8.0 and found["lowest-head"] == 3.0 and found["lowest-body"] == -8.0
    assert found["lowest-feet"] == pytest.approx(4.1, abs=0.01)  # as the idle body stands
    assert lowest_points(positions, ground=-2.0)[1].value == -6.0
    with pytest.raises(MotionkitError, match="at least 1 frame"):
        lowest_points(positions[:0])
