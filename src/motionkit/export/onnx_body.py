"""The pose of a frame as ONNX nodes: ground, rotations, root and joints, as in inference/frame_kernel.c.

Most values here are a handful of numbers, so the number of nodes decides the time. Products with constants therefore
replace sums, signs and permutations of columns.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from motionkit.export.onnx_graph import Graph
from motionkit.features.layout import FEATURE_COUNT, feature_layout
from motionkit.inference import height_correction
from motionkit.inference.slip_correction import foot_columns
from motionkit.models.model import MotionModel
from motionkit.motion.skeleton import FOOT_JOINTS, JOINT_COUNT, PARENTS, STANDING_HEIGHTS

QUARTER = 0.5 * np.pi
PER_PACE = height_correction.PACE * height_correction.DOUBT**2
# The cross product: multiply columns [1, 2, 0, 2, 0, 1] by [2, 0, 1, 1, 2, 0], then first three minus last three.
FORWARD, BACKWARD = [1, 2, 0, 2, 0, 1], [2, 0, 1, 1, 2, 0]
MINUS = np.concatenate([np.eye(3), -np.eye(3)])

# Quaternion products as matrices: (p q) = p @ _PRODUCT[.., q], summed over both factors.
_PRODUCT = np.zeros((4, 4, 4), np.float32)  # [p component, q component, result component]
for _p, _q, _result, _sign in (
    (0, 0, 0, 1), (1, 1, 0, -1), (2, 2, 0, -1), (3, 3, 0, -1),
    (0, 1, 1, 1), (1, 0, 1, 1), (2, 3, 1, 1), (3, 2, 1, -1),
    (0, 2, 2, 1), (2, 0, 2, 1), (1, 3, 2, -1), (3, 1, 2, 1),
    (0, 3, 3, 1), (3, 0, 3, 1), (1, 2, 3, 1), (2, 1, 3, -1),
):  # fmt: skip
    _PRODUCT[_p, _q, _result] = _sign
# Matrix (4, 4 x 4) by which p is multiplied to get the matrix for a following q (as a row, from the right).
LEFT = _PRODUCT.reshape(4, 16)

# The nine entries of a rotation matrix from the sixteen products of quaternion components.
_to_matrix = np.zeros((4, 4, 3, 3), np.float32)
for _axis in range(3):
    _i, _j, _k = _axis, (_axis + 1) % 3, (_axis + 2) % 3
    for _diagonal, _sign in ((_i, 1), (_j, -1), (_k, -1)):
        _to_matrix[1 + _diagonal, 1 + _diagonal, _i, _i] = _sign
    _to_matrix[0, 0, _i, _i] = 1
    _to_matrix[1 + _j, 1 + _k, _j, _k] = _to_matrix[1 + _j, 1 + _k, _k, _j] = 2
    _to_matrix[0, 1 + _i, _k, _j], _to_matrix[0, 1 + _i, _j, _k] = 2, -2
TO_MATRIX = _to_matrix.reshape(16, 9)
# The inverse map: 4 q q^T is linear in the rotation matrix plus the identity.
FROM_MATRIX = np.zeros((9, 16), np.float32)
FROM_CONSTANT = np.diag(np.ones(4, np.float32)).reshape(16)
for _c, _signs in enumerate(((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))):
    for _d, _sign in enumerate(_signs):
        FROM_MATRIX[4 * _d, 5 * _c] = _sign
for _axis in range(3):
    _j, _k = (_axis + 1) % 3, (_axis + 2) % 3
    for _row, _column in ((0, 1 + _axis), (1 + _axis, 0)):
        FROM_MATRIX[3 * _k + _j, 4 * _row + _column] = 1
        FROM_MATRIX[3 * _j + _k, 4 * _row + _column] = -1
    for _row, _column in ((1 + _j, 1 + _k), (1 + _k, 1 + _j)):
        FROM_MATRIX[3 * _j + _k, 4 * _row + _column] = FROM_MATRIX[3 * _k + _j, 4 * _row + _column] = 1


def _ancestors(steps: int) -> NDArray[np.intp]:
    """The ancestor of every joint the given number of steps up; JOINT_COUNT (an identity) if there is none."""
    out = list(range(JOINT_COUNT))
    for _ in range(steps):
        out = [JOINT_COUNT if j in (0, JOINT_COUNT) else PARENTS[j] for j in out]
    return np.array([*out, JOINT_COUNT])


# Chains of up to eight joints are multiplied in three rounds for all joints at once; each round doubles the length of
# the multiplied parts.
ROUNDS = tuple(_ancestors(steps) for steps in (1, 2, 4))


def write_body(g: Graph, model: MotionModel, features: str, character: str) -> None:
    """Write the nodes from unnormalised features (1, 276) to the next ground and the global pose."""
    layout = feature_layout(model.config.layout)
    blocks = layout.blocks
    continuous = layout.root_is_sixd
    skeleton = model.character(character)
    share = np.float32(model.body_scale(character))
    height = layout.root_height
    # Split the features into the needed columns and the rest between them.
    joints, root = blocks["joint_rotations"], blocks["root_rotation"]
    ends = [blocks["root_yaw_velocity"].stop, root.start, root.start + 3, joints.start, joints.stop]
    ends += [height, height + 1, FEATURE_COUNT]
    pieces = g.split(features, np.diff([0, *ends]).tolist(), axis=1)
    yaw_velocity, first, expmaps, at = pieces[0], pieces[2], pieces[4], pieces[6]
    sines = _write_ground(g, model.fps, features, blocks["root_xz_velocity"].start, yaw_velocity)
    facing = _sixd_to_quat(g, features, root.start, first) if continuous else _expmap_to_quat(g, first, 1)
    # Rotate the root by the heading, and each joint by its reference rotation.
    quats = g.add("Concat", facing, _expmap_to_quat(g, expmaps, JOINT_COUNT - 1), axis=0)
    heading = g.reshape(g.add("MatMul", sines, np.concatenate([np.zeros((4, 16)), LEFT])), 1, 4, 4)
    reference_rotations = (model.reference_rotations[1:] @ LEFT).reshape(-1, 4, 4)
    turns = g.add("Concat", heading, g.constant(reference_rotations), axis=0)
    rotations = g.add("MatMul", g.reshape(quats, JOINT_COUNT, 1, 4), turns)
    g.reshape(rotations, 1, JOINT_COUNT, 4, out="rotations")
    up, across = np.zeros((1, 3)), np.zeros((3, 3))
    up[0, 1] = across[0, 0] = across[1, 2] = share
    place = g.add("Gemm", "present_ground", across, g.add("Mul", at, up))
    # Local transforms (24, 4, 4), the last an identity, multiplied along the chains in three rounds.
    outer = g.add("Mul", rotations, g.reshape(rotations, JOINT_COUNT, 4, 1))
    to_transform = np.zeros((16, 4, 4), np.float32)
    to_transform[:, :3, :3] = TO_MATRIX.reshape(16, 3, 3)
    offsets = np.zeros((JOINT_COUNT, 4, 4), np.float32)
    offsets[1:, :3, 3], offsets[:, 3, 3] = skeleton.offsets[1:], 1.0
    local = g.add(
        "Gemm", g.reshape(outer, JOINT_COUNT, 16), to_transform.reshape(16, 16), offsets.reshape(-1, 16)
    )
    whole = g.reshape(g.add("Concat", local, np.eye(4).reshape(1, 16), axis=0), JOINT_COUNT + 1, 4, 4)
    for ancestors in ROUNDS:
        whole = g.add("MatMul", g.gather(whole, ancestors, axis=0), whole)
    # Gather x, y and z from the last column of each transform: runtimes are slow at slices over three axes.
    at_last = 16 * np.arange(JOINT_COUNT)[:, None] + [3, 7, 11]
    last = g.gather(g.reshape(whole, 1, -1), at_last.reshape(-1), axis=1)
    columns = foot_columns(layout.version)[:, 1]
    rise = _write_rise(g, features, (height, columns), last, share)
    place = g.add("Gemm", rise, up, place, out="root_positions")
    # Adding the root last keeps precision far from the origin.
    g.add("Add", g.reshape(last, 1, JOINT_COUNT, 3), place, out="positions")


def _write_rise(
    g: Graph, features: str, heights: tuple[int, NDArray[np.intp]], positions: str, share: np.float32
) -> str:
    """Write present_rise (1, 1), the root-height correction of inference/height_correction.py, and return its name.

    Args:
        heights: columns of the heights of the root and of the foot joints.
        positions: (1, 69) joint positions relative to the root.
        share: size of the body divided by that of the canonical body.
    """
    root, feet = heights
    # Height of each foot joint above its contact height: from the features, and from the rotations without the root.
    of_features, of_positions = np.zeros((FEATURE_COUNT, 8)), np.zeros((3 * JOINT_COUNT, 8))
    of_features[feet, np.arange(4)] = of_features[root, 4:] = 1.0
    of_positions[3 * np.array(FOOT_JOINTS) + 1, 4 + np.arange(4)] = 1.0 / share
    above = g.add("Gemm", features, of_features, -np.tile(STANDING_HEIGHTS, 2))
    above = g.reshape(g.add("Gemm", positions, of_positions, above), 2, 4)
    lowest = g.add("ReduceMin", above, axes=[1], keepdims=1)
    lowest = g.add("Max", lowest, [[-height_correction.DEEPEST], [-1e9]])
    # The missing height, the lowness of the feet, and the excess depth.
    of_lowest = [[1.0, 0.0, 0.0], [-1.0, -1.0 / height_correction.REACH, -1.0]]
    measures = g.add("Gemm", lowest, of_lowest, [0.0, 1.0, -height_correction.DEEPEST], transA=1)
    measures = g.add("Max", measures, np.float32(0.0))
    missing, low, deep = g.split(measures, [1, 1, 1], axis=1)
    doubted = g.add(
        "Gemm",
        missing,
        missing,
        np.full(1, height_correction.DOUBT**2),
        alpha=1.0 / PER_PACE,
        beta=1.0 / PER_PACE,
    )
    pace = g.add("Div", g.add("Min", low, np.float32(1.0)), doubted)
    further = g.add("Mul", pace, g.add("Sub", missing, "rise"))
    rise = g.add("Add", "rise", further)
    lifted = g.add("Mul", g.add("Max", rise, deep), np.float32(height_correction.LIFT))
    return g.add("Gemm", rise, [[1.0 - height_correction.LIFT]], lifted, out="present_rise")


def _write_ground(g: Graph, fps: float, features: str, velocity: int, yaw_velocity: str) -> str:
    """Write present_ground (1, 3). Returns sines (1, 8); the last four are the quaternion of the heading."""
    turned = g.add("Gemm", yaw_velocity, [[0.0, 0.0, 1.0 / fps]], "ground")
    # Sines of the heading h plus constants: cos h, cos h, sin h, -sin h, then cos h/2, 0, sin h/2, 0.
    of_yaw = np.zeros((3, 8))
    of_yaw[2] = [1.0, 1.0, 1.0, 1.0, 0.5, 0.0, 0.5, 0.0]
    plus = [QUARTER, QUARTER, 0.0, np.pi, QUARTER, 0.0, 0.0, 0.0]
    sines = g.add("Sin", g.add("Gemm", turned, of_yaw, plus))
    # The first four columns, times velocity x, z, z, x, sum to the movement in x, z, x, z.
    moved = g.add("Mul", sines, g.gather(features, velocity + np.array([0, 1, 1, 0, 0, 0, 0, 0]), axis=1))
    onto = np.concatenate([np.eye(3)[[0, 1, 0, 1]] / fps, np.zeros((4, 3))])
    g.add("Gemm", moved, onto, turned, out="present_ground")
    return sines


def _expmap_to_quat(g: Graph, expmaps: str, count: int) -> str:
    """Write quaternions (N, 4) of exponential maps (1, 3 N), and return their name."""
    expmaps = g.reshape(expmaps, count, 3)
    angle = g.add("ReduceL2", expmaps, axes=[1], keepdims=1)
    angle = g.add("Max", angle, np.float32(1e-12))
    # cos a/2 once and sin a/2 three times; then multiply by 1 and the axis.
    sines = g.add("Sin", g.add("Gemm", angle, np.full((1, 4), 0.5), [QUARTER, 0.0, 0.0, 0.0]))
    return g.add("Mul", sines, g.add("Div", g.add("Concat", angle, expmaps, axis=1), angle))


def _sixd_to_quat(g: Graph, features: str, start: int, first: str) -> str:
    """Write the quaternion (1, 4) of a matrix, given by two columns from `start` on that may not be orthonormal."""
    third = g.add("MatMul", _products(g, features, start, start + 3), MINUS)
    # Normalize the third and the first column; the second is their cross product.
    pair = g.add("Concat", third, first, axis=0)
    pair = g.reshape(g.add("Div", pair, g.add("ReduceL2", pair, axes=[1], keepdims=1)), 1, 6)
    # Four times the products of the quaternion's components are linear in the matrix.
    of_column = FROM_MATRIX.reshape(3, 3, 16)
    outer = g.add("Gemm", pair, np.concatenate([of_column[:, 2], of_column[:, 0]]), FROM_CONSTANT)
    outer = g.add("Gemm", _products(g, pair, 0, 3), MINUS @ of_column[:, 1], outer)
    # Each of the four rows is the quaternion times one of its components; the row of the largest is well conditioned.
    largest = g.add("ArgMax", g.gather(outer, [0, 5, 10, 15], axis=1), axis=1, keepdims=0)
    quat = g.gather(g.reshape(outer, 4, 4), largest, axis=0)
    return g.add("Div", quat, g.add("ReduceL2", quat, axes=[1], keepdims=1))


def _products(g: Graph, columns: str, first: int, second: int) -> str:
    """Write the six products (1, 6) of a cross product; its two vectors start at these columns. Returns their name."""
    ahead = g.gather(columns, first + np.array(FORWARD), axis=1)
    return g.add("Mul", ahead, g.gather(columns, second + np.array(BACKWARD), axis=1))
