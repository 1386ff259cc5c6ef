"""Limbs found by shape: the right joints whatever they are called, how sure that is, and what is no human."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motionkit.errors import SkeletonError
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import JOINT_NAMES, Skeleton, canonical_skeleton
from motionkit.rig.mirror import mirror_motion
from motionkit.rig.names import map_rig
from motionkit.rig.shape import limbs_by_shape, opposites_by_shape
from motionkit.rig.sides import joint_sides
from synthetic_rigs import FAMILIES, renamed, walk

NAMELESS = {name: f"bone{joint}" for joint, name in enumerate(JOINT_NAMES)}
LIMBS = [f"{side}{part}" for side in ("Left", "Right") for part in ("UpLeg", "Leg", "Arm", "ForeArm")]


def nameless(motion: Motion) -> Skeleton:
    """The motion's skeleton with names that say nothing."""
    names = tuple(f"n{joint}" for joint in range(len(motion.skeleton)))
    return replace(motion.skeleton, names=names)


@pytest.mark.parametrize("key", FAMILIES)
def test_shape_agrees_with_names(key: str) -> None:
    """The limbs of every family, with and without feet, toes and hands, are found without any name."""
    motion = renamed(walk(), FAMILIES[key])
    named = map_rig(motion.skeleton)
    assert named.by_shape == frozenset() and all(sure > 0.99 for sure in named.likely.values())
    poses = motion_kinematics(motion)[1]
    found = map_rig(nameless(motion), poses)
    assert {name: found.places[name] for name in LIMBS} == {name: named.places[name] for name in LIMBS}
    assert set(LIMBS) <= found.by_shape
    assert found.places["Hips"] == named.places["Hips"]
    if "Head" in named.places:
        assert found.places["Head"] == named.places["Head"]
    assert all(0.5 < found.sure(name) <= 1.0 for name in LIMBS)


def test_sides_come_from_names_or_from_where_feet_point() -> None:
    skeleton = renamed(
        walk(1), {name: name.replace("Left", "zz_L_").replace("Right", "zz_R_") for name in JOINT_NAMES}
    ).skeleton
    turned = replace(skeleton, offsets=skeleton.offsets * np.array([-1, 1, -1], np.float32))
    assert map_rig(turned).places == map_rig(skeleton).places
    mirrored = nameless(
        replace(
            walk(1), skeleton=replace(skeleton, offsets=skeleton.offsets * np.array([-1, 1, 1], np.float32))
        )
    )
    found = map_rig(mirrored)
    assert found.places["LeftUpLeg"] == JOINT_NAMES.index("RightUpLeg")
    assert found.sides_sure > 0.9


def test_without_feet_the_sides_are_a_guess() -> None:
    names = {name: new for name, new in NAMELESS.items() if not name.endswith(("Foot", "ToeBase"))}
    skeleton = renamed(walk(1), names).skeleton
    ends = {joint: end for joint, end in skeleton.end_sites.items() if end[2] < 5.0}
    found = map_rig(replace(skeleton, end_sites=ends))
    assert 0.5 <= found.sides_sure < 1.0


@pytest.mark.parametrize("turn", [0.0, np.pi])
def test_a_body_without_feet_and_bent_knees_faces_where_it_goes(turn: float) -> None:
    """A stiff puppet that glides along tells its sides by its way, whichever way its rest pose faces."""
    names = {name: new for name, new in NAMELESS.items() if not name.endswith(("Foot", "ToeBase"))}
    rest = renamed(walk(1), names).skeleton
    flat = rest.offsets.copy()
    flat[:, 2] = 0.0
    ends = {joint: (x, y, 0.0) for joint, (x, y, z) in rest.end_sites.items()}
    puppet = replace(rest, offsets=flat, end_sites=ends)
    around = np.array([np.cos(turn), 1.0, np.cos(turn)], np.float32)
    way = np.arange(20, dtype=np.float32)[:, None, None] * np.array([0.0, 0.0, 20.0], np.float32) * around
    found = map_rig(puppet, puppet.rest_positions()[None] * around + way)
    assert puppet.names[found.places["LeftUpLeg"]] == NAMELESS["LeftUpLeg"]
    assert 0.7 < found.sides_sure < 0.99
    back = map_rig(puppet, puppet.rest_positions()[None] * around - way)
    assert puppet.names[back.places["LeftUpLeg"]] == NAMELESS["RightUpLeg"]


def test_props_twists_and_fingers_do_not_mislead() -> None:
    source = canonical_skeleton()
    names, parents, offsets = list(source.names), list(source.parents), list(source.offsets)

    def add(above: int, *way: float) -> int:
        names.append(f"x{len(names)}")
        parents.append(above)
        offsets.append(np.array(way, np.float32))
        return len(names) - 1

    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        hand, arm, foot = (JOINT_NAMES.index(side + part) for part in ("Hand", "Arm", "Foot"))
        for finger in range(5):
            tip = hand
            for _ in range(3):
                tip = add(tip, sign * 3.0, 0.0, finger - 2.0)
        add(arm, sign * 15.0, 0.0, 0.0)
        add(foot, 0.0, -5.0, -5.0)
    sword = add(JOINT_NAMES.index("RightHand"), 0.0, 0.0, 20.0)
    add(sword, 0.0, 0.0, 80.0)
    for _ in range(2):
        wing = add(JOINT_NAMES.index("Spine1"), 10.0, 10.0, -10.0)
        offsets[wing][0] *= -1.0 if _ else 1.0
        add(wing, 60.0, 20.0, -20.0)
    skeleton = Skeleton(tuple(f"n{j}" for j in range(len(names))), tuple(parents), np.stack(offsets))
    found = map_rig(skeleton)
    for name in LIMBS:
        assert JOINT_NAMES[found.places[name]] == name


def quadruped() -> Skeleton:
    """A dog: its front legs hang down from its chest as far as its hind legs from its hips."""
    names, parents, offsets = ["b0"], [-1], [(0.0, 0.0, 0.0)]

    def chain(above: int, *ways: tuple[float, float, float]) -> int:
        for way in ways:
            names.append(f"b{len(names)}")
            parents.append(above)
            offsets.append(way)
            above = len(names) - 1
        return above

    chest = chain(0, (0, 0, 20), (0, 0, 20))
    chain(chest, (0, 10, 10), (0, 5, 10))
    for sign in (1, -1):
        chain(0, (sign * 8, 0, 0), (0, -20, 5), (0, -20, -5), (0, -3, 8))
        chain(chest, (sign * 8, 0, 5), (0, -20, -2), (0, -20, 2), (0, -3, 6))
    return Skeleton(tuple(names), tuple(parents), np.array(offsets, np.float32))


def test_a_dog_is_not_taken_for_a_human() -> None:
    dog = quadruped()
    assert limbs_by_shape(dog, joint_sides(dog.names)) is None
    with pytest.raises(SkeletonError, match="not a known human rig: no joint found for LeftUpLeg"):
        map_rig(dog)


def test_a_limb_that_is_missing_is_named_in_one_line() -> None:
    gone = ("LeftUpLeg", "LeftLeg", "LeftFoot", "LeftToeBase")
    skeleton = renamed(walk(1), {name: name for name in JOINT_NAMES if name not in gone}).skeleton
    with pytest.raises(SkeletonError, match=r"no joint found for LeftUpLeg, LeftLeg; the file has") as caught:
        map_rig(skeleton)
    assert "\n" not in str(caught.value)


def test_names_that_contradict_the_shape_are_doubted() -> None:
    """Thigh and shin with each other's names: names win, and the map says that the shape speaks against them."""
    swapped = {name: name for name in JOINT_NAMES} | {"LeftArm": "LeftShoulder", "LeftShoulder": "LeftCollar"}
    swapped |= {"LeftForeArm": "LeftArm", "LeftHand": "LeftForeArm"}
    found = map_rig(renamed(walk(1), swapped).skeleton)
    assert found.places["LeftArm"] == JOINT_NAMES.index("LeftForeArm")
    assert found.sure("LeftArm") < 0.2 and found.sure("LeftLeg") == 1.0


def test_a_helper_on_the_neck_is_no_face() -> None:
    """A mesh joint close to the neck does not make the neck a head, nor a stub behind a hand a hand of its own."""
    source = canonical_skeleton()
    names = tuple(f"n{joint}" for joint in range(len(source) + 1))
    offsets = np.concatenate([source.offsets, np.array([[-0.1, 0.0, 1.0]], np.float32)])
    ends = dict(source.end_sites)
    for side in ("Left", "Right"):
        ends[JOINT_NAMES.index(f"{side}Hand")] = (0.3, 0.1, 0.9)
    parents = (*source.parents, JOINT_NAMES.index("Neck"))
    found = map_rig(Skeleton(names, parents, offsets, ends))
    for name in ("Neck", "Head", "LeftHand", "RightHand"):
        assert JOINT_NAMES[found.places[name]] == name


@pytest.mark.parametrize("key", FAMILIES)
def test_a_rig_without_sides_in_its_names_is_mirrored(key: str) -> None:
    """Twins found by shape are those of the names, and so is the mirror image."""
    motion = renamed(walk(), FAMILIES[key])
    plain = replace(motion, skeleton=nameless(motion))
    one, other = mirror_motion(motion), mirror_motion(plain)
    assert np.allclose(one.local_rotations, other.local_rotations, atol=1e-6)
    assert np.allclose(one.root_positions, other.root_positions, atol=1e-4)


def test_eyes_and_fingers_are_twins_too() -> None:
    source = canonical_skeleton()
    names, parents, offsets = list(source.names), list(source.parents), list(source.offsets)
    for sign in (1.0, -1.0):
        names.append(f"eye{sign}")
        parents.append(JOINT_NAMES.index("Head"))
        offsets.append(np.array([sign * 3.0, 5.0, 8.0], np.float32))
    for side, sign in (("Right", -1.0), ("Left", 1.0)):
        for length in (3.0, 4.0):
            names.append(f"finger{side}{length}")
            parents.append(JOINT_NAMES.index(f"{side}Hand"))
            offsets.append(np.array([sign * length, 0.0, 0.0], np.float32))
    plain = Skeleton(
        tuple(f"n{j}" for j in range(len(names))), tuple(parents), np.stack(offsets), source.end_sites
    )
    twins = opposites_by_shape(plain)
    assert twins is not None
    found = {names[a]: names[b] for a, b in enumerate(twins)}
    assert (found["eye1.0"], found["fingerLeft3.0"]) == ("eye-1.0", "fingerRight3.0")
    assert (found["fingerRight4.0"], found["LeftToeBase"]) == ("fingerLeft4.0", "RightToeBase")
    assert twins[names.index("Spine")] == names.index("Spine")


def test_a_dog_is_not_mirrored() -> None:
    dog = quadruped()
    still = Motion(
        dog,
        np.tile(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (4, len(dog), 1)),
        np.zeros((4, 3), np.float32),
        30.0,
    )
    with pytest.raises(SkeletonError, match="does not have the shape of a human"):
        mirror_motion(still)
