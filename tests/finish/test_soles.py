"""Soles of a character's mesh on the floor: while a foot stands, and nowhere below it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.control.drive import Driver, Wish
from motionkit.control.script import TypePart
from motionkit.control.synthesize import SynthesisOptions, synthesize
from motionkit.finish.finish import Finish, finish
from motionkit.finish.soles import plant_soles, sole_depth
from motionkit.inference.character import CharacterStream
from motionkit.inference.noise import Noise
from motionkit.models.bundled import load_bundled_model
from motionkit.motion.contacts import foot_contacts
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.leg_ik import ANKLES, TOES
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import expmap_to_quat, quat_multiply, quat_to_matrix
from motionkit.motion.skeleton import canonical_skeleton
from motionkit.rig.on_rig import canonical_on_floor
from motionkit.rig.read_file import read_file
from motionkit.rig.soles import LiveSoles, Sole, body_soles
from motionkit.rig.upright import in_metres
from motionkit.view.asset import BODIES
from motionkit.view.body import make_body

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
    motion = canonical_on_floor(read_file(WALK))[0]
    rotations = motion.local_rotations.copy()
    turned = expmap_to_quat(np.array([bend, 0.0, 0.0], np.float32))  # above zero, toes point into the floor
    rotations[:, TOES] = quat_multiply(rotations[:, TOES], np.broadcast_to(turned, rotations[:, TOES].shape))
    motion = replace(motion, local_rotations=rotations)
    points = FOOT if len(toe) else FOOT + np.array([0.0, -6.0, 12.0], np.float32)
    sole = Sole(points, toe, 3.0, 3.0)
    contacts = foot_contacts(motion_kinematics(motion)[1], motion.fps)
    made = plant_soles(motion, (sole, sole), contacts)
    heights, before = lowest(made, sole), lowest(motion, sole)
    stands = (contacts[:, 1::2] if len(toe) else contacts[:, ::2]) > 0.5
    assert heights.min() > -0.3
    for shown, told in ((motion, before), (made, heights)):
        assert sole_depth(shown, (sole, sole)) == pytest.approx(max(-told.min(), 0.0), abs=1e-3)
    assert (np.abs(heights[stands]) < 1.0).mean() > 0.97 > (np.abs(before[stands]) < 1.0).mean()
    assert np.abs(np.diff(made.root_positions - motion.root_positions, axis=0)).max() < 1.0


@pytest.mark.parametrize("height", [0.0, 3.0, 5.5])
def test_finished_soles_stand_however_high_the_toe_joint_is(height: float) -> None:
    motion, lower = canonical_on_floor(read_file(WALK))[0], np.float32([0.0, 3.0 - height, 0.0])
    sole = Sole(FOOT[2::3] + lower, TOE + lower, height, height)
    contacts = foot_contacts(motion_kinematics(motion)[1], motion.fps)
    made = finish(motion, contacts, Finish(drawn=False, soles=(sole, sole)))
    assert (np.abs(lowest(made, sole)[contacts[:, 1::2] > 0.5]) < 1.0).mean() > 0.99


@pytest.mark.parametrize("toe", [TOE, TOE[:0]])
@pytest.mark.parametrize("floor", [0.0, -2.0])
def test_soles_of_live_characters_stand_on_the_floor(toe: np.ndarray, floor: float) -> None:
    model = load_bundled_model()
    points = FOOT + np.array([0.0, 0.0 if len(toe) else -6.0, 0.0 if len(toe) else 12.0], np.float32)
    sole = Sole(points, toe, 3.0, 3.0)
    heights = {}
    for planted in (False, True):
        worn = {"default": LiveSoles(sole, sole, floor)} if planted else {}
        stream, driver = CharacterStream(replace(model, soles=worn), 1, Noise("mean")), Driver(model)
        driver.set_wish(Wish((0.0, 130.0)))
        made = [stream.step(driver(frame, stream.ground)) for frame in range(210)]
        rotations, roots = (
            np.concatenate([getattr(m, f) for m in made]) for f in ("rotations", "root_positions")
        )
        motion = Motion(model.character("default"), rotations, roots, model.fps)
        # After the first step, in which a foot may rise while it still counts as standing.
        stands = np.concatenate([m.contacts for m in made])[60:, 1 if len(toe) else 0 :: 2] > 0.9
        heights[planted] = lowest(motion, sole)[60:] - floor
        assert np.allclose(
            motion_kinematics(motion)[1], np.concatenate([m.positions for m in made]), atol=0.01
        )
    assert heights[True].min() > -0.5 > heights[False].min() - (floor < 0.0) * 3.0
    held, free = ((np.abs(heights[planted][stands]) < 1.0).mean() for planted in (True, False))
    assert held > 0.97 and held > free


@pytest.mark.parametrize(("foot", "toe"), [(FOOT, TOE * np.float32([1.0, 1.0, -0.1])), (FOOT[:0], TOE)])
def test_a_foot_of_toes_alone_and_toes_behind_their_joint_stand(foot: np.ndarray, toe: np.ndarray) -> None:
    motion, sole = canonical_on_floor(read_file(WALK))[0], Sole(foot, toe, 3.0, 3.0)
    contacts = foot_contacts(motion_kinematics(motion)[1], motion.fps)
    heights = lowest(plant_soles(motion, (sole, sole), contacts), sole)
    assert (np.abs(heights[contacts[:, 1::2] > 0.5]) < 1.0).mean() > 0.97


def test_soles_of_our_body_are_those_of_the_skin_that_is_shown() -> None:
    """They follow the table of soles.json at any tilt of a foot; the other bodies' shoes differ a little."""
    motion = canonical_on_floor(read_file(WALK))[0].cut(0, 60)
    heights = np.stack([lowest(motion, sole) for sole in body_soles(canonical_skeleton())], axis=1)
    told = np.stack([heights[:, side, side] for side in range(2)], axis=1)
    for body in BODIES:
        assert np.abs(lowest_skin(motion, body) - told).max() < (0.2 if body == BODIES[0] else 0.6)


@pytest.mark.parametrize("kind", ["walking", "running"])
def test_our_body_stands_on_its_soles(kind: str) -> None:
    motions = synthesize(load_bundled_model(), [TypePart(kind, 2.0)], SynthesisOptions(count=4)).motions
    heights = np.concatenate([lowest_skin(made.motion, BODIES[0]) for made in motions])
    stands = np.concatenate([made.contacts for made in motions])[:, 1::2] > 0.9
    assert heights.min() > -0.5
    assert (np.abs(heights[stands]) < 1.0).mean() > 0.97


def lowest_skin(motion: Motion, body: str) -> np.ndarray:
    """The lowest point (T, 2) of the skin of both feet of a shown body, in cm."""
    metres = in_metres(motion).motion
    surface, pose = make_body(metres, body=body)
    turns, places = motion_kinematics(metres)
    shares = [
        sum((surface.weights * (surface.joints == joint)).sum(1) for joint in joints)
        for joints in zip(ANKLES, TOES, strict=True)
    ]
    feet = [np.flatnonzero(share > 0.5) for share in shares]
    frames = [
        surface.posed(pose.matrices_from(turned, at))[:, 1]
        for turned, at in zip(
            quat_to_matrix(turns).astype(np.float64), places.astype(np.float64), strict=True
        )
    ]
    return 100.0 * np.stack([[points[foot].min() for foot in feet] for points in frames])
