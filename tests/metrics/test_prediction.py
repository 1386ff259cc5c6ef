from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from motionkit.errors import MotionkitError
from motionkit.metrics.prediction import (
    _power,
    position_distance,
    power_distance,
    power_spectrum_similarity,
    rotation_distance,
)
from motionkit.metrics.similarity import expmaps_like, joint_expmaps
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_from_yaw, quat_multiply
from motionkit.motion.skeleton import JOINT_COUNT

from .conftest import placed, swaying


def test_positions_moved_by_a_distance_are_apart_by_it_in_every_joint(motion: Motion) -> None:
    moved = placed(motion, move=(3.0, 0.0, 4.0))
    assert position_distance(moved, motion).value == pytest.approx(5.0 * math.sqrt(JOINT_COUNT), rel=1e-5)


def test_a_quaternion_and_its_negative_are_one_rotation(motion: Motion) -> None:
    assert rotation_distance(
        replace(motion, local_rotations=-motion.local_rotations), motion
    ).value == pytest.approx(0.0, abs=1e-5)


def test_a_turn_of_the_root_turns_every_joint(motion: Motion) -> None:
    yaw = 0.3
    rotations = motion.local_rotations.copy()
    rotations[:, 0] = quat_multiply(quat_from_yaw(np.full(len(motion), yaw)), rotations[:, 0])
    turned = replace(motion, local_rotations=rotations)
    # Unit quaternions whose rotations differ by an angle are 2 sin(angle / 4) apart.
    wanted = 2.0 * math.sin(yaw / 4.0) * math.sqrt(JOINT_COUNT)
    assert rotation_distance(turned, motion).value == pytest.approx(wanted, rel=1e-5)


def test_spectra_do_not_see_a_delay_but_a_change_of_pace() -> None:
    # A joint that swings with 2 Hz, its delayed form, and one with 3 Hz, over whole periods.
    def swinging(hertz: float, delay: float = 0.0) -> Motion:
        motion = swaying(frames=120)
        rotations = np.tile(np.array([1.0, 0.0, 0.0, 0.0]), (120, JOINT_COUNT, 1))
        half = 0.2 * np.sin(2 * math.pi * hertz * (np.arange(120) / 60.0 - delay))
        rotations[:, 5] = np.stack([np.cos(half), np.sin(half), 0 * half, 0 * half], axis=-1)
        return replace(motion, local_rotations=rotations)

    truth = swinging(2.0)
    assert power_spectrum_similarity(swinging(2.0, 0.1), truth).value == pytest.approx(0.0, abs=1e-6)
    # All power has to be moved from the fourth to the sixth frequency of a sequence of 2 s.
    assert power_spectrum_similarity(swinging(3.0), truth).value == pytest.approx(2.0, rel=1e-3)


def test_a_body_that_turns_over_a_little_otherwise_is_nearly_the_same() -> None:
    """Where it is upside down, the shortest exponential map jumps from one side to the other."""

    def turning(extra: float) -> Motion:
        motion = swaying(frames=120)
        rotations = motion.local_rotations.copy()
        half = 0.5 * (2.0 * math.pi * np.arange(120) / 120 + extra)
        rotations[:, 0] = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=-1)
        return replace(motion, local_rotations=rotations)

    similar, other = (power_spectrum_similarity(turning(x), turning(0.0)).value for x in (0.02, 0.0))
    assert other == pytest.approx(0.0, abs=1e-9) and similar is not None and 0.0 < similar < 0.1
    maps = joint_expmaps(turning(0.0))
    assert np.abs(expmaps_like(joint_expmaps(turning(0.02)), maps) - maps).max() < 0.05


def test_motions_of_different_length_are_refused(motion: Motion) -> None:
    for measure in (position_distance, rotation_distance, power_spectrum_similarity):
        with pytest.raises(MotionkitError, match="120 and 100 frames"):
            measure(motion, motion.cut(0, 100))


@pytest.mark.parametrize("held", [0.0, 1e-9])
def test_a_joint_that_a_rig_lacks_counts_as_at_rest(motion: Motion, held: float) -> None:
    """All its power is taken to be that of frequency 0, however little it has."""
    still = motion.local_rotations.copy()
    still[:, 13] = np.array([math.cos(held), math.sin(held), 0.0, 0.0])
    found = power_spectrum_similarity(replace(motion, local_rotations=still), motion).value
    assert found is not None and 0.0 <= found < len(motion)
    made, real = np.zeros((4, 2)), np.array([[0.0, 9.0], [0.0, 1.0], [1.0, 0.0], [0.0, 0.0]])
    made[0] = 0.0, 10.0
    # The first signal has no power: its share moves over two frequencies. In the second a tenth moves over one.
    assert power_distance(made, real) == pytest.approx((1.0 * 2.0 + 10.0 * 0.1) / 11.0)


def test_spectra_have_negative_frequencies_as_in_the_paper() -> None:
    """A signal with a mean and a swing of one period: half of the swing's power is that of the last frequency."""
    time = 2.0 * math.pi * np.arange(8) / 8.0
    swing, mean = (_power(signal[:, None]) for signal in (1.0 + np.cos(time), np.ones(8)))
    assert np.flatnonzero(swing[:, 0] > 1e-9).tolist() == [0, 1, 7]
    # Shares 2/3, 1/6, 1/6 against 1: a third is apart at frequency 0, and a sixth at the next six.
    assert power_distance(mean, swing) == pytest.approx(1.0 / 3.0 + 6.0 / 6.0)
