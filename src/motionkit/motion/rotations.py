"""Rotation functions; models/torch_rotations.py has the few that losses differentiate.

Quaternions are (..., 4) in the order w, x, y, z. Matrices are (..., 3, 3) and act on columns. An exponential map
(..., 3) is axis times full angle in radians. All functions accept any leading dimensions.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import DTypeLike

from motionkit.arrays import Array, cross, length, normalized

# Angle in radians below which series replace the trigonometric quotients, to avoid 0 / 0.
SMALL_ANGLE = 1e-4


def quat_identity(shape: tuple[int, ...] = (), dtype: DTypeLike = np.float32) -> Array:
    """Identity quaternions of shape (*shape, 4)."""
    quat = np.zeros((*shape, 4), dtype)
    quat[..., 0] = 1.0
    return quat


def quat_normalize(quat: Array) -> Array:
    """Unit quaternions (..., 4)."""
    return normalized(quat)


def quat_inverse(quat: Array) -> Array:
    """The inverse (conjugate) of unit quaternions (..., 4)."""
    return np.concatenate([quat[..., :1], -quat[..., 1:]], axis=-1)


def quat_multiply(a: Array, b: Array) -> Array:
    """The product a b (..., 4): a rotation by b, then by a."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def quat_rotate(quat: Array, vector: Array) -> Array:
    """Vectors (..., 3) rotated by unit quaternions (..., 4)."""
    axis = quat[..., 1:]
    twice_cross = 2.0 * cross(axis, vector)
    return vector + quat[..., :1] * twice_cross + cross(axis, twice_cross)


def quat_to_matrix(quat: Array) -> Array:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4)."""
    w, x, y, z = np.moveaxis(quat, -1, 0)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return np.stack(rows, axis=-1).reshape(*quat.shape[:-1], 3, 3)


def matrix_to_quat(matrix: Array) -> Array:
    """Unit quaternions (..., 4) with w >= 0 of rotation matrices (..., 3, 3).

    Each of the four components gives a candidate; the one with the largest leading component is best conditioned.
    """
    m = np.moveaxis(matrix.reshape(*matrix.shape[:-2], 9), -1, 0)
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = m
    candidates = np.stack(
        [
            np.stack([1 + m00 + m11 + m22, m21 - m12, m02 - m20, m10 - m01], axis=-1),
            np.stack([m21 - m12, 1 + m00 - m11 - m22, m01 + m10, m02 + m20], axis=-1),
            np.stack([m02 - m20, m01 + m10, 1 - m00 + m11 - m22, m12 + m21], axis=-1),
            np.stack([m10 - m01, m02 + m20, m12 + m21, 1 - m00 - m11 + m22], axis=-1),
        ],
        axis=-2,
    )
    best = candidates.diagonal(axis1=-2, axis2=-1).argmax(axis=-1)
    picked = np.take_along_axis(candidates, best[..., None, None], axis=-2)[..., 0, :]
    quat = quat_normalize(picked)
    return np.where(quat[..., :1] < 0, -quat, quat)


def expmap_to_quat(expmap: Array) -> Array:
    """Unit quaternions (..., 4) of exponential maps (..., 3) of any angle."""
    squared = (expmap * expmap).sum(-1, keepdims=True)
    small = squared < SMALL_ANGLE**2
    angle = np.sqrt(np.where(small, np.ones_like(squared), squared))
    half = 0.5 * angle
    scale = np.where(small, 0.5 - squared / 48.0, np.sin(half) / angle)
    cosine = np.where(small, 1.0 - squared / 8.0, np.cos(half))
    return np.concatenate([cosine, scale * expmap], axis=-1)


def quat_to_expmap(quat: Array) -> Array:
    """Exponential maps (..., 3) of unit quaternions (..., 4), with angles of at most pi."""
    quat = np.where(quat[..., :1] < 0, -quat, quat)
    w, xyz = quat[..., :1], quat[..., 1:]
    squared = (xyz * xyz).sum(-1, keepdims=True)
    small = squared < (0.5 * SMALL_ANGLE) ** 2
    sine = np.sqrt(np.where(small, np.ones_like(squared), squared))
    angle = 2.0 * np.arctan2(sine, w)
    scale = np.where(small, 2.0 / np.maximum(w, 0.5) * (1.0 - squared / 3.0), angle / sine)
    return scale * xyz


def quat_between(source: Array, target: Array) -> Array:
    """The smallest rotation (..., 4) that rotates directions source (..., 3) to target (..., 3)."""
    source, target = normalized(source), normalized(target)
    normal = cross(source, target)
    w = 1.0 + (source * target).sum(-1, keepdims=True)
    # Opposite directions: rotate about any perpendicular axis.
    x, y = np.eye(3, dtype=source.dtype)[:2]
    sideways = cross(source, np.where(np.abs(source[..., :1]) < 0.9, x, y))
    opposite = w < 1e-6
    quat = np.concatenate([np.where(opposite, np.zeros_like(w), w), np.where(opposite, sideways, normal)], -1)
    return quat_normalize(quat)


def quat_slerp(a: Array, b: Array, fraction: Array) -> Array:
    """Spherical interpolation from a to b (..., 4) at fraction (...), by the shorter arc."""
    dot = (a * b).sum(-1, keepdims=True)
    b = np.where(dot < 0, -b, b)
    dot = np.minimum(np.abs(dot), 1.0)
    angle = np.arccos(dot)
    sine = np.sin(angle)
    fraction = fraction[..., None]
    near = sine < 1e-5
    safe = np.where(near, np.ones_like(sine), sine)
    weight_a = np.where(near, 1.0 - fraction, np.sin((1.0 - fraction) * angle) / safe)
    weight_b = np.where(near, fraction, np.sin(fraction * angle) / safe)
    return quat_normalize(weight_a * a + weight_b * b)


def quat_continuous(quat: Array) -> Array:
    """The same rotations (T, ..., 4) with signs chosen so that neighbouring frames are close."""
    dots = (quat[1:] * quat[:-1]).sum(-1)
    flips = np.cumprod(np.where(dots < 0, -1.0, 1.0).astype(quat.dtype), axis=0)
    return np.concatenate([quat[:1], quat[1:] * flips[..., None]], axis=0)


def quat_from_yaw(yaw: Array) -> Array:
    """Rotations (..., 4) about Y by yaw (...) in radians."""
    zero = np.zeros_like(yaw)
    return np.stack([np.cos(0.5 * yaw), zero, np.sin(0.5 * yaw), zero], axis=-1)


def quat_about(axis: Array, angle: Array) -> Array:
    """Rotations (..., 4) by angles (...) in radians about unit axes (..., 3)."""
    half = 0.5 * angle[..., None]
    return np.concatenate([np.cos(half), np.sin(half) * axis], axis=-1)


def wrap_angle(angle: Array) -> Array:
    """Angles wrapped to [-pi, pi)."""
    return np.remainder(angle + math.pi, 2 * math.pi) - math.pi


def rotate_ground(yaw: Array, xz: Array) -> Array:
    """Ground vectors (..., 2), x and z, rotated about Y by yaw (...)."""
    sine, cosine = np.sin(yaw), np.cos(yaw)
    x, z = np.moveaxis(xz, -1, 0)
    return np.stack([cosine * x + sine * z, -sine * x + cosine * z], axis=-1)


def quat_to_sixd(quat: Array) -> Array:
    """The first two matrix columns (..., 6), a continuous representation (Zhou et al. 2019)."""
    matrix = quat_to_matrix(quat)
    return np.concatenate([matrix[..., :, 0], matrix[..., :, 1]], axis=-1)


def sixd_to_quat(sixd: Array) -> Array:
    """Unit quaternions (..., 4) of two matrix columns (..., 6), orthonormalised by Gram-Schmidt."""
    first = normalized(sixd[..., :3], 1e-8)
    second = sixd[..., 3:] - (first * sixd[..., 3:]).sum(-1, keepdims=True) * first
    second = normalized(second, 1e-8)
    return matrix_to_quat(np.stack([first, second, cross(first, second)], axis=-1))


def euler_to_quat(euler: Array, order: str) -> Array:
    """Rotations (..., 4) of intrinsic Euler angles (..., len(order)) in radians, in the order of BVH channels.

    order is one of axes such as "ZYX"; the first one is the outermost rotation.
    """
    quat = quat_identity(euler.shape[:-1], euler.dtype)
    for index, axis in enumerate(order):
        half = 0.5 * euler[..., index]
        step = np.zeros((*euler.shape[:-1], 4), euler.dtype)
        step[..., 0] = np.cos(half)
        step[..., 1 + "XYZ".index(axis)] = np.sin(half)
        quat = quat_multiply(quat, step)
    return quat


def quat_to_euler(quat: Array, order: str) -> Array:
    """Intrinsic Euler angles (..., 3) in radians of rotations (..., 4), for an order of three distinct axes.

    The middle angle is in [-pi/2, pi/2]. Near the pole, where the first and the last one turn about one axis, the last
    one makes up for errors of the first; at the pole it is zero.
    """
    i, j, k = ("XYZ".index(axis) for axis in order)
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    matrix = quat_to_matrix(quat_normalize(quat))
    sine = np.clip(sign * matrix[..., i, k], -1.0, 1.0)
    cosine = np.sqrt(matrix[..., i, i] ** 2 + matrix[..., i, j] ** 2)
    middle = np.arctan2(sine, cosine)
    first = np.arctan2(-sign * matrix[..., j, k], matrix[..., k, k])
    at_pole = np.arctan2(sign * matrix[..., k, j], matrix[..., j, j])
    first = np.where(cosine < 1e-6, at_pole, first)
    # Of the rotation that is left when the first angle is undone.
    along, aside = np.cos(first), sign * np.sin(first)
    last = np.arctan2(
        sign * (along * matrix[..., j, i] + aside * matrix[..., k, i]),
        along * matrix[..., j, j] + aside * matrix[..., k, j],
    )
    return np.stack([first, middle, last], axis=-1)


def quat_angle(a: Array, b: Array) -> Array:
    """The angle (...) in radians of the rotation between a and b (..., 4), in [0, pi]."""
    return length(quat_to_expmap(quat_multiply(quat_inverse(a), b)))


def mean_rotation(moment: Array) -> Array:
    """The mean rotation (..., 4) from summed outer products q q^T (..., 4, 4) (Markley et al. 2007)."""
    _, vectors = np.linalg.eigh(moment)
    quat = vectors[..., -1]
    return np.where(quat[..., :1] < 0, -quat, quat)
