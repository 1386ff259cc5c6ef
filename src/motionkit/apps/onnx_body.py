"""The body of a frame as ONNX nodes: ground, rotations, root and joints, as synthesis/pose.py has them.

Most of it is a handful of numbers, where a node costs the same whatever it does; so products with constants
stand for sums, signs and exchanges of columns.
"""

from __future__ import annotations

import numpy as np

from motionkit.apps.onnx_graph import Graph
from motionkit.features.layout import FEATURE_COUNT, feature_layout
from motionkit.models.checkpoint import MotionModel
from motionkit.motion.skeleton import JOINT_COUNT, leg_length
from motionkit.synthesis.pose import FROM_CONSTANT, FROM_MATRIX, LEFT, TO_MATRIX, BodyKinematics

QUARTER = 0.5 * np.pi
# A cross product: products of columns [1, 2, 0, 2, 0, 1] and [2, 0, 1, 1, 2, 0], the first three minus the others.
FORWARD, BACKWARD = [1, 2, 0, 2, 0, 1], [2, 0, 1, 1, 2, 0]
MINUS = np.concatenate([np.eye(3), -np.eye(3)])


def write_body(g: Graph, model: MotionModel, features: str, character: str) -> None:
    """Nodes from unnormalised features (1, 276) to the next ground and the body in the world."""
    layout = feature_layout(model.config.layout)
    blocks = layout.blocks
    continuous = layout.version.startswith("sixd")
    skeleton = model.character(character)
    share = np.float32(leg_length(skeleton) / leg_length(model.character("default")))
    # The blocks that count, in their order, and what lies between.
    height = blocks["joint_positions"].start + (0 if continuous else 1)
    names = ["root_yaw_velocity", "root_xz_velocity", "root_rotation", "joint_rotations"]
    ends = [blocks[name].stop for name in names] + [height, height + 1, FEATURE_COUNT]
    pieces = g.split(features, np.diff([0, *ends]).tolist(), axis=1)
    yaw_velocity, velocity, facing, joints, _, at, _ = pieces
    heading = _write_ground(g, model.fps, yaw_velocity, velocity)
    facing = _sixd_to_quat(g, facing) if continuous else _expmap_to_quat(g, facing, 1)
    left = g.reshape(g.add("MatMul", heading, LEFT), 4, 4)
    root_turn = g.reshape(g.add("MatMul", facing, left), 1, 1, 4)
    references = (model.references.numpy()[1:] @ LEFT).reshape(-1, 4, 4)
    joints = g.reshape(_expmap_to_quat(g, joints, JOINT_COUNT - 1), JOINT_COUNT - 1, 1, 4)
    rotations = g.add("Concat", root_turn, g.add("MatMul", joints, references), axis=0)
    g.reshape(rotations, 1, JOINT_COUNT, 4, out="rotations")
    up, across = np.zeros((1, 3)), np.zeros((3, 3))
    up[0, 1] = across[0, 0] = across[1, 2] = share
    root = g.add("Gemm", "present_ground", across, g.add("Mul", at, up), out="root_positions")
    # Local transforms (24, 4, 4), the last an identity, multiplied up the chains in three rounds.
    outer = g.add("Mul", rotations, g.reshape(rotations, JOINT_COUNT, 4, 1))
    to_transform = np.zeros((16, 4, 4), np.float32)
    to_transform[:, :3, :3] = TO_MATRIX.reshape(16, 3, 3)
    offsets = np.zeros((JOINT_COUNT, 4, 4), np.float32)
    offsets[1:, :3, 3], offsets[:, 3, 3] = skeleton.offsets.numpy()[1:], 1.0
    local = g.add(
        "Gemm", g.reshape(outer, JOINT_COUNT, 16), to_transform.reshape(16, 16), offsets.reshape(-1, 16)
    )
    whole = g.reshape(g.add("Concat", local, np.eye(4).reshape(1, 16), axis=0), JOINT_COUNT + 1, 4, 4)
    for ancestors in BodyKinematics.ROUNDS:
        whole = g.add("MatMul", g.gather(whole, ancestors, axis=0), whole)
    last = g.slice(whole, [0, 0, 3], [JOINT_COUNT, 3, 4], [0, 1, 2])
    # The root comes last, which keeps digits far from the origin.
    g.add("Add", g.reshape(last, 1, JOINT_COUNT, 3), root, out="positions")


def _write_ground(g: Graph, fps: float, yaw_velocity: str, velocity: str) -> str:
    """Writes present_ground (1, 3) and answers the heading as a quaternion (1, 4)."""
    turned = g.add("Add", "ground", g.add("Mul", yaw_velocity, [[0.0, 0.0, 1.0 / fps]]))
    # Sines of the heading h plus something: cos h, cos h, sin h, -sin h, then cos h/2, 0, sin h/2, 0.
    of_yaw = np.zeros((3, 8))
    of_yaw[2] = [1.0, 1.0, 1.0, 1.0, 0.5, 0.0, 0.5, 0.0]
    plus = [QUARTER, QUARTER, 0.0, np.pi, QUARTER, 0.0, 0.0, 0.0]
    sines = g.add("Sin", g.add("Gemm", turned, of_yaw, plus))
    turn, heading = g.split(sines, [4, 4], axis=1)
    # Velocity x, z, z, x: what goes into x, z, x, z.
    moved = g.add("Mul", turn, g.gather(velocity, [0, 1, 1, 0], axis=1))
    onto = np.eye(3)[[0, 1, 0, 1]] / fps
    g.add("Gemm", moved, onto, turned, out="present_ground")
    return heading


def _expmap_to_quat(g: Graph, expmaps: str, count: int) -> str:
    """Quaternions (N, 4) of exponential maps (1, 3 N)."""
    expmaps = g.reshape(expmaps, count, 3)
    angle = g.add("ReduceL2", expmaps, axes=[1], keepdims=1)
    angle = g.add("Max", angle, np.float32(1e-12))
    # cos a/2 and three times sin a/2, times 1 and the axis.
    sines = g.add("Sin", g.add("Gemm", angle, np.full((1, 4), 0.5), [QUARTER, 0.0, 0.0, 0.0]))
    return g.add("Mul", sines, g.add("Div", g.add("Concat", angle, expmaps, axis=1), angle))


def _sixd_to_quat(g: Graph, sixd: str) -> str:
    """The quaternion (1, 4) of a rotation matrix given by its first two columns (1, 6), not orthonormal yet."""
    first, _ = g.split(sixd, [3, 3], axis=1)
    ahead = g.gather(sixd, FORWARD, axis=1)
    behind = g.gather(sixd, [3 + column for column in BACKWARD], axis=1)
    third = g.add("MatMul", g.add("Mul", ahead, behind), MINUS)
    # Unit vectors: the first and the third column; the second is third x first.
    pair = g.reshape(g.add("Concat", third, first, axis=1), 2, 3)
    pair = g.reshape(g.add("Div", pair, g.add("ReduceL2", pair, axes=[1], keepdims=1)), 1, 6)
    ahead = g.gather(pair, FORWARD, axis=1)
    behind = g.gather(pair, [3 + column for column in BACKWARD], axis=1)
    # Four times the products of the quaternion's components are linear in the matrix.
    of_column = FROM_MATRIX.reshape(3, 3, 16)
    outer = g.add("Gemm", pair, np.concatenate([of_column[:, 2], of_column[:, 0]]), FROM_CONSTANT)
    outer = g.add("Gemm", g.add("Mul", ahead, behind), MINUS @ of_column[:, 1], outer)
    # Four rows, each the quaternion times one of its components; the largest is well-conditioned.
    largest = g.add("ArgMax", g.gather(outer, [0, 5, 10, 15], axis=1), axis=1, keepdims=0)
    quat = g.gather(g.reshape(outer, 4, 4), largest, axis=0)
    return g.add("Div", quat, g.add("ReduceL2", quat, axes=[1], keepdims=1))
