"""Forward kinematics: simple poses, rigid transforms, and comparison with bvhio."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from pathlib import Path

import bvhio
import numpy as np
import pytest

from motionkit.motion.bvh import bvh_to_motion, read_bvh
from motionkit.motion.kinematics import forward_kinematics, motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    expmap_to_quat,
    quat_from_yaw,
    quat_identity,
    quat_multiply,
    quat_rotate,
)
from motionkit.motion.skeleton import canonical_skeleton
from synthetic_motions import make_walk

ORDERS = ["".join(order) for order in itertools.permutations("XYZ")]


def bvh_with_order(order: str, six_channels: bool) -> str:
    """A BVH of five joints with two branches, a root offset, and random angles in all quadrants."""
    turns = " ".join(f"{axis}rotation" for axis in order)
    moves = "Yposition Xposition Zposition"
    root = f"CHANNELS 6 {moves} {turns}"
    inner = f"CHANNELS 6 {moves} {turns}" if six_channels else f"CHANNELS 3 {turns}"
    generator = np.random.default_rng(2 * ORDERS.index(order) + six_channels)
    rows = []
    for _ in range(4):
        row = [*generator.uniform(-50, 50, 3), *generator.uniform(-180, 180, 3)]
        for _ in range(4):
            row += [*generator.uniform(-9, 9, 3)] if six_channels else []
            row += [*generator.uniform(-180, 180, 3)]
        rows.append(" ".join(f"{value:.6f}" for value in row))
    return (
        f"""HIERARCHY
ROOT Hips
{{
  OFFSET 0 0 0
  {root}
  JOINT Spine
  {{
    OFFSET 0 10 1
    {inner}
    JOINT Head
    {{
      OFFSET 0.5 12 -1
      {inner}
      End Site
      {{
        OFFSET 0 5 0
      }}
    }}
  }}
  JOINT Leg
  {{
    OFFSET 4 -3 0
    {inner}
    JOINT Foot
    {{
      OFFSET 1 -20 2
      {inner}
      End Site
      {{
        OFFSET 0 0 6
      }}
    }}
  }}
}}
MOTION
Frames: 4
Frame Time: 0.0333333
"""
        + "\n".join(rows)
        + "\n"
    )


@pytest.mark.parametrize("six_channels", [False, True])
@pytest.mark.parametrize("order", ORDERS)
def test_positions_agree_with_bvhio(tmp_path: Path, order: str, six_channels: bool) -> None:
    path = tmp_path / "clip.bvh"
    path.write_text(bvh_with_order(order, six_channels))
    motion = bvh_to_motion(read_bvh(path))
    _, positions = motion_kinematics(motion)
    root = bvhio.readAsHierarchy(str(path))
    for frame in range(len(motion)):
        root.loadPose(frame)
        oracle = {joint.Name: joint.PositionWorld for joint, _, _ in root.layout()}
        for index, name in enumerate(motion.skeleton.names):
            expected = np.array([oracle[name].x, oracle[name].y, oracle[name].z])
            # bvhio keeps a scale in its matrices, which costs some digits.
            assert np.abs(positions[frame, index] - expected).max() < 5e-3, (name, frame)


def test_rest_pose_is_the_offsets_summed() -> None:
    skeleton = canonical_skeleton()
    rotations, positions = forward_kinematics(
        quat_identity((23,)), np.zeros(3, np.float32), skeleton.offsets, skeleton.parents
    )
    assert np.allclose(positions, skeleton.rest_positions())
    assert np.array_equal(rotations, quat_identity((23,)))


def test_bone_lengths_do_not_change(make_motion: Callable[..., Motion]) -> None:
    motion = make_motion(swing=1.5)
    _, positions = motion_kinematics(motion)
    parents = np.array(motion.skeleton.parents[1:])
    lengths = np.linalg.norm(positions[:, 1:] - positions[:, parents], axis=-1)
    assert np.abs(lengths - np.linalg.norm(motion.skeleton.offsets[1:], axis=-1)).max() < 1e-3


def test_turning_and_moving_the_root_is_a_rigid_move(make_motion: Callable[..., Motion]) -> None:
    motion = make_motion()
    turn, shift = quat_from_yaw(np.array(1.1, np.float32)), np.array([3.0, -2.0, 7.0], np.float32)
    local = motion.local_rotations.copy()
    local[:, 0] = quat_multiply(turn, local[:, 0])
    _, before = motion_kinematics(motion)
    _, after = forward_kinematics(
        local,
        quat_rotate(turn, motion.root_positions) + shift,
        motion.skeleton.offsets,
        motion.skeleton.parents,
    )
    assert np.abs(after - (quat_rotate(turn, before) + shift)).max() < 1e-3


def test_any_leading_dimensions() -> None:
    skeleton = canonical_skeleton()
    expmap = np.zeros((2, 5, 23, 3), np.float32)
    rotations, positions = forward_kinematics(
        expmap_to_quat(expmap), np.zeros((2, 5, 3), np.float32), skeleton.offsets, skeleton.parents
    )
    assert rotations.shape == (2, 5, 23, 4) and positions.shape == (2, 5, 23, 3)


def test_offsets_may_differ_by_batch() -> None:
    skeleton = canonical_skeleton()
    offsets = np.stack([skeleton.offsets, 2 * skeleton.offsets])[:, None]
    _, positions = forward_kinematics(
        quat_identity((2, 4, 23)),
        np.zeros((2, 4, 3), np.float32),
        np.broadcast_to(offsets, (2, 4, 23, 3)),
        skeleton.parents,
    )
    assert np.allclose(positions[1], 2 * positions[0])


def test_a_turned_motion_turns_about_the_vertical_axis() -> None:
    motion = make_walk(20)
    places, turned = motion_kinematics(motion)[1], motion_kinematics(motion.turned(math.pi / 2))[1]
    assert np.allclose(
        turned, np.stack([places[..., 2], places[..., 1], -places[..., 0]], axis=-1), atol=1e-3
    )
