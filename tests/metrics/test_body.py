"""What is measured of a body: at the edge of each bound, in the body's own frame, and in time, not in frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motionkit.metrics.body import Body, bodies, body_of
from motionkit.metrics.flight import JOINT_MASSES, centre_of_mass, flights
from motionkit.metrics.pace import ground_velocity
from motionkit.metrics.touch import TOUCH_HEIGHTS, touching
from motionkit.motion.motion import resample
from motionkit.motion.skeleton import JOINT_NAMES, canonical_skeleton
from synthetic_motions import make_cartwheel, make_walk

from .conftest import placed, swaying

MEASURES = (
    "velocity", "speed", "lifts", "foot_ahead", "turned", "head_height", "ankle_height", "hand_heights",
    "arm_extension", "arm_ahead", "arm_thrust",
)  # fmt: skip


@pytest.mark.parametrize("measure", [*MEASURES, "poses"])
def test_where_a_body_stands_and_faces_changes_no_measure(measure: str) -> None:
    motion = swaying(90)
    here, there = (body_of(each) for each in (motion, placed(motion, 1.0, (300.0, 0.0, -200.0))))
    one, other = (each.poses() if measure == "poses" else getattr(each, measure) for each in (here, there))
    assert np.abs(one).max() > 0.01 and other == pytest.approx(one, abs=0.05)


def test_every_body_has_rotations_and_places() -> None:
    rotations, roots = np.zeros((2, 4, len(JOINT_NAMES), 4)), np.zeros((2, 4, 3))
    rotations[..., 0] = 1.0
    assert len(bodies(rotations, roots, canonical_skeleton(), 60.0)) == 2
    with pytest.raises(ValueError, match="argument"):
        bodies(rotations[:1], roots, canonical_skeleton(), 60.0)


def test_half_the_rate_measures_the_same() -> None:
    motion = make_cartwheel(240)
    whole, half = body_of(motion), body_of(motion).every(2)
    assert half.seconds == pytest.approx(whole.seconds) and half.cut(30, 90).seconds == pytest.approx(2.0)
    assert half.joint_speed() == pytest.approx(whole.joint_speed(), rel=0.05)
    for measure in MEASURES:
        near = 12.0 if measure == "arm_thrust" else 0.1
        assert getattr(half, measure) == pytest.approx(getattr(whole, measure)[::2], abs=near), measure
    assert len(half.poses(3)) == 40 and half.poses(3)[1] == pytest.approx(whole.poses()[6])


def still(frames: int = 120) -> Body:
    """A body without a pose: all joints at the origin."""
    rotations = np.tile([1.0, 0.0, 0.0, 0.0], (frames, len(JOINT_NAMES), 1))
    return Body(rotations, np.zeros((frames, len(JOINT_NAMES), 3)), np.zeros(frames), 60.0)


def test_speed_is_that_over_a_fifth_of_a_second() -> None:
    body = still()
    body.positions[60:, 0, 2] = 6.0
    assert np.flatnonzero(body.speed).tolist() == list(range(54, 66))
    assert body.velocity[60] == pytest.approx([0.0, 0.3])
    assert ground_velocity(body.positions[:, 0], 60.0).max() == pytest.approx(0.3)
    assert body.cut(0, 5).speed.tolist() == [0.0] * 5, "a clip that is shorter than that"


@pytest.mark.parametrize(
    ("lift", "speed", "low", "frames"),
    [(2.1, 81.0, 6, 6), (1.9, 81.0, 6, 0), (2.1, 79.0, 6, 0), (2.1, 81.0, 114, 0)],
)
def test_feet_that_fly_in_a_run_are_up_and_swing(lift: float, speed: float, low: int, frames: int) -> None:
    """Of the clip's lowest tenth of heights, wherever its floor is."""
    body = still()
    feet = [JOINT_NAMES.index(side + part) for side in ("Left", "Right") for part in ("Foot", "ToeBase")]
    body.positions[:, feet, 1] = 30.0
    body.positions[-low:, feet, 1] += lift
    body.positions[:, feet, 2] = (np.arange(120) * speed / 60.0)[:, None]
    assert replace(body).stride_flight_frames() == frames


def test_the_longest_flight_is_told_in_seconds() -> None:
    body = still()
    feet = [JOINT_NAMES.index(side + part) for side in ("Left", "Right") for part in ("Foot", "ToeBase")]
    for start, end, height in ((20, 32, 30.0), (50, 74, 30.0), (90, 119, 5.0)):
        body.positions[start:end, feet, 1] = height
    assert body.flights == [(20, 32), (50, 74)] and body.flight_seconds() == pytest.approx(0.4)
    assert replace(body, fps=30.0).flight_seconds() == pytest.approx(0.8)


# ---- mass, after Winter (2009), and what touches the floor ----


@pytest.mark.parametrize(
    ("joints", "mass"),
    [
        (["LeftUpLeg"], 0.100 * 0.567),
        (["LeftLeg"], 0.100 * 0.433 + 0.0465 * 0.567),
        (["RightFoot"], 0.0465 * 0.433 + 0.0145 * 0.5),
        (["RightToeBase"], 0.0145 * 0.5),
        (["LeftArm", "LeftForeArm", "LeftHand"], 0.050),
        (["RightForeArm"], 0.028 * 0.436 + 0.016 * 0.570),
        (["RightHand"], 0.016 * 0.430 + 0.006),
        (["Hips", "Neck"], 0.497),
        (["Hips"], 0.497 * 0.5),
        (["Neck1", "Head"], 0.081),
        (["Head"], 0.081 * 0.5),
        (list(JOINT_NAMES), 1.0),
    ],
)
def test_parts_of_the_body_weigh_their_share(joints: list[str], mass: float) -> None:
    positions = np.zeros((1, len(JOINT_NAMES), 3))
    positions[:, [JOINT_NAMES.index(joint) for joint in joints], 1] = 100.0
    assert centre_of_mass(positions)[0] == pytest.approx([0.0, 100.0 * mass, 0.0], abs=1e-6)
    assert JOINT_MASSES.min() >= 0.0


@pytest.mark.parametrize(("frames", "found"), [(11, 0), (12, 1), (30, 1)])
def test_a_thrown_body_falls_freely_from_a_fifth_of_a_second_on(frames: int, found: int) -> None:
    time = np.arange(60) / 60.0
    positions = np.zeros((60, len(JOINT_NAMES), 3))
    positions[..., 1] = (300.0 * time - 0.5 * 981.0 * time**2)[:, None]
    in_air = np.zeros(60, bool)
    in_air[10 : 10 + frames] = True
    assert [flight.error for flight in flights(positions, in_air)] == [pytest.approx(0.0, abs=0.01)] * found


@pytest.mark.parametrize("joint", JOINT_NAMES)
def test_a_joint_touches_the_floor_by_the_thickness_around_it(joint: str) -> None:
    """Recorded toes stand at 3 to 5 cm, ankles at 7 to 10, wrists that bear weight at 3 to 15; a trunk is thicker."""
    number = JOINT_NAMES.index(joint)
    low, high = next(
        (bounds for part, bounds in {"Toe": (5, 7), "Foot": (10, 14), "Hand": (14, 16), "Arm": (9, 13)}.items()
         if part in joint),
        (9, 11) if joint.endswith("Leg") and "Up" not in joint else (13, 21),
    )  # fmt: skip
    positions = np.full((2, len(JOINT_NAMES), 3), 100.0)
    positions[:, number, 1] = low, high
    assert touching(positions).tolist() == [True, False] and low < TOUCH_HEIGHTS[number] < high
    assert touching(positions + 50.0, 50.0).tolist() == [True, False]


def test_a_slower_rate_of_a_walk_is_measured_alike() -> None:
    walk = make_walk(120, turn=0.0)
    once, twice = body_of(walk), body_of(resample(walk, 120.0))
    assert twice.speed.mean() == pytest.approx(once.speed.mean(), rel=0.02)
    assert twice.body_movement() == pytest.approx(0.5 * once.body_movement(), rel=0.05)
