"""Retargeting of other rigs: names, rest poses, units, missing joints."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.arrays import Array, normalized
from motionkit.errors import SkeletonError
from motionkit.motion.bvh import BvhFile, motion_to_bvh, read_bvh, write_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    expmap_to_quat,
    quat_angle,
    quat_identity,
    quat_inverse,
    quat_multiply,
    quat_normalize,
    quat_rotate,
)
from motionkit.motion.skeleton import JOINT_NAMES, PARENTS, Skeleton, canonical_skeleton, mirrored_name
from motionkit.rig.names import EXCHANGED, map_rig, name_part
from motionkit.rig.on_rig import read_rig
from motionkit.rig.retarget import retarget, retarget_file
from motionkit.rig.up_axis import turned_world, up_turn
from synthetic_rigs import FAMILIES, renamed, turned_rest, walk


def directions(motion: Motion, pairs: list[tuple[str, str]]) -> Array:
    """Unit vectors (T, P, 3) from joint to joint."""
    _, positions = motion_kinematics(motion)
    index = motion.skeleton.index
    bones = np.stack([positions[:, index(b)] - positions[:, index(a)] for a, b in pairs], axis=1)
    return normalized(bones)


LIMB_PAIRS = [
    (f"{side}{a}", f"{side}{b}")
    for side in ("Left", "Right")
    for a, b in (("UpLeg", "Leg"), ("Leg", "Foot"), ("Arm", "ForeArm"))
]


def worst_angle(source: Motion, result: Motion, mapped: dict[str, str]) -> float:
    """The largest angle in degrees between the limb bones of source and result."""
    theirs = directions(source, [(mapped[a], mapped[b]) for a, b in LIMB_PAIRS])
    ours = directions(result, LIMB_PAIRS)
    sine = np.linalg.norm(np.cross(theirs, ours), axis=-1)
    return float(np.rad2deg(np.arctan2(sine, (theirs * ours).sum(-1))).max())


@pytest.mark.parametrize("key", FAMILIES)
def test_naming_families(key: str, tmp_path: Path) -> None:
    """Every rig family is mapped by name, from a file, and limb directions are preserved."""
    source = renamed(walk(), FAMILIES[key])
    write_bvh(tmp_path / "clip.bvh", source)
    result, report = retarget_file(tmp_path / "clip.bvh")
    # Names with spaces reach us with underscores.
    expected = {ours: theirs.replace(" ", "_") for ours, theirs in FAMILIES[key].items()}
    limbs = {k: v for k, v in expected.items() if k.startswith(("Left", "Right"))}
    assert {k: v for k, v in report.mapped.items() if k.startswith(("Left", "Right"))} == limbs
    assert report.mapped["Hips"] == expected["Hips"]
    assert set(report.missing) == set(JOINT_NAMES) - set(expected)
    assert report.scale == 1.0
    assert worst_angle(read_motion(tmp_path / "clip.bvh"), result, report.mapped) < 0.1
    assert len(result) == len(source) and result.fps == 30.0


def read_motion(path: Path) -> Motion:
    from motionkit.motion.bvh import bvh_to_motion

    return bvh_to_motion(read_bvh(path))


def test_the_canonical_skeleton_maps_onto_itself() -> None:
    source = walk()
    result, report = retarget(motion_to_bvh(source))
    assert report.missing == () and report.notes == ()
    assert report.root_scale == pytest.approx(1.0, abs=1e-5)
    assert float(quat_angle(source.local_rotations, result.local_rotations).max()) < 1e-3
    assert float(np.abs(source.root_positions - result.root_positions).max()) < 1e-3
    assert float(np.abs(report.body - canonical_skeleton().offsets).max()) < 1e-3


@pytest.mark.parametrize(("factor", "scale"), [(0.01, 100.0), (10.0, 0.1), (0.45 / 2.54, 2.54 / 0.45)])
def test_units_are_guessed_and_the_result_is_the_same(factor: float, scale: float) -> None:
    source = walk()
    result, report = retarget(motion_to_bvh(source.scaled(factor)))
    assert report.scale == pytest.approx(scale)
    assert "detected" in report.scale_source
    assert float(np.abs(source.root_positions - result.root_positions).max()) < 1e-2


def test_a_given_scale_and_rate_win() -> None:
    result, report = retarget(motion_to_bvh(walk()), scale=1.2, fps=120.0)
    assert report.scale == 1.2 and report.scale_source == "given"
    assert report.root_scale == pytest.approx(1 / 1.2, rel=1e-4)
    assert result.fps == 120.0


def test_own_body_keeps_positions() -> None:
    """A child's body of canonical shape: own_body keeps its joint positions, otherwise the canonical ones result."""
    source = walk().scaled(0.8)
    own, report = retarget(motion_to_bvh(source), own_body=True)
    scaled, _ = retarget(motion_to_bvh(source))
    assert report.scale == 1.0 and report.root_scale == pytest.approx(1.25, rel=1e-4)
    assert float(np.abs(motion_kinematics(own)[1] - motion_kinematics(source)[1]).max()) < 0.01
    full = motion_kinematics(walk())[1]
    assert float(np.abs(motion_kinematics(scaled)[1] - full).max()) < 0.01


def test_missing_joints_do_not_move_and_others_compose_in() -> None:
    names = {name: name for name in JOINT_NAMES if name not in ("Neck1", "LowerBack", "LeftToeBase")}
    source = walk()
    result, report = retarget(motion_to_bvh(renamed(source, names)))
    assert set(report.missing) == {"Neck1", "LowerBack", "LeftToeBase"}
    for name in report.missing:
        turn = result.local_rotations[:, JOINT_NAMES.index(name)]
        assert float(quat_angle(turn, quat_identity((len(source),))).max()) < 1e-3
    before, after = motion_kinematics(source)[0], motion_kinematics(result)[0]
    for name in ("Hips", "Spine", "Head", "LeftFoot", "RightHand"):
        joint = JOINT_NAMES.index(name)
        assert float(quat_angle(before[:, joint], after[:, joint]).max()) < 1e-3


def test_fingers_meshes_and_a_root_above_the_hips() -> None:
    source = walk()
    skeleton = source.skeleton
    extra = ("Armature", *JOINT_NAMES, "LeftHandIndex1", "L_Femur_RIGMESH", "HeadTop_End")
    hand, thigh, head = (JOINT_NAMES.index(n) + 1 for n in ("LeftHand", "LeftUpLeg", "Head"))
    parents = (-1, 0, *(p + 1 for p in PARENTS[1:]), hand, thigh, head)
    added = np.array([[8.0, 0, 0], [0, -5.0, 0], [0, 10.0, 0]], np.float32)
    offsets = np.concatenate([np.zeros((1, 3), np.float32), skeleton.offsets, added])
    turns = quat_identity((len(source), len(extra)))
    turns[:, 1:24] = source.local_rotations
    lifted = expmap_to_quat(np.array([0.0, 0.6, 0.0], np.float32))
    turns[:, 0] = lifted
    rig = Motion(Skeleton(extra, parents, offsets), turns, source.root_positions, 30.0)
    result, report = retarget(motion_to_bvh(rig))
    assert report.missing == ()
    expected = quat_multiply(np.broadcast_to(lifted, (len(source), 4)), source.local_rotations[:, 0])
    assert float(quat_angle(expected, result.local_rotations[:, 0]).max()) < 1e-3
    others = quat_angle(source.local_rotations[:, 1:], result.local_rotations[:, 1:])
    assert float(others.max()) < 1e-3


HEADS = {
    "face": {"LeftEye": (3.0, 5.0, 9.0), "RightEye": (-3.0, 5.0, 9.0), "Jaw": (0.0, -2.0, 6.0)},
    "ponytail": {"Ponytail": (0.0, 3.0, -12.0)},
    "hair": {"HairL": (6.0, 1.0, -9.0), "HairR": (-6.0, 1.0, -9.0)},
    "unnamed": {"b1": (0.0, 0.0, -14.0), "b2": (0.0, 4.0, 0.4)},
    "top": {"LeftEye": (3.0, 5.0, 9.0), "HeadTop_End": (0.0, 10.0, 0.0)},
}


def with_children(motion: Motion, above: str, children: dict[str, tuple[float, float, float]]) -> Motion:
    """The motion with more joints below one, at rest."""
    skeleton, joint = motion.skeleton, motion.skeleton.index(above)
    more = len(children)
    ends = {j: end for j, end in skeleton.end_sites.items() if j != joint}
    grown = Skeleton(
        (*skeleton.names, *children),
        (*skeleton.parents, *[joint] * more),
        np.concatenate([skeleton.offsets, np.array(list(children.values()), np.float32)]),
        ends | {len(skeleton) + i: (0.0, 0.0, 1.0) for i in range(more)},
    )
    turns = np.concatenate([motion.local_rotations, quat_identity((len(motion), more))], axis=1)
    return replace(motion, skeleton=grown, local_rotations=turns)


@pytest.mark.parametrize("key", HEADS)
def test_face_and_hair_do_not_tilt_the_head(key: str) -> None:
    source = walk()
    result, _ = retarget(motion_to_bvh(with_children(source, "Head", HEADS[key])))
    assert quat_angle(result.local_rotations, source.local_rotations).max() < 1e-3


def test_a_head_that_hangs_in_the_rest_pose_is_turned_by_its_top() -> None:
    """The end of the head counts where the rig has face bones too."""
    changes = quat_identity((len(JOINT_NAMES),))
    changes[JOINT_NAMES.index("Head")] = expmap_to_quat(np.array([math.radians(80.0), 0.0, 0.0], np.float32))
    source = walk()
    hanging = turned_rest(source, changes)
    end = hanging.skeleton.end_sites[JOINT_NAMES.index("Head")]
    children = {"LeftEye": (3.0, -9.0, 5.0), "HeadTop_End": end}
    result, _ = retarget(motion_to_bvh(with_children(hanging, "Head", children)))
    assert np.rad2deg(quat_angle(result.local_rotations, source.local_rotations)).max() < 8.0


@pytest.mark.parametrize(
    ("joint", "offset", "end"),
    [("Head", None, (9.0, 1.0, 0.0)), ("ToeBase", (0.0, -5.0, 0.2), (0.0, 0.0, 9.0))],
    ids=["head ends at its side", "toes under the ankles"],
)
def test_ends_that_mislead_do_not_turn_the_body(
    joint: str, offset: tuple[float, ...] | None, end: tuple[float, float, float]
) -> None:
    source = walk()
    offsets, ends = source.skeleton.offsets.copy(), dict(source.skeleton.end_sites)
    for index, name in enumerate(JOINT_NAMES):
        if name.endswith(joint):
            ends[index] = end
            offsets[index] = offsets[index] if offset is None else offset
    made = replace(source, skeleton=replace(source.skeleton, offsets=offsets, end_sites=ends))
    result, _ = retarget(motion_to_bvh(made))
    assert np.rad2deg(quat_angle(result.local_rotations, source.local_rotations)).max() < 16.0


@pytest.mark.parametrize(
    "name", ["ik_foot_l", "IK_Hand.R", "LeftFoot_IK", "HeadTop_End", "poleLeftKnee", "root"]
)
def test_helpers_are_no_parts_of_the_body(name: str) -> None:
    assert name_part(name)[1] in ("", "other")


def test_arms_that_hang_in_the_rest_pose() -> None:
    """Rest poses are compared, not copied: hanging and level arms give the same result."""
    source = walk()
    changes = quat_identity((len(JOINT_NAMES),))
    for joint, name in enumerate(JOINT_NAMES):
        if name.endswith(("Arm", "Hand")):
            side = -1.0 if name.startswith("Left") else 1.0
            changes[joint] = expmap_to_quat(np.array([0.0, 0.0, side * math.pi / 2], np.float32))
    result, report = retarget(motion_to_bvh(turned_rest(source, changes)))
    assert float(quat_angle(source.local_rotations, result.local_rotations).max()) < 2e-3
    assert any(
        re.search(r"up to 90 degrees \((Left|Right)(Arm|ForeArm|Hand)\)", note) for note in report.notes
    ), report.notes


@pytest.mark.parametrize("axis", ["X", "-Z"])
def test_a_rest_pose_that_faces_elsewhere(axis: str) -> None:
    source = walk()
    yaw = math.pi / 2 if axis == "X" else math.pi
    changes = np.broadcast_to(expmap_to_quat(np.array([0.0, yaw, 0.0], np.float32)), (len(JOINT_NAMES), 4))
    result, report = retarget(motion_to_bvh(turned_rest(source, changes)))
    assert float(quat_angle(source.local_rotations, result.local_rotations).max()) < 2e-3
    assert any("faces" in note for note in report.notes)


def test_z_up_is_turned() -> None:
    source = walk()
    tilt = expmap_to_quat(np.array([math.pi / 2, 0.0, 0.0], np.float32))  # Y up becomes Z up
    rig = turned_rest(source, np.broadcast_to(tilt, (len(JOINT_NAMES), 4)))
    turns = rig.local_rotations.copy()
    turns[:, 0] = quat_multiply(np.broadcast_to(tilt, (len(source), 4)), turns[:, 0])
    rig = replace(rig, local_rotations=turns, root_positions=quat_rotate(tilt, rig.root_positions))
    result, report = retarget(motion_to_bvh(rig))
    assert any("up axis +Z" in note for note in report.notes)
    assert float(np.abs(motion_kinematics(source)[1] - motion_kinematics(result)[1]).max()) < 0.05


def test_a_rest_pose_that_is_no_human_pose() -> None:
    """With random axes at every joint, the motion itself determines how the body stands."""
    source = walk(120)
    generator = np.random.default_rng(3)
    changes = quat_normalize(generator.standard_normal((len(JOINT_NAMES), 4), np.float32))
    result, report = retarget(motion_to_bvh(turned_rest(source, changes)))
    assert any("not a standing human" in note for note in report.notes)
    before, after = motion_kinematics(source)[0], motion_kinematics(result)[0]
    degrees = np.rad2deg(quat_angle(before, after)).max(0)
    for name in (pair[0] for pair in LIMB_PAIRS):
        assert float(degrees[JOINT_NAMES.index(name)]) < 1.0, name
    for name in ("Hips", "Spine1", "Head"):
        assert float(degrees[JOINT_NAMES.index(name)]) < 15.0, name
    pairs = {a: a for pair in LIMB_PAIRS for a in pair}
    assert worst_angle(source, result, pairs) < 0.1


def test_six_channel_joints_take_their_place_from_the_channels() -> None:
    """Some files have OFFSET zero and place every joint by its position channels."""
    source = walk()
    places = np.tile(source.skeleton.offsets, (len(source), 1, 1))
    empty = replace(source.skeleton, offsets=np.zeros((len(JOINT_NAMES), 3), np.float32))
    rig = replace(source, skeleton=empty, local_positions=places)
    result, report = retarget(motion_to_bvh(rig))
    assert report.scale == 1.0
    assert float(np.abs(motion_kinematics(source)[1] - motion_kinematics(result)[1]).max()) < 0.01


@pytest.mark.parametrize("length", [0.2, 8.0])
def test_feet_that_end_in_their_soles_stand_flat(length: float) -> None:
    """A foot without toes may have its End Site straight below, which does not show where it points."""
    source = walk(30)
    kept = [j for j, name in enumerate(JOINT_NAMES) if not name.endswith("ToeBase")]
    ends = {j: end for j, end in source.skeleton.end_sites.items() if j in kept}
    parents = tuple(kept.index(PARENTS[j]) if j else -1 for j in kept)
    results = []
    for below in (0.0, length):
        soles = {JOINT_NAMES.index(f"{side}Foot"): (0.0, -below, 0.0) for side in ("Left", "Right")}
        skeleton = Skeleton(
            tuple(JOINT_NAMES[j] for j in kept),
            parents,
            source.skeleton.offsets[kept],
            {kept.index(j): end for j, end in (ends | soles).items()},
        )
        rig = Motion(skeleton, source.local_rotations[:, kept], source.root_positions, source.fps)
        results.append(retarget(motion_to_bvh(rig))[0].local_rotations)
    assert float(quat_angle(*results).max()) < 1e-3


def test_twist_joints_along_a_limb_count() -> None:
    """The roll of a forearm on a separate twist joint still reaches the hand's parent."""
    source = walk()
    names = list(JOINT_NAMES)
    at = names.index("LeftHand")
    arm = names.index("LeftForeArm")
    names.insert(at, "LeftForeArmRoll")
    shift = [p + (p >= at) if p >= 0 else -1 for p in PARENTS]
    parents = (*shift[:at], arm, at, *shift[at + 1 :])
    half = source.skeleton.offsets[at] * 0.5
    offsets = np.concatenate(
        [source.skeleton.offsets[:at], half[None], half[None], source.skeleton.offsets[at + 1 :]]
    )
    twist = np.broadcast_to(expmap_to_quat(np.array([0.5, 0.0, 0.0], np.float32)), (len(source), 1, 4))
    hand = quat_multiply(quat_inverse(twist[:, 0]), source.local_rotations[:, at])[:, None]
    turns = np.concatenate(
        [source.local_rotations[:, :at], twist, hand, source.local_rotations[:, at + 1 :]], 1
    )
    rig = Motion(Skeleton(tuple(names), parents, offsets), turns, source.root_positions, 30.0)
    result, report = retarget(motion_to_bvh(rig))
    assert report.mapped["LeftForeArm"] == "LeftForeArm"
    expected = quat_multiply(source.local_rotations[:, arm], twist[:, 0])
    assert float(quat_angle(expected, result.local_rotations[:, arm]).max()) < 2e-3


def tiny(names: tuple[str, ...], parents: tuple[int, ...]) -> BvhFile:
    skeleton = Skeleton(names, parents, np.array([[0.0, 10.0, 0.0]] * len(names), np.float32))
    turns = quat_identity((2, len(names)))
    return motion_to_bvh(Motion(skeleton, turns, np.zeros((2, 3), np.float32), 30.0))


def test_not_a_human(tmp_path: Path) -> None:
    dog = tiny(("Body", "Tail1", "FrontLeftPaw", "Snout"), (-1, 0, 0, 0))
    with pytest.raises(SkeletonError, match=r"LeftUpLeg.*the file has the joints Body, Tail1") as caught:
        retarget(dog)
    assert "\n" not in str(caught.value)
    write_bvh(tmp_path / "dog.bvh", dog)
    with pytest.raises(SkeletonError, match=r"dog\.bvh: not a known human rig"):
        retarget_file(tmp_path / "dog.bvh")


def test_an_arm_missing_is_named() -> None:
    gone = ("LeftShoulder", "LeftArm", "LeftForeArm", "LeftHand")
    names = {name: name for name in JOINT_NAMES if name not in gone}
    with pytest.raises(SkeletonError, match="no joint found for LeftArm, LeftForeArm;"):
        retarget(motion_to_bvh(renamed(walk(), names)))


def test_thighs_on_the_spine_and_collars_on_the_neck() -> None:
    """3ds Max's Biped attaches its limbs elsewhere; the torso is still found."""
    names = FAMILIES["biped"]
    source = renamed(walk(), names)
    skeleton = source.skeleton
    old = skeleton.rest_positions()
    parents = list(skeleton.parents)
    for side in ("Left", "Right"):
        parents[skeleton.index(names[f"{side}UpLeg"])] = skeleton.index(names["LowerBack"])
        parents[skeleton.index(names[f"{side}Shoulder"])] = skeleton.index(names["Neck"])
    order = sorted(range(len(parents)), key=lambda j: _depth(parents, j))
    new = {j: i for i, j in enumerate(order)}
    rig = Skeleton(
        tuple(skeleton.names[j] for j in order),
        tuple(new[parents[j]] if parents[j] >= 0 else -1 for j in order),
        np.stack([old[j] - old[parents[j]] if parents[j] >= 0 else old[j] for j in order]),
    )
    report = retarget(
        motion_to_bvh(Motion(rig, source.local_rotations[:, order], source.root_positions, 30.0))
    )[1]
    assert report.mapped == names


def _depth(parents: list[int], joint: int) -> int:
    return 0 if joint < 0 else 1 + _depth(parents, parents[joint])


@pytest.mark.parametrize(("joint", "size"), [("Spine", 0.0), ("LeftForeArm", 1e6)])
def test_bones_without_length_are_refused(joint: str, size: float) -> None:
    """All of them, or those beside one bone that is far too long."""
    source = walk()
    offsets = source.skeleton.offsets * bool(size)
    offsets[source.skeleton.names.index(joint)] *= size
    flat = replace(source, skeleton=replace(source.skeleton, offsets=offsets, end_sites={}))
    with pytest.raises(SkeletonError, match="of zero length or less than a hundredth of that of"):
        retarget(motion_to_bvh(flat))


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("mixamorig1:RightForeArm", ("Right", "forearm")),
        ("Armature|thigh.R", ("Right", "thigh")),
        ("Bip001 R Calf", ("Right", "shin")),
        ("ValveBiped.Bip01_L_UpperArm", ("Left", "upperarm")),
        ("J_Bip_R_LowerLeg", ("Right", "shin")),
        ("DEF-upper_arm.L", ("Left", "upperarm")),
        ("ElbowRight", ("Right", "forearm")),
        ("LHipJoint", ("Left", "other")),
        ("upperarm_twist_01_l", ("Left", "other")),
        ("RightHandThumb2", ("Right", "other")),
        ("HeadTop_End", ("", "other")),
        ("lowerback", ("", "")),
        ("joint_Root", ("", "")),
    ],
)
def test_names(name: str, expected: tuple[str, str]) -> None:
    assert name_part(name) == expected


def test_the_same_word_means_what_its_neighbours_leave_over() -> None:
    """LeftShoulder is a collar bone if there is an arm, and an upper arm if there is an elbow."""
    style = map_rig(renamed(walk(1), FAMILIES["100style"]).skeleton)
    lafan = map_rig(renamed(walk(1), FAMILIES["lafan1"]).skeleton)
    style_names = renamed(walk(1), FAMILIES["100style"]).skeleton.names
    lafan_names = renamed(walk(1), FAMILIES["lafan1"]).skeleton.names
    assert style_names[style.places["LeftArm"]] == "LeftShoulder"
    assert lafan_names[lafan.places["LeftShoulder"]] == "LeftShoulder"


def test_results_are_finite_for_one_frame() -> None:
    result, _ = retarget(motion_to_bvh(walk(1)))
    assert np.isfinite(result.local_rotations).all() and len(result) == 1


@pytest.mark.parametrize("toes", [True, False])
def test_sides_are_exchanged_if_feet_point_backwards_by_the_names_and_this_is_said(toes: bool) -> None:
    """As in captures that a camera has mirrored; nothing else of the motion changes."""
    same = {name: name for name in JOINT_NAMES if toes or not name.endswith("ToeBase")}
    wanted, was = retarget(motion_to_bvh(renamed(walk(20), same)))
    made, report = retarget(motion_to_bvh(renamed(walk(20), {name: mirrored_name(name) for name in same})))
    assert np.array_equal(made.local_rotations, wanted.local_rotations)
    assert report.mapped["LeftFoot"] == "RightFoot"
    assert EXCHANGED in report.notes and EXCHANGED not in was.notes


@pytest.mark.parametrize("signs", [(-1.0, -1.0, -1.0), (-1.0, 1.0, 1.0), (1.0, 1.0, -1.0)])
def test_a_rig_of_negative_scale_is_read_as_one_of_exchanged_sides(signs: tuple[float, float, float]) -> None:
    """A negative scale turns the body inside out: names and feet contradict each other."""
    motion = walk(20)
    offsets = motion.skeleton.offsets * np.array(signs, np.float32)
    mirrored = replace(motion, skeleton=replace(motion.skeleton, offsets=offsets))
    made, report = retarget(motion_to_bvh(mirrored))
    assert EXCHANGED in report.notes
    up = np.array([0.0, np.sign(signs[1]), 0.0], np.float32)
    assert worst_angle(turned_world(mirrored, up_turn(up)), made, report.mapped) < 0.1


@pytest.mark.parametrize(
    ("parts", "toes", "says"),
    [
        (
            ("UpLeg", "Leg", "Foot", "ToeBase"),
            True,
            "for the legs: RightUpLeg (LeftUpLeg) is on the right side",
        ),
        (
            ("Shoulder", "Arm", "ForeArm", "Hand"),
            True,
            "for the arms: RightArm (LeftArm) is on the right side",
        ),
        (("UpLeg", "Leg", "Foot"), False, "RightUpLeg (LeftUpLeg) is on the side of RightArm (RightArm)"),
    ],
)
def test_a_map_that_exchanges_left_and_right_is_refused(
    tmp_path: Path, parts: tuple[str, ...], toes: bool, says: str
) -> None:
    names = {name: name for name in JOINT_NAMES if toes or not name.endswith("ToeBase")}
    write_bvh(tmp_path / "rig.bvh", renamed(walk(), names))
    for part in parts:
        names |= {f"Left{part}": f"Right{part}", f"Right{part}": f"Left{part}"}
    (tmp_path / "map.json").write_text(json.dumps({"joints": names}))
    with pytest.raises(SkeletonError, match=re.escape(says)):
        read_rig(tmp_path / "rig.bvh", tmp_path / "map.json")
    read_rig(tmp_path / "rig.bvh")


def test_a_map_that_exchanges_all_of_left_and_right_is_refused_whatever_the_rest_pose(tmp_path: Path) -> None:
    changes = np.random.default_rng(3).standard_normal((len(JOINT_NAMES), 4), np.float32)
    write_bvh(tmp_path / "rig.bvh", turned_rest(walk(120), quat_normalize(changes)))
    read_rig(tmp_path / "rig.bvh")
    (tmp_path / "map.json").write_text(
        json.dumps({"joints": {name: mirrored_name(name) for name in JOINT_NAMES}})
    )
    with pytest.raises(SkeletonError, match="the feet RightFoot and LeftFoot point backwards"):
        read_rig(tmp_path / "rig.bvh", tmp_path / "map.json")


@pytest.mark.parametrize("degrees", [90.0, 180.0, -90.0])
def test_a_clip_of_the_canonical_joints_may_lie_or_stand_on_its_head(tmp_path: Path, degrees: float) -> None:
    upright = walk(4)
    half = np.deg2rad(degrees) / 2
    roll = np.array([np.cos(half), 0.0, 0.0, np.sin(half)], np.float32)
    rotations = upright.local_rotations.copy()
    rotations[:, 0] = quat_multiply(np.broadcast_to(roll, rotations[:, 0].shape), rotations[:, 0])
    lying = replace(upright, local_rotations=rotations)
    write_bvh(tmp_path / "lying.bvh", lying)
    read, report = retarget_file(tmp_path / "lying.bvh")
    assert not any("up axis" in note for note in report.notes)
    assert np.allclose(motion_kinematics(read)[1], motion_kinematics(lying)[1], atol=0.5)
