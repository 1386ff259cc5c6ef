"""Clips in place, and with a root joint on the floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.cli.rig_options import RootMotion
from motionkit.editing.root_motion import at_origin, ground_track, in_place, root_bone, with_ground_root
from motionkit.errors import SkeletonError
from motionkit.export.formats import read_motion, write_motion
from motionkit.features.heading import heading_angles
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    quat_between,
    quat_identity,
    quat_inverse,
    quat_multiply,
    quat_rotate,
    quat_to_expmap,
)
from motionkit.motion.skeleton import Skeleton
from motionkit.rig.canonical import canonical_motion
from motionkit.rig.upright import Upright
from synthetic_motions import make_walk

CMU = Path(__file__).resolve().parents[2] / "examples" / "data" / "16_45.bvh"


@pytest.fixture(scope="module", params=["canonical", "CMU", "Z up"])
def clip(request: pytest.FixtureRequest) -> Motion:
    """A walk in cm, a run of another rig and unit, and the run with Z up."""
    if request.param == "canonical":
        return make_walk(200)
    run = read_motion(CMU)
    if request.param == "CMU":
        return run
    turn = np.broadcast_to(np.array([0.5**0.5, 0.5**0.5, 0, 0], np.float32), (len(run), 4))
    rotations = run.local_rotations.copy()
    rotations[:, 0] = quat_multiply(turn, rotations[:, 0])
    return replace(run, local_rotations=rotations, root_positions=quat_rotate(turn, run.root_positions))


def test_a_ground_root_moves_no_joint(clip: Motion) -> None:
    made = with_ground_root(clip)
    assert made.skeleton.names == ("Root", *clip.skeleton.names)
    before, after = motion_kinematics(clip)[1], motion_kinematics(made)[1][:, 1:]
    assert np.abs(after - before).max() < 2e-4 * np.abs(before).max()
    upright = Upright.of(made).motion
    assert np.abs(upright.root_positions[:, 1]).max() < 1e-3
    turns = quat_to_expmap(upright.local_rotations[:, 0])
    assert np.abs(turns[:, [0, 2]]).max() < 1e-3
    facing = heading_angles(motion_kinematics(canonical_motion(clip))[1], clip.fps)
    if clip.skeleton.names[0] == "Hips" and abs(float(np.unwrap(turns[:, 1])[0] - facing[0])) < 6.0:
        assert np.abs(np.sin(turns[:, 1] - facing)).max() < 0.02


def test_at_the_origin_the_same_motion_begins_there_and_faces_z(clip: Motion) -> None:
    before, made = Upright.of(clip), at_origin(clip)
    after = Upright.of(made)
    way = ground_track(after)
    assert np.abs(way[0, :2]).max() < 0.01
    if before.canonical is not None:
        assert abs(np.sin(way[:, 2]).mean()) < 1e-3 < np.cos(way[:, 2]).mean()
    assert np.abs(after.facing_positions - before.facing_positions).max() < 0.01
    again = Upright.of(at_origin(made))
    assert np.abs(again.positions - after.positions).max() < 0.05


def test_in_place_the_hips_stay_over_the_origin(clip: Motion) -> None:
    made = Upright.of(in_place(clip)).motion
    before = Upright.of(clip).motion
    way = before.root_positions[:, [0, 2]]
    assert np.linalg.norm(way[-1] - way[0]) > 60.0
    assert np.abs(made.root_positions[:, [0, 2]]).max() < 8.0
    assert np.abs(made.root_positions[:, 1] - before.root_positions[:, 1]).max() < 1e-2
    assert np.abs(made.local_rotations[:, 1:] - before.local_rotations[:, 1:]).max() == 0.0


def test_both_together_leave_the_root_at_the_origin(clip: Motion) -> None:
    made = Upright.of(with_ground_root(in_place(clip))).motion
    assert np.abs(made.root_positions).max() < 4.0


def test_a_root_bone_that_is_there_is_used(clip: Motion) -> None:
    once = with_ground_root(clip)
    twice = with_ground_root(once)
    assert twice.skeleton.names == once.skeleton.names
    assert np.abs(motion_kinematics(twice)[1] - motion_kinematics(once)[1])[:, 1:].max() < 0.01
    names = list(clip.skeleton.names)
    names[-1] = "root"
    assert with_ground_root(_called(clip, names)).skeleton.names[0] == "Ground"
    names[-2] = "ground"
    with pytest.raises(SkeletonError, match="Root and Ground already"):
        with_ground_root(_called(clip, names))


def _called(clip: Motion, names: Sequence[str]) -> Motion:
    """A clip whose joints have other names."""
    return replace(clip, skeleton=replace(clip.skeleton, names=tuple(names)))


def test_hips_called_root_are_no_root_bone(clip: Motion) -> None:
    made = _called(clip, ["root", *clip.skeleton.names[1:]])
    assert root_bone(made.skeleton) is None
    still = in_place(made)
    expected = in_place(clip)
    assert np.abs(motion_kinematics(still)[1] - motion_kinematics(expected)[1]).max() < 1e-3
    grounded = with_ground_root(made)
    assert grounded.skeleton.names[:2] == ("Ground", "root")
    before = motion_kinematics(clip)[1]
    assert np.abs(motion_kinematics(grounded)[1][:, 1:] - before).max() < 2e-4 * np.abs(before).max()


def _with_root_bone(clip: Motion, ik_joint: int) -> Motion:
    """A clip below a root bone at rest, which has a second child that is keyed on a joint."""
    skeleton = clip.skeleton
    positions = motion_kinematics(clip)[1]
    offsets = np.concatenate([np.zeros((2, 3), np.float32), skeleton.offsets])
    still = clip.local_positions
    moved = np.broadcast_to(skeleton.offsets, positions.shape).copy() if still is None else still.copy()
    moved[:, 0] = clip.root_positions
    none = np.zeros((len(clip), 1, 3), np.float32)
    moved = np.concatenate([none, positions[:, ik_joint : ik_joint + 1], moved], axis=1).astype(np.float32)
    rotations = np.concatenate([quat_identity((len(clip), 2)), clip.local_rotations], axis=1)
    parents = (-1, 0, *(0 if parent < 0 else parent + 2 for parent in skeleton.parents))
    names = ("root", "ik_foot_l", *skeleton.names)
    ends = {joint + 2: end for joint, end in skeleton.end_sites.items()}
    return Motion(Skeleton(names, parents, offsets, ends), rotations, none[:, 0], clip.fps, moved)


def test_all_children_of_a_root_bone_stay_where_they_are(clip: Motion) -> None:
    foot = clip.skeleton.names.index("LeftFoot")
    bone = _with_root_bone(clip, foot)
    size = np.abs(motion_kinematics(bone)[1]).max()
    assert root_bone(bone.skeleton) == 2
    for made in (with_ground_root(bone), in_place(bone)):
        positions = motion_kinematics(made)[1]
        assert np.abs(positions[:, 1] - positions[:, 2 + foot]).max() < 2e-4 * size
    track = with_ground_root(bone).root_positions
    assert np.linalg.norm(track - with_ground_root(clip).root_positions, axis=-1).max() < 0.1 * np.ptp(track)


def test_joints_before_the_hips_do_not_change_the_track(clip: Motion) -> None:
    """The root bone follows the hips, wherever they stand among the rig's joints."""
    track = with_ground_root(_with_root_bone(clip, 0)).root_positions
    expected = with_ground_root(clip).root_positions
    assert np.abs(track - expected).max() < 1e-3 * np.abs(expected).max()


def test_a_root_bone_rests_upright_on_rigs_with_z_up() -> None:
    walk, turn = make_walk(100), quat_between(np.array([0, 1, 0]), np.array([0, 0, 1])).astype(np.float32)
    back = quat_inverse(turn)
    rotations = quat_multiply(quat_multiply(turn, walk.local_rotations), back)
    skeleton = replace(walk.skeleton, offsets=quat_rotate(turn, walk.skeleton.offsets).astype(np.float32))
    upward = replace(
        walk,
        skeleton=skeleton,
        local_rotations=rotations.astype(np.float32),
        root_positions=quat_rotate(turn, walk.root_positions).astype(np.float32),
    )
    made, expected = with_ground_root(upward), with_ground_root(walk)
    assert np.abs(quat_to_expmap(made.local_rotations[:, 0])[:, :2]).max() < 1e-3
    hips = made.skeleton.offsets[1]
    assert np.abs(hips - quat_rotate(turn, expected.skeleton.offsets[1])).max() < 0.05 < hips[2]
    again = with_ground_root(made)
    assert np.abs(quat_to_expmap(again.local_rotations[:, 0])[:, :2]).max() < 1e-3


def test_a_ground_root_survives_the_files(tmp_path: Path) -> None:
    walk = make_walk(60)
    made = with_ground_root(walk)
    for ending in (".bvh", ".glb"):
        write_motion(tmp_path / f"a{ending}", made)
        back = read_motion(tmp_path / f"a{ending}")
        assert back.skeleton.names == made.skeleton.names
        assert np.abs(motion_kinematics(back)[1][:, 1:] - motion_kinematics(walk)[1]).max() < 1e-2
    write_motion(tmp_path / "a.vrma", made)


def test_a_ground_bone_in_place_does_not_move(clip: Motion) -> None:
    choice = RootMotion(in_place=True, root="ground")
    held = choice.applied(clip)
    assert held.skeleton.names[0] == "Root"
    assert np.abs(held.root_positions - held.root_positions[0]).max() < 1e-3
