"""Legs that reach for a target: exactly, with knees that bend forwards, and continuously."""

from __future__ import annotations

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.motion.leg_ik import LOCK, leg_turns, root_slip
from motionkit.motion.rotations import quat_angle, quat_from_yaw, quat_identity, quat_rotate

SIDE = np.array([-1.0, 0.0, 0.0])
HIP, THIGH, SHIN = np.array([10.0, 90.0, 0.0]), 42.0, 40.0


def leg(flexion: float) -> tuple[Array, Array, Array]:
    """Hip, knee and ankle (3,) of a leg under the hip; flexion in radians, negative for a knee bent backwards."""
    knee = HIP + THIGH * np.array([0.0, -np.cos(0.5 * flexion), np.sin(0.5 * flexion)])
    return HIP, knee, knee + SHIN * np.array([0.0, -np.cos(0.5 * flexion), -np.sin(0.5 * flexion)])


def reached(flexion: float, shift: Array, side: Array = SIDE) -> tuple[Array, Array]:
    """Knee and ankle (3,) after the ankle was asked to move by a shift (3,)."""
    hip, knee, ankle = leg(flexion)
    swing, opened = leg_turns(hip, knee, ankle, side, ankle + shift)
    return hip + quat_rotate(swing, knee - hip), hip + quat_rotate(
        swing, knee - hip + quat_rotate(opened, ankle - knee)
    )


@pytest.mark.parametrize("flexion", [-0.05, -0.01, 0.0, 0.01, 0.1, 0.5, 1.5, 2.3])
@pytest.mark.parametrize("shift", [(0.0, 1.0, 0.0), (2.0, 3.0, -4.0), (0.0, 6.0, 5.0), (-8.0, 10.0, 3.0)])
def test_ankles_come_to_their_targets_and_knees_bend_forwards(
    flexion: float, shift: tuple[float, ...]
) -> None:
    knee, ankle = reached(flexion, np.array(shift))
    target = leg(flexion)[2] + shift
    assert np.linalg.norm(ankle - target) < 1e-4
    assert np.isclose(np.linalg.norm(knee - HIP), THIGH) and np.isclose(np.linalg.norm(ankle - knee), SHIN)
    forwards = np.cross(SIDE, target - HIP)  # of the leg's line, in the plane that knees bend in
    assert float((knee - HIP) @ forwards) > 0.0


@pytest.mark.parametrize("flexion", [0.0, 0.005, 0.05, 1.0])
def test_a_leg_that_stays_is_not_turned(flexion: float) -> None:
    knee, ankle = reached(flexion, np.zeros(3))
    assert np.abs(knee - leg(flexion)[1]).max() < 1e-5 and np.abs(ankle - leg(flexion)[2]).max() < 1e-5


@pytest.mark.parametrize("turn", [0.0, 0.35, -0.35])
def test_a_knee_bent_backwards_is_stretched_whatever_its_hinge(turn: float) -> None:
    side = quat_rotate(quat_from_yaw(np.array(turn)), SIDE)
    straight = leg(0.0)[1]
    knees = np.stack([reached(flexion, np.zeros(3), side)[0] for flexion in np.linspace(0.3, -0.6, 46)])
    assert np.linalg.norm(np.diff(knees, axis=0), axis=1).max() < 1.5, "without a leap"
    bent = [leg(flexion)[2] - HIP for flexion in np.linspace(0.3, -0.6, 46)]
    assert np.linalg.norm(knees[0] - straight) > 3.0
    for knee, reach in zip(knees[16:], bent[16:], strict=True):
        beside = np.cross(knee - HIP, reach / np.linalg.norm(reach))
        assert np.linalg.norm(beside) < 0.5, "on the line from the hip to where the ankle was"


def test_a_leg_that_trembles_around_straight_keeps_its_knee_on_one_side() -> None:
    """A leg drawn as straight, bent by half a degree or bent back by as much, whose ankle is raised a little."""
    knees = np.stack([reached(0.01 * np.sin(0.9 * t), np.array([0.3, 1.0, 0.5]))[0] for t in range(60)])
    assert np.linalg.norm(np.diff(knees, axis=0), axis=1).max() < 0.5
    assert knees[:, 2].min() > 4.0


def test_the_plane_of_a_bent_leg_is_kept_and_goes_over_to_the_thighs_while_it_stretches() -> None:
    side = quat_rotate(
        quat_from_yaw(np.array(0.35)), SIDE
    )  # the thigh is turned against the plane of the leg
    knees = np.stack(
        [reached(f, np.array([0.0, 0.5, 0.0]), side)[0] - HIP for f in np.linspace(0.6, 0.0, 120)]
    )
    assert abs(knees[0, 0]) < 1e-6
    assert knees[-1, 0] / knees[-1, 2] == pytest.approx(-np.tan(-0.35), abs=0.02)
    assert np.linalg.norm(np.diff(knees, axis=0), axis=1).max() < 0.5


def test_targets_out_of_reach_are_reached_for() -> None:
    _, ankle = reached(0.3, np.array([0.0, -30.0, 0.0]))
    assert np.linalg.norm(ankle - HIP) == pytest.approx(LOCK.max_reach * (THIGH + SHIN), rel=1e-6)
    assert quat_angle(quat_identity(), leg_turns(*leg(0.0), SIDE, leg(0.0)[2] - [0.0, 30.0, 0.0])[0]) < 1e-6


def test_slip_is_that_of_feet_in_contact() -> None:
    before = np.random.default_rng(0).normal(0.0, 20.0, (3, 4, 3))
    moved = before + np.array([0.2, 5.0, -0.1])
    contacts = np.array([[0.9, 0.9, 0.9, 0.9], [0.1, 0.9, 0.0, 0.0], [0.1, 0.2, 0.1, 0.0]])
    slip = root_slip(before, moved, contacts)
    half = 1.0 + (0.2**2 + 0.1**2) / 2.0**2
    assert np.allclose(slip[:2], np.array([0.2, -0.1]) / half, atol=1e-6) and not slip[2].any()
    moved[0, 2:] += np.array([3.0, 0.0, 0.0])  # one foot steps although it is in contact
    assert (
        root_slip(before, moved, contacts)[0, 0] < 0.2 * moved[0, 2, 0] + 0.6
    )  # less than the mean of all four, 1.7


def test_a_straight_leg_whose_ankle_stays_does_not_turn() -> None:
    """Within its last bits, of which a nearly straight leg makes much of an angle."""
    flexion = np.random.default_rng(0).uniform(0.0, 0.003, 500)
    hips, knees, ankles = (
        np.stack(points).astype(np.float32) for points in zip(*map(leg, flexion), strict=True)
    )
    swing, opened = leg_turns(hips, knees, ankles, np.tile(SIDE, (500, 1)).astype(np.float32), ankles)
    still = np.tile(quat_identity(()), (500, 1))
    assert quat_angle(swing, still).max() < 1e-5 and quat_angle(opened, still).max() < 1e-5
