"""Mirroring: names, geometry, mirroring twice, and rigs of every kind."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motionkit.errors import SkeletonError
from motionkit.motion.bvh import BvhFile, bvh_to_motion, motion_to_bvh, read_bvh, write_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.mirror import reflect_rotations
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    matrix_to_quat,
    quat_angle,
    quat_identity,
    quat_inverse,
    quat_multiply,
    quat_normalize,
    quat_rotate,
    quat_to_matrix,
)
from motionkit.motion.skeleton import JOINT_NAMES, MIRROR_JOINTS, Skeleton, canonical_skeleton
from motionkit.rig.gltf_nodes import VRM_BONES
from motionkit.rig.mirror import mirror_bvh, mirror_file, mirror_motion, mirror_plan
from motionkit.rig.retarget import to_local
from motionkit.rig.sides import joint_sides, opposite_joints
from synthetic_motions import make_walk

BROKEN = Path(__file__).parents[1] / "broken_bvh"
ROOT_CHANNELS = ("Xposition", "Yposition", "Zposition", "Zrotation", "Yrotation", "Xrotation")


def rotations(order: str) -> tuple[str, ...]:
    return tuple(f"{axis}rotation" for axis in order)


def random_motion(skeleton: Skeleton, frames: int = 7, seed: int = 0, spread: float = 0.4) -> Motion:
    """Small random rotations about the rest pose, so that the mean pose stays near it."""
    generator = np.random.default_rng(seed)
    quat = generator.standard_normal((frames, len(skeleton), 4), np.float32) * spread
    quat[..., 0] += 1.0
    return Motion(
        skeleton, quat_normalize(quat), generator.standard_normal((frames, 3), np.float32) * 50.0, 60.0
    )


def world_aligned_rig(left: str = "Left{}", right: str = "Right{}", axis: int = 0) -> Skeleton:
    """Hips, two legs, spine and two arms, left along +axis."""
    bones = (
        ("Hips", -1, 0.0, 0.0),
        (left.format("Leg"), 0, 10.0, -5.0),
        (left.format("Foot"), 1, 1.0, -40.0),
        (right.format("Leg"), 0, -10.0, -5.0),
        (right.format("Foot"), 3, -1.0, -40.0),
        ("Spine", 0, 0.0, 20.0),
        (left.format("Arm"), 5, 15.0, 10.0),
        (left.format("Hand"), 6, 30.0, 0.0),
        (right.format("Arm"), 5, -15.0, 10.0),
        (right.format("Hand"), 8, -30.0, 0.0),
    )
    offsets = np.zeros((len(bones), 3), np.float32)
    offsets[:, axis] = np.array([across for *_, across, _ in bones])
    offsets[:, 1] = np.array([up for *_, up in bones])
    names, parents = tuple(bone[0] for bone in bones), tuple(bone[1] for bone in bones)
    return Skeleton(names, parents, offsets, {2: (0.0, 0.0, 8.0), 4: (0.0, 0.0, 8.0)})


def bone_aligned_rig() -> Motion:
    """A T-pose with small rotations; X points along every bone, and all axes of the right side are inverted."""
    names = (
        "root",
        "hips",
        "spine",
        "arm_L",
        "hand_L",
        "arm_R",
        "hand_R",
        "leg_L",
        "foot_L",
        "leg_R",
        "foot_R",
    )
    parents = (-1, 0, 1, 2, 3, 2, 5, 1, 7, 1, 9)
    offsets = np.array([
            [0, 0, 0], [0, 90, 0], [20, 0, 0], [15, 0, 12], [25, 0, 0], [15, 0, -12], [-25, 0, 0],
            [-3, -9, 0], [40, 0, 0], [-3, 9, 0], [-40, 0, 0],
        ], np.float32)  # fmt: skip
    skeleton = Skeleton(names, parents, offsets)
    inverted = (-1.0, -1.0, -1.0)
    matrices = {
        "hips": [[0, -1, 0], [1, 0, 0], [0, 0, 1]],  # X up, Y to the right
        "spine": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],  # X up, Z to the left
        "arm_L": [[0, -1, 0], [0, 0, -1], [1, 0, 0]],
        "leg_L": [[-1, 0, 0], [0, -1, 0], [0, 0, 1]],
    }
    stance = quat_identity((len(names),))
    for name, matrix in matrices.items():
        stance[names.index(name)] = matrix_to_quat(np.array(matrix, np.float32))
    stance[5] = reflect_rotations(stance[3], (1.0, 1.0, -1.0), inverted)
    stance[9] = reflect_rotations(stance[7], (1.0, -1.0, 1.0), inverted)
    wiggle = random_motion(skeleton, frames=9, seed=3, spread=0.1).local_rotations
    wiggle[:, 0] = quat_identity()
    return Motion(
        skeleton,
        quat_multiply(np.broadcast_to(stance, wiggle.shape), wiggle),
        np.zeros((9, 3), np.float32),
        30.0,
    )


def assert_mirror_image(motion: Motion, mirrored: Motion, tolerance: float = 1e-3) -> None:
    plan = mirror_plan(motion)
    before, after = motion_kinematics(motion)[1], motion_kinematics(mirrored)[1]
    np.testing.assert_allclose(
        after, before[:, list(plan.opposites)] * np.array(plan.world), atol=tolerance, rtol=0
    )


def random_bvh(
    skeleton: Skeleton, channels: list[tuple[str, ...]], seed: int = 0, wide: float = 40.0
) -> BvhFile:
    generator = np.random.default_rng(seed)
    count = sum(len(names) for names in channels)
    return BvhFile(skeleton, tuple(channels), generator.normal(0.0, wide, (6, count)), 1 / 30)


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("LeftArm", "RightArm"),
        ("LHipJoint", "RHipJoint"),
        ("lThigh", "rThigh"),
        ("l_thigh", "r_thigh"),
        ("Shoulder_L", "Shoulder_R"),
        ("thigh.L", "thigh.R"),
        ("Character1_LeftArm", "Character1_RightArm"),
        ("mixamorig:LeftArm", "mixamorig:RightArm"),
        ("left_hip", "right_hip"),
        ("hip_left", "hip_right"),
        ("LEFTHIP", "RIGHTHIP"),
        ("Bip01 L Thigh", "Bip01 R Thigh"),
        ("Bip01_L_Finger0", "Bip01_R_Finger0"),
        ("lhand", "rhand"),
        ("handL", "handR"),
        ("L_Radius_RIGMESH", "R_Radius_RIGMESH"),
    ],
)
def test_sides_are_found_in_every_common_form(left: str, right: str) -> None:
    names = ("Hips", left, right, "lowerback", "Collar")
    assert opposite_joints(names) == (0, 2, 1, 3, 4)
    assert joint_sides(names) == ("", "left", "right", "", "")


def test_a_mark_counts_only_with_a_twin() -> None:
    assert opposite_joints(("Hips", "LeftProp", "rib", "lowerback")) == (0, 1, 2, 3)


def test_canonical_twins_are_those_of_the_skeleton() -> None:
    assert opposite_joints(JOINT_NAMES) == MIRROR_JOINTS


def test_sides_are_known_in_other_languages() -> None:
    names = (
        "Hüfte",
        "Bein_links",
        "Bein_rechts",
        "左腕",
        "右腕",
        "jambe.gauche",
        "jambe.droite",
        "Linkshand",
    )
    assert joint_sides(names) == ("", "left", "right", "left", "right", "left", "right", "")


def test_canonical_mirror_is_the_mirror_image_and_its_own_inverse() -> None:
    motion = random_motion(canonical_skeleton(), spread=0.6)
    mirrored = mirror_motion(motion)
    assert_mirror_image(motion, mirrored)
    again = mirror_motion(mirrored)
    assert np.array_equal(again.local_rotations, motion.local_rotations)
    assert np.array_equal(again.root_positions, motion.root_positions)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), spread=st.floats(0.01, 3.0))
def test_mirror_image_whatever_the_pose(seed: int, spread: float) -> None:
    motion = random_motion(canonical_skeleton(), frames=3, seed=seed, spread=spread)
    assert_mirror_image(motion, mirror_motion(motion))


@settings(max_examples=30, deadline=None)
@given(
    outer=st.sampled_from([(-1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, -1.0), (-1.0, -1.0, -1.0)]),
    inner=st.sampled_from([(-1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, -1.0), (-1.0, -1.0, -1.0)]),
    seed=st.integers(0, 1000),
)
def test_reflected_rotations_are_the_matrix_product(
    outer: tuple[float, float, float], inner: tuple[float, float, float], seed: int
) -> None:
    quat = quat_normalize(np.random.default_rng(seed).standard_normal((5, 4), np.float64))
    expected = np.diag(np.array(outer).astype(np.float64)) @ quat_to_matrix(quat)
    expected = expected @ np.diag(np.array(inner).astype(np.float64))
    np.testing.assert_allclose(quat_to_matrix(reflect_rotations(quat, outer, inner)), expected)


@pytest.mark.parametrize("axis", [0, 2])
def test_the_plane_follows_the_rig(axis: int) -> None:
    motion = random_motion(world_aligned_rig(axis=axis))
    plan = mirror_plan(motion)
    assert plan.world == tuple(-1.0 if a == axis else 1.0 for a in range(3))
    assert_mirror_image(motion, mirror_motion(motion))


def test_a_rig_with_axes_along_its_bones() -> None:
    motion = bone_aligned_rig()
    plan = mirror_plan(motion)
    assert plan.joints[1:5] == ((1.0, -1.0, 1.0), (1.0, 1.0, -1.0), (-1.0, -1.0, -1.0), (-1.0, -1.0, -1.0))
    mirrored = mirror_motion(motion)
    assert mirror_plan(mirrored) == plan
    assert_mirror_image(motion, mirrored)
    again = mirror_motion(mirrored)
    assert float(quat_angle(again.local_rotations, motion.local_rotations).max()) < 1e-3
    # Nothing is rolled by half a turn: the mean pose stays near the stance.
    assert float(quat_angle(mirrored.local_rotations, motion.local_rotations)[:, 2:].max()) < 1.5


def test_hips_that_travel_below_the_root_change_nothing_for_other_joints() -> None:
    """As after `--root ground`: only the hips have position channels, all others stay at their offsets."""
    motion = bone_aligned_rig()
    places = np.tile(motion.skeleton.offsets, (len(motion), 1, 1))
    places[:, 1] += np.random.default_rng(0).normal(0.0, 5.0, (len(motion), 3))
    moved = replace(motion, local_positions=places)
    assert mirror_plan(moved) == mirror_plan(motion)
    bvh = motion_to_bvh(moved, (ROOT_CHANNELS, ROOT_CHANNELS) + (rotations("ZXY"),) * 9)
    assert_mirror_image(moved, bvh_to_motion(mirror_bvh(bvh)), tolerance=0.01)


def test_sides_of_different_length_keep_the_hierarchy() -> None:
    skeleton = world_aligned_rig()
    longer = replace(skeleton, offsets=skeleton.offsets * np.where(np.arange(10)[:, None] == 7, 1.1, 1.0))
    motion = random_motion(longer)
    mirrored = mirror_motion(motion)
    assert mirrored.skeleton is longer
    assert np.array_equal(mirror_motion(mirrored).local_rotations, motion.local_rotations)


def test_bvh_twice_is_exact_and_agrees_with_the_library() -> None:
    skeleton = world_aligned_rig("l{}", "r{}")
    bvh = random_bvh(skeleton, [ROOT_CHANNELS] + [rotations("ZXY")] * 9)
    mirrored = mirror_bvh(bvh)
    assert mirrored.channels == bvh.channels and mirrored.skeleton is bvh.skeleton
    np.testing.assert_array_equal(mirror_bvh(mirrored).values, bvh.values)
    library, file = mirror_motion(bvh_to_motion(bvh)), bvh_to_motion(mirrored)
    assert float(quat_angle(library.local_rotations, file.local_rotations).max()) < 1e-3
    np.testing.assert_allclose(library.root_positions, file.root_positions)


@pytest.mark.parametrize("order", ["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"])
def test_bone_aligned_bvh_twice_in_every_order(order: str) -> None:
    motion = bone_aligned_rig()
    bvh = motion_to_bvh(motion, (ROOT_CHANNELS,) + (rotations(order),) * 10)
    mirrored = mirror_bvh(bvh)
    library, file = mirror_motion(motion), bvh_to_motion(mirrored)
    assert float(quat_angle(library.local_rotations, file.local_rotations).max()) < 2e-3
    twice = mirror_bvh(mirrored)
    again = bvh_to_motion(twice)
    assert float(quat_angle(again.local_rotations, motion.local_rotations).max()) < 1e-3


def test_twins_with_different_orders_go_by_rotations() -> None:
    skeleton = world_aligned_rig()
    channels = [ROOT_CHANNELS] + [rotations("ZYX") if i % 2 else rotations("XYZ") for i in range(1, 10)]
    channels[1], channels[3] = rotations("ZXY"), rotations("YXZ")
    bvh = random_bvh(skeleton, channels, wide=25.0)
    mirrored = mirror_bvh(bvh)
    assert_mirror_image(bvh_to_motion(bvh), bvh_to_motion(mirrored))
    np.testing.assert_allclose(mirror_bvh(mirrored).values, bvh.values, atol=1e-4)


def test_six_channel_joints_mirror_their_places() -> None:
    skeleton = world_aligned_rig()
    bvh = random_bvh(skeleton, [ROOT_CHANNELS] * 10, wide=5.0)
    columns = bvh.columns()
    for joint in range(1, 10):
        bvh.values[:, list(columns[joint])[:3]] += skeleton.offsets[joint]
    mirrored = mirror_bvh(bvh)
    assert_mirror_image(bvh_to_motion(bvh), bvh_to_motion(mirrored))
    np.testing.assert_array_equal(mirror_bvh(mirrored).values, bvh.values)


@pytest.mark.parametrize("told", [False, True])
def test_limbs_whose_names_have_no_side_are_those_of_the_map(told: bool) -> None:
    """Beside eyes that have one: the names alone would make every limb its own opposite."""
    walk = make_walk(60)
    names = walk.skeleton.names
    head = names.index("Head")
    skeleton = Skeleton(
        (*(f"bone{joint:02d}" for joint in range(len(names))), "eye_L", "eye_R"),
        (*walk.skeleton.parents, head, head),
        np.concatenate([walk.skeleton.offsets, np.array([[3.0, 5, 8], [-3, 5, 8]], np.float32)]),
    )
    still = np.tile(np.array([1.0, 0, 0, 0], np.float32), (60, 2, 1))
    motion = replace(
        walk, skeleton=skeleton, local_rotations=np.concatenate([walk.local_rotations, still], axis=1)
    )
    if told:  # an avatar's table, which names no collar bones
        table = {name: joint for joint, name in enumerate(names) if name in VRM_BONES.values()}
        motion = replace(motion, skeleton=replace(skeleton, humanoid=table))
    made, wanted = mirror_motion(motion), mirror_motion(walk)
    assert float(quat_angle(made.local_rotations[:, : len(names)], wanted.local_rotations).max()) < 1e-3


def test_no_sides_is_a_clear_error() -> None:
    skeleton = Skeleton(("a", "b"), (-1, 0), np.array([[0.0, 0, 0], [0, 1, 0]], np.float32))
    with pytest.raises(SkeletonError, match=r"left and a right.*a, b"):
        mirror_motion(random_motion(skeleton))


def test_different_hierarchies_on_the_sides_are_refused() -> None:
    skeleton = world_aligned_rig()
    parents = list(skeleton.parents)
    parents[9] = 0
    with pytest.raises(SkeletonError, match=r"LeftHand has the parent LeftArm but RightHand has Hips"):
        mirror_motion(random_motion(replace(skeleton, parents=tuple(parents))))


def test_different_channels_on_the_sides_are_refused() -> None:
    channels = [ROOT_CHANNELS] + [rotations("ZYX")] * 9
    channels[2] = ("Xrotation",)
    with pytest.raises(SkeletonError, match="LeftFoot has the channels Xrotation but RightFoot Zrotation"):
        mirror_bvh(random_bvh(world_aligned_rig(), channels))


def test_a_side_without_position_channels_gets_those_of_the_other() -> None:
    channels = [ROOT_CHANNELS] + [rotations("ZYX")] * 9
    channels[2] = ROOT_CHANNELS
    bvh = random_bvh(world_aligned_rig(), channels)
    mirrored = mirror_bvh(bvh)
    assert mirrored.channels[4] == ROOT_CHANNELS and mirrored.channels[1] == channels[1]
    assert_mirror_image(bvh_to_motion(bvh), bvh_to_motion(mirrored))


@pytest.mark.parametrize("channels", [None, (ROOT_CHANNELS, *(rotations("ZYX"),) * 22)])
def test_a_rest_pose_without_symmetry(make_motion, channels: tuple[tuple[str, ...], ...] | None) -> None:
    """As cameras record it: the first pose, in which no side is the image of the other, is the rest pose."""
    motion = make_motion(12)
    turned, places = motion_kinematics(motion)
    rest = random_motion(motion.skeleton, 1, seed=5, spread=0.3).local_rotations[0]  # of each joint's frame
    parents = list(motion.skeleton.parents[1:])
    offsets = motion.skeleton.offsets.copy()
    offsets[1:] = quat_rotate(rest[parents], offsets[1:])
    made = replace(
        motion,
        skeleton=replace(motion.skeleton, offsets=offsets, end_sites={}),
        local_rotations=to_local(quat_multiply(turned, np.broadcast_to(quat_inverse(rest), turned.shape))),
    )
    assert np.abs(motion_kinematics(made)[1] - places).max() < 1e-2
    image = mirror_motion(made)
    if channels is not None:
        image = bvh_to_motion(mirror_bvh(motion_to_bvh(made, channels)))
    assert mirror_plan(made).turns is not None
    assert_mirror_image(made, image, tolerance=1.0)
    again = motion_kinematics(mirror_motion(image))[1]
    assert np.abs(again - places).max() < 1e-2


def test_the_axis_that_most_joints_mirror_along_is_not_taken_against_the_limbs() -> None:
    """Of many fingers that are straight along Y, which mirrors along any other axis, and of legs across."""
    rig = world_aligned_rig()
    sides = {"Left": rig.index("LeftHand"), "Right": rig.index("RightHand")}
    names, parents, offsets = list(rig.names), list(rig.parents), [*rig.offsets]
    for finger in range(30):
        for side, hand in sides.items():
            names.append(f"{side}Finger{finger}")
            parents.append(hand)
            offsets.append(np.array([0.0, 5.0, 3.0 if side == "Left" else -3.0], np.float32))
    skeleton = Skeleton(tuple(names), tuple(parents), np.stack(offsets))
    motion = random_motion(skeleton)
    assert_mirror_image(motion, mirror_motion(motion), tolerance=0.5)


def test_single_channel_knees_work() -> None:
    channels = [ROOT_CHANNELS] + [rotations("ZYX")] * 9
    channels[2] = channels[4] = ("Xrotation",)
    channels[7] = channels[9] = ()
    bvh = random_bvh(world_aligned_rig(), channels)
    assert_mirror_image(bvh_to_motion(bvh), bvh_to_motion(mirror_bvh(bvh)))


def test_every_end_site_is_kept(tmp_path: Path) -> None:
    ends = "\tEnd Site\n\t{\n\t\tOFFSET 0 0 9\n\t}\n"
    bvh = motion_to_bvh(random_motion(world_aligned_rig()))
    write_bvh(tmp_path / "a.bvh", bvh)
    text = (tmp_path / "a.bvh").read_text("ascii")
    head, tail = text.split("\tJOINT", 1)  # of the root, which has children as well
    (tmp_path / "a.bvh").write_text(f"{head}{ends}{ends}\tJOINT{tail}", "ascii")
    mirror_file(tmp_path / "a.bvh", tmp_path / "b.bvh")
    before, after = ((tmp_path / name).read_text("ascii").split("MOTION")[0] for name in ("a.bvh", "b.bvh"))
    assert after == before and after.count("End Site") == text.count("End Site") + 2


def test_files_twice_within_a_ten_thousandth(tmp_path: Path) -> None:
    bvh = random_bvh(world_aligned_rig(), [ROOT_CHANNELS] + [rotations("YXZ")] * 9)
    write_bvh(tmp_path / "a.bvh", bvh)
    mirror_file(tmp_path / "a.bvh", tmp_path / "b.bvh")
    mirror_file(tmp_path / "b.bvh", tmp_path / "c.bvh")
    assert (tmp_path / "a.bvh").read_text() == (tmp_path / "c.bvh").read_text()
    np.testing.assert_allclose(read_bvh(tmp_path / "c.bvh").values, bvh.values, atol=1e-4)


def test_a_bone_without_length_whose_twin_is_ten_kilometres_long(make_motion) -> None:
    """Its misfit is so large that adding a thousandth does not change it."""
    bvh = motion_to_bvh(make_motion(4))
    bvh.skeleton.offsets[bvh.skeleton.index("LeftForeArm")] = 0.0
    bvh.skeleton.offsets[bvh.skeleton.index("RightForeArm"), 0] = -1e7
    assert np.isfinite(mirror_bvh(bvh).values).all()
