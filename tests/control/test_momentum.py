"""Changes of type carry speed over: what is asked for brakes and starts no faster than bodies do."""

from __future__ import annotations

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.control.momentum import (
    CHANGE,
    LEAST,
    carried_over,
    carried_speeds,
    forward_speeds,
    ground_speeds,
    trajectory_speed,
)
from motionkit.features.control import TRAJECTORY_OFFSETS, Controls, future_trajectory

FPS = 60.0


def straight(speed: float, frames: int, heading: float = 0.0) -> Array:
    """Ground (T, 3) of a body that goes ahead at a speed in cm/s."""
    way = speed / FPS * np.arange(frames)
    ground = np.stack([np.sin(heading) * way, np.cos(heading) * way, np.full(frames, heading)], axis=-1)
    return ground.astype(np.float32)


def asked_for(frames: int) -> Controls:
    return Controls.of_types(np.ones((frames, 1), np.float32))


def test_speed_is_measured_where_the_body_faces() -> None:
    assert forward_speeds(straight(120.0, 40, 2.0), FPS) == pytest.approx(np.full(40, 120.0), abs=0.1)
    backwards = straight(120.0, 40)
    backwards[:, 2] = np.pi
    assert forward_speeds(backwards, FPS) == pytest.approx(np.full(40, -120.0), abs=0.1)
    assert forward_speeds(straight(120.0, 1), FPS) == pytest.approx([0.0])


def test_speed_over_the_ground_goes_any_way() -> None:
    sideways = straight(120.0, 40, 2.0)
    sideways[:, 2] = 0.5
    assert ground_speeds(sideways, FPS) == pytest.approx(np.full(40, 120.0), abs=0.1)
    trajectory = future_trajectory(sideways, np.array([3]))[0]
    assert trajectory_speed(trajectory, FPS) == pytest.approx(120.0, abs=0.1)


@pytest.mark.parametrize("before", [330.0, -20.0])
def test_speeds_meet_as_fast_as_bodies_change_theirs(before: float) -> None:
    wanted = np.full(200, 50.0)
    speeds = carried_speeds(wanted, before, FPS)
    assert np.abs(np.diff(speeds, prepend=before)) == pytest.approx(np.full(len(speeds), CHANGE / FPS))
    assert abs(speeds[-1] - 50.0) <= CHANGE / FPS + 1e-6 and len(speeds) < FPS


def test_who_runs_into_a_slow_type_brakes() -> None:
    ground = straight(20.0, 200)
    asked = carried_over(asked_for(200), ground, 320.0, FPS)
    braking = int(asked.trajectory_mask.sum())
    assert asked.trajectory_mask[:braking].all() and braking == int(300.0 / CHANGE * FPS)
    ahead = asked.trajectory[:, 1] / TRAJECTORY_OFFSETS[0] * FPS  # mean speed over the next frames
    assert ahead[0] == pytest.approx(320.0 - CHANGE * TRAJECTORY_OFFSETS[0] / FPS / 2, abs=5.0)
    assert np.diff(ahead[: braking - 10]) == pytest.approx(-CHANGE / FPS, abs=0.1)
    # From where the speeds meet, the recording is asked for as it is.
    meeting = future_trajectory(ground, np.array([braking - 1]))[0, :12]
    assert np.abs(asked.trajectory[braking - 1, :12] - meeting).max() < CHANGE / FPS


def test_what_is_nearly_as_fast_is_left_alone() -> None:
    asked = asked_for(60)
    assert carried_over(asked, straight(100.0, 60), 100.0 + 0.9 * LEAST, FPS) is asked
    assert carried_over(asked, straight(300.0, 60), 100.0, FPS).trajectory[0, 1] < 300.0 / FPS * 10


def test_a_type_that_ends_before_the_speeds_meet_brakes_to_its_end() -> None:
    asked = carried_over(asked_for(10), straight(0.0, 200), 300.0, FPS)
    assert asked.trajectory_mask.tolist() == [1.0] * 10
