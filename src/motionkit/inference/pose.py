"""The pose of one frame of N characters.

The same mathematics as features.decode and motion.kinematics, which serve whole motions, with fewer calls for
each frame; the tests hold the two together. All arrays are float32.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import Floats
from motionkit.features.layout import FEATURE_COUNT, feature_layout
from motionkit.motion.skeleton import JOINT_COUNT, PARENTS

# Quaternion products as matrices: (p q) = p @ _PRODUCT[.., q], summed over both factors.
_PRODUCT = np.zeros((4, 4, 4), np.float32)  # [p component, q component, result component]
for _p, _q, _result, _sign in (
    (0, 0, 0, 1), (1, 1, 0, -1), (2, 2, 0, -1), (3, 3, 0, -1),
    (0, 1, 1, 1), (1, 0, 1, 1), (2, 3, 1, 1), (3, 2, 1, -1),
    (0, 2, 2, 1), (2, 0, 2, 1), (1, 3, 2, -1), (3, 1, 2, 1),
    (0, 3, 3, 1), (3, 0, 3, 1), (1, 2, 3, 1), (2, 1, 3, -1),
):  # fmt: skip
    _PRODUCT[_p, _q, _result] = _sign
# From p to the matrix that multiplies a q in a row from the right: (4, 4 x 4).
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
# The other way: 4 q q^T is linear in the matrix, with the identity added.
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


def quat_product(p: Floats, q: Floats) -> Floats:
    """The product p q (..., 4) of quaternions of the same leading shape: rotates by q first."""
    left = (p @ LEFT).reshape(*p.shape[:-1], 4, 4)
    return np.matmul(q[..., None, :], left)[..., 0, :]


def quat_to_matrix(quat: Floats) -> Floats:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4)."""
    products: Floats = (quat[..., :, None] * quat[..., None, :]).reshape(*quat.shape[:-1], 16)
    return np.matmul(products, TO_MATRIX).reshape(*quat.shape[:-1], 3, 3)


def matrix_to_quat(matrix: Floats) -> Floats:
    """Unit quaternions (N, 4), w >= 0, of rotation matrices (N, 3, 3)."""
    outer = (matrix.reshape(-1, 9) @ FROM_MATRIX + FROM_CONSTANT).reshape(-1, 4, 4)
    rows = np.arange(len(outer))
    largest = outer.reshape(-1, 16)[:, ::5].argmax(axis=-1)
    quat = outer[rows, largest]
    quat /= np.sqrt((quat * quat).sum(axis=-1, keepdims=True))
    quat[quat[:, 0] < 0] *= -1.0
    return quat


def expmap_to_quat(expmap: Floats) -> Floats:
    """Unit quaternions (..., 4) of exponential maps (..., 3)."""
    half = 0.5 * np.sqrt((expmap * expmap).sum(axis=-1, keepdims=True))
    half = np.maximum(half, np.float32(1e-12))
    quat = np.empty((*expmap.shape[:-1], 4), np.float32)
    np.cos(half, out=quat[..., :1])
    np.multiply(expmap, np.sin(half) / (2.0 * half), out=quat[..., 1:])
    return quat


def orthonormal(sixd: list[float]) -> tuple[float, float, float, float, float, float]:
    """Two matrix columns (6,) made orthonormal (Gram-Schmidt).

    In plain floats: for one rotation that is ten times as fast as forty small arrays.
    """
    ax, ay, az, bx, by, bz = sixd
    size = max(math.sqrt(ax * ax + ay * ay + az * az), 1e-8)
    ax, ay, az = ax / size, ay / size, az / size
    along = ax * bx + ay * by + az * bz
    bx, by, bz = bx - along * ax, by - along * ay, bz - along * az
    size = max(math.sqrt(bx * bx + by * by + bz * bz), 1e-8)
    return ax, ay, az, bx / size, by / size, bz / size


def sixd_to_quat(sixd: list[float]) -> tuple[float, float, float, float]:
    """A unit quaternion of two matrix columns (6,), made orthonormal first."""
    ax, ay, az, bx, by, bz = orthonormal(sixd)
    cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    # Four forms of the same; the one with the largest leading number is well-conditioned.
    w, x, y, z = max(
        ((1 + ax + by + cz, bz - cy, cx - az, ay - bx), 0),
        ((bz - cy, 1 + ax - by - cz, bx + ay, cx + az), 1),
        ((cx - az, bx + ay, 1 - ax + by - cz, cy + bz), 2),
        ((ay - bx, cx + az, cy + bz, 1 - ax - by + cz), 3),
        key=lambda form: form[0][form[1]],
    )[0]
    size = math.sqrt(w * w + x * x + y * y + z * z)
    return w / size, x / size, y / size, z / size


def expmap_to_quat_one(expmap: list[float]) -> tuple[float, float, float, float]:
    """A unit quaternion of one exponential map (3,), in plain floats."""
    x, y, z = expmap
    angle = max(math.sqrt(x * x + y * y + z * z), 1e-12)
    scale = math.sin(0.5 * angle) / angle
    return math.cos(0.5 * angle), scale * x, scale * y, scale * z


class PoseDecoder:
    """Local rotations and root place of a frame of features."""

    def __init__(self, layout: str, reference_rotations: Floats) -> None:
        columns = feature_layout(layout)
        blocks = columns.blocks
        self.continuous = columns.root_is_sixd
        self.root, self.joints = blocks["root_rotation"], blocks["joint_rotations"]
        self.height = columns.root_height
        self.reference_rotations = np.ascontiguousarray(reference_rotations[1:] @ LEFT).reshape(
            JOINT_COUNT - 1, 4, 4
        )

    def decode(self, features: Floats, ground: Floats) -> tuple[Floats, Floats]:
        """Local rotations (N, 23, 4) and root positions (N, 3).

        Args:
            features: (N, 276) unnormalised.
            ground: (N, 3) root x, z and heading in the world.
        """
        assert features.shape[1] == FEATURE_COUNT
        count = len(features)
        rotations = np.empty((count, JOINT_COUNT, 4), np.float32)
        to_quat = sixd_to_quat if self.continuous else expmap_to_quat_one
        for i, (root, heading) in enumerate(
            zip(features[:, self.root].tolist(), ground[:, 2].tolist(), strict=True)
        ):
            w, x, y, z = to_quat(root)
            c, s = math.cos(0.5 * heading), math.sin(0.5 * heading)
            rotations[i, 0] = c * w - s * y, c * x + s * z, c * y + s * w, c * z - s * x
        joints = expmap_to_quat(features[:, self.joints].reshape(count, -1, 3))
        np.matmul(joints[:, :, None, :], self.reference_rotations, out=rotations[:, 1:, None, :])
        positions = np.empty((count, 3), np.float32)
        positions[:, ::2], positions[:, 1] = ground[:, :2], features[:, self.height]
        return rotations, positions


def _ancestors(steps: int) -> NDArray[np.intp]:
    """For every joint the ancestor so many steps up, JOINT_COUNT (an identity) where there is none."""
    out = list(range(JOINT_COUNT))
    for _ in range(steps):
        out = [JOINT_COUNT if j in (0, JOINT_COUNT) else PARENTS[j] for j in out]
    return np.array([*out, JOINT_COUNT])


class BodyKinematics:
    """Forward kinematics of the canonical joints for N bodies.

    Chains of up to eight joints are multiplied in three rounds, each of which doubles the length of
    what has been multiplied, for all joints at once.
    """

    ROUNDS = tuple(_ancestors(steps) for steps in (1, 2, 4))

    def __init__(self, offsets: Floats) -> None:
        """offsets: (N, 23, 3) in cm."""
        count = len(offsets)
        self._local = np.zeros((count, JOINT_COUNT + 1, 4, 4), np.float32)
        self._local[:, :, 3, 3] = 1.0
        self._local[:, JOINT_COUNT] = np.eye(4, dtype=np.float32)
        self._local[:, 1:JOINT_COUNT, :3, 3] = offsets[:, 1:]

    def set_offsets(self, index: int, offsets: Floats) -> None:
        """Give one body other bones (23, 3)."""
        self._local[index, 1:JOINT_COUNT, :3, 3] = offsets[1:]

    def forward(self, rotations: Floats, root_positions: Floats) -> Floats:
        """World transforms (N, 23, 4, 4) of local rotations (N, 23, 4) and root positions (N, 3)."""
        local = self._local
        local[:, :JOINT_COUNT, :3, :3] = quat_to_matrix(rotations)
        whole = local
        for ancestors in self.ROUNDS:
            whole = np.matmul(whole.take(ancestors, axis=1), whole)
        # The root comes last, which keeps digits far from the origin.
        whole[..., :3, 3] += root_positions[:, None]
        return whole[:, :JOINT_COUNT]
