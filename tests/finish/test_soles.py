"""Soles of a character's mesh on the floor: while a foot stands, and nowhere below it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.finish.soles import plant_soles
from motionkit.motion.contacts import foot_contacts
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.leg_ik import ANKLES, TOES
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import expmap_to_quat, quat_multiply, quat_to_matrix
from motionkit.rig.on_rig import read_motion
from motionkit.rig.soles import Sole

WALK = Path(__file__).parents[2] / "examples/data/16_33.bvh"
FOOT = np.array([[x, -3.0, z] for x in (-4.0, 4.0) for z in (-17.0, -9.0, 0.0)], np.float32)
TOE = np.array([[x, -3.0, z] for x in (-4.0, 4.0) for z in (1.0, 8.0)], np.float32)


def lowest(motion: Motion, sole: Sole) -> np.ndarray:
    """The lowest point (T, 2) of each foot, in cm."""
    turns, places = motion_kinematics(motion)
    joints = TOES if len(sole.toe) else ANKLES
    parts = [(sole.foot, ANKLES), (sole.toe, TOES)]
    heights = [
        (quat_to_matrix(turns[:, turning])[:, :, 1] @ points.T).min(-1, initial=np.inf)
        for points, turning in parts
    ]
    return np.minimum(*heights) + places[:, joints, 1]


@pytest.mark.parametrize("bend", [-0.4, 0.0, 0.5])
@pytest.mark.parametrize("toe", [TOE, TOE[:0]])
def test_soles_stand_on_the_floor_and_are_nowhere_below_it(bend: float, toe: np.ndarray) -> None:
    motion = read_motion(WALK)[0]
    rotations = motion.local_rotations.copy()
    turned = expmap_to_quat(np.array([bend, 0.0, 0.0], np.float32))  # above zero, toes point into the floor
    rotations[:, TOES] = quat_multiply(rotations[:, TOES], np.broadcast_to(turned, rotations[:, TOES].shape))
    motion = replace(motion, local_rotations=rotations)
    points = FOOT if len(toe) else FOOT + np.array([0.0, -6.0, 12.0], np.float32)
    sole = Sole(points, toe, 3.0)
    contacts = foot_contacts(motion_kinematics(motion)[1], motion.fps)
    made = plant_soles(motion, (sole, sole), contacts)
    heights, before = lowest(made, sole), lowest(motion, sole)
    stands = (contacts[:, 1::2] if len(toe) else contacts[:, ::2]) > 0.5
    assert heights.min() > -0.3
    assert (np.abs(heights[stands]) < 1.0).mean() > 0.97 > (np.abs(before[stands]) < 1.0).mean()
    assert np.abs(np.diff(made.root_positions - motion.root_positions, axis=0)).max() < 1.0
