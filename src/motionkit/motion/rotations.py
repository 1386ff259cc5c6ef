"""Rotation mathematics, in torch so that losses through it have gradients.

Quaternions are (..., 4) as w, x, y, z. Matrices are (..., 3, 3) and act on columns. An exponential
map (..., 3) is axis times full angle, in radians. All functions take any leading dimensions.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

# Below this angle the trigonometric quotients are replaced by their series, so gradients stay finite.
SMALL_ANGLE = 1e-4


def quat_identity(shape: tuple[int, ...] = (), dtype: torch.dtype = torch.float32) -> Tensor:
    """Identity quaternions of shape (*shape, 4)."""
    quat = torch.zeros(*shape, 4, dtype=dtype)
    quat[..., 0] = 1.0
    return quat


def quat_normalize(quat: Tensor) -> Tensor:
    """Unit quaternions (..., 4)."""
    return F.normalize(quat, dim=-1, eps=1e-12)


def quat_inverse(quat: Tensor) -> Tensor:
    """The inverse of unit quaternions (..., 4): the conjugate."""
    return torch.cat([quat[..., :1], -quat[..., 1:]], dim=-1)


def quat_multiply(a: Tensor, b: Tensor) -> Tensor:
    """The product a b (..., 4): rotates by b first, then by a."""
    aw, ax, ay, az = a.unbind(-1)
    bw, bx, by, bz = b.unbind(-1)
    return torch.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        dim=-1,
    )


def quat_rotate(quat: Tensor, vector: Tensor) -> Tensor:
    """Vectors (..., 3) turned by unit quaternions (..., 4)."""
    axis, vector = torch.broadcast_tensors(quat[..., 1:], vector)
    twice_cross = 2.0 * torch.linalg.cross(axis, vector)
    return vector + quat[..., :1] * twice_cross + torch.linalg.cross(axis, twice_cross)


def quat_to_matrix(quat: Tensor) -> Tensor:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4)."""
    w, x, y, z = quat.unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, dim=-1).reshape(*quat.shape[:-1], 3, 3)


def matrix_to_quat(matrix: Tensor) -> Tensor:
    """Unit quaternions (..., 4) with w >= 0 of rotation matrices (..., 3, 3).

    Each of the four components gives one candidate row; the candidate with the largest leading
    component is the well-conditioned one.
    """
    m = matrix.reshape(*matrix.shape[:-2], 9).unbind(-1)
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = m
    candidates = torch.stack(
        [
            torch.stack([1 + m00 + m11 + m22, m21 - m12, m02 - m20, m10 - m01], dim=-1),
            torch.stack([m21 - m12, 1 + m00 - m11 - m22, m01 + m10, m02 + m20], dim=-1),
            torch.stack([m02 - m20, m01 + m10, 1 - m00 + m11 - m22, m12 + m21], dim=-1),
            torch.stack([m10 - m01, m02 + m20, m12 + m21, 1 - m00 - m11 + m22], dim=-1),
        ],
        dim=-2,
    )
    best = torch.diagonal(candidates, dim1=-2, dim2=-1).argmax(dim=-1)
    picked = torch.gather(candidates, -2, best[..., None, None].expand(*best.shape, 1, 4)).squeeze(-2)
    quat = quat_normalize(picked)
    return torch.where(quat[..., :1] < 0, -quat, quat)


def expmap_to_quat(expmap: Tensor) -> Tensor:
    """Unit quaternions (..., 4) of exponential maps (..., 3); any angle, 2 pi and beyond included."""
    squared = (expmap * expmap).sum(-1, keepdim=True)
    small = squared < SMALL_ANGLE**2
    angle = torch.sqrt(torch.where(small, torch.ones_like(squared), squared))
    half = 0.5 * angle
    scale = torch.where(small, 0.5 - squared / 48.0, torch.sin(half) / angle)
    cosine = torch.where(small, 1.0 - squared / 8.0, torch.cos(half))
    return torch.cat([cosine, scale * expmap], dim=-1)


def quat_to_expmap(quat: Tensor) -> Tensor:
    """Exponential maps (..., 3) of unit quaternions (..., 4), the shorter way round: angle <= pi."""
    quat = torch.where(quat[..., :1] < 0, -quat, quat)
    w, xyz = quat[..., :1], quat[..., 1:]
    squared = (xyz * xyz).sum(-1, keepdim=True)
    small = squared < (0.5 * SMALL_ANGLE) ** 2
    sine = torch.sqrt(torch.where(small, torch.ones_like(squared), squared))
    angle = 2.0 * torch.atan2(sine, w)
    scale = torch.where(small, 2.0 / torch.clamp(w, min=0.5) * (1.0 - squared / 3.0), angle / sine)
    return scale * xyz


def unwrap_expmap(expmap: Tensor) -> Tensor:
    """Exponential maps (T, ..., 3) of the same rotations, each frame the branch nearest the one before.

    A rotation by angle a about an axis is also one by a - 2 pi k; following the nearest branch keeps
    a track through pi continuous, except where it passes near a full turn.
    """
    out = expmap.clone()
    for t in range(1, expmap.shape[0]):
        current, previous = expmap[t], out[t - 1]
        angle = current.norm(dim=-1, keepdim=True)
        axis = current / angle.clamp(min=1e-8)
        along = (previous * axis).sum(-1, keepdim=True)
        turns = torch.round((along - angle) / (2 * math.pi))
        # Only near pi can another branch be meant; near zero the axis itself is noise.
        turns = torch.where(angle < 0.5, torch.zeros_like(turns), turns.clamp(-1, 1))
        out[t] = axis * (angle + 2 * math.pi * turns)
    return out


def quat_between(source: Tensor, target: Tensor) -> Tensor:
    """The smallest rotation (..., 4) that turns directions source onto target (..., 3)."""
    source, target = F.normalize(source, dim=-1), F.normalize(target, dim=-1)
    cross = torch.linalg.cross(source, target)
    w = 1.0 + (source * target).sum(-1, keepdim=True)
    # Opposite directions: any axis at right angles will do.
    helper = torch.where(
        source[..., :1].abs() < 0.9,
        source.new_tensor([1.0, 0.0, 0.0]),
        source.new_tensor([0.0, 1.0, 0.0]),
    )
    sideways = torch.linalg.cross(source, helper.expand_as(source))
    opposite = w < 1e-6
    quat = torch.cat(
        [torch.where(opposite, torch.zeros_like(w), w), torch.where(opposite, sideways, cross)], -1
    )
    return quat_normalize(quat)


def quat_slerp(a: Tensor, b: Tensor, fraction: Tensor) -> Tensor:
    """Spherical interpolation from a to b (..., 4) at fraction (...), the shorter way round."""
    dot = (a * b).sum(-1, keepdim=True)
    b = torch.where(dot < 0, -b, b)
    dot = dot.abs().clamp(max=1.0)
    angle = torch.acos(dot)
    sine = torch.sin(angle)
    fraction = fraction[..., None]
    near = sine < 1e-5
    safe = torch.where(near, torch.ones_like(sine), sine)
    weight_a = torch.where(near, 1.0 - fraction, torch.sin((1.0 - fraction) * angle) / safe)
    weight_b = torch.where(near, fraction, torch.sin(fraction * angle) / safe)
    return quat_normalize(weight_a * a + weight_b * b)


def quat_continuous(quat: Tensor) -> Tensor:
    """The same rotations (T, ..., 4) with signs chosen so that neighbours in time are close."""
    dots = (quat[1:] * quat[:-1]).sum(-1)
    flips = torch.cumprod(torch.where(dots < 0, -1.0, 1.0).to(quat.dtype), dim=0)
    return torch.cat([quat[:1], quat[1:] * flips[..., None]], dim=0)


def quat_from_yaw(yaw: Tensor) -> Tensor:
    """Rotations (..., 4) about Y by yaw (...)."""
    zero = torch.zeros_like(yaw)
    return torch.stack([torch.cos(0.5 * yaw), zero, torch.sin(0.5 * yaw), zero], dim=-1)


def wrap_angle(angle: Tensor) -> Tensor:
    """Angles folded into [-pi, pi)."""
    return torch.remainder(angle + math.pi, 2 * math.pi) - math.pi


def rotate_ground(yaw: Tensor, xz: Tensor) -> Tensor:
    """Ground vectors (..., 2) as x, z, turned about Y by yaw (...)."""
    sine, cosine = torch.sin(yaw), torch.cos(yaw)
    x, z = xz.unbind(-1)
    return torch.stack([cosine * x + sine * z, -sine * x + cosine * z], dim=-1)


def quat_to_sixd(quat: Tensor) -> Tensor:
    """The first two matrix columns (..., 6): a form without jumps (Zhou et al. 2019)."""
    matrix = quat_to_matrix(quat)
    return torch.cat([matrix[..., :, 0], matrix[..., :, 1]], dim=-1)


def sixd_to_quat(sixd: Tensor) -> Tensor:
    """Unit quaternions (..., 4) of two columns (..., 6), made orthonormal first (Gram-Schmidt)."""
    first = F.normalize(sixd[..., :3], dim=-1, eps=1e-8)
    second = sixd[..., 3:] - (first * sixd[..., 3:]).sum(-1, keepdim=True) * first
    second = F.normalize(second, dim=-1, eps=1e-8)
    return matrix_to_quat(torch.stack([first, second, torch.linalg.cross(first, second)], dim=-1))


def euler_to_quat(euler: Tensor, order: str) -> Tensor:
    """Rotations (..., 4) of intrinsic Euler angles (..., len(order)) in radians, as BVH channels list them.

    order is a word over X, Y, Z, such as "ZYX": the first angle turns about the first axis, outermost.
    """
    quat = quat_identity(tuple(euler.shape[:-1]), euler.dtype).to(euler.device)
    for index, axis in enumerate(order):
        half = 0.5 * euler[..., index]
        step = euler.new_zeros(*euler.shape[:-1], 4)
        step[..., 0] = torch.cos(half)
        step[..., 1 + "XYZ".index(axis)] = torch.sin(half)
        quat = quat_multiply(quat, step)
    return quat


def quat_to_euler(quat: Tensor, order: str) -> Tensor:
    """Intrinsic Euler angles (..., 3) in radians of rotations (..., 4), for an order of three distinct axes.

    The middle angle lies within [-pi/2, pi/2]. At the pole the last angle is put to zero.
    """
    i, j, k = ("XYZ".index(axis) for axis in order)
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    matrix = quat_to_matrix(quat)
    sine = (sign * matrix[..., i, k]).clamp(-1.0, 1.0)
    cosine = torch.sqrt(matrix[..., i, i] ** 2 + matrix[..., i, j] ** 2)
    middle = torch.atan2(sine, cosine)
    pole = cosine < 1e-6
    first = torch.atan2(-sign * matrix[..., j, k], matrix[..., k, k])
    last = torch.atan2(-sign * matrix[..., i, j], matrix[..., i, i])
    first_at_pole = torch.atan2(sign * matrix[..., k, j], matrix[..., j, j])
    first = torch.where(pole, first_at_pole, first)
    last = torch.where(pole, torch.zeros_like(last), last)
    return torch.stack([first, middle, last], dim=-1)


def quat_angle(a: Tensor, b: Tensor) -> Tensor:
    """The angle (...) in radians of the rotation between a and b (..., 4), in [0, pi]."""
    return quat_to_expmap(quat_multiply(quat_inverse(a), b)).norm(dim=-1)


def mean_rotation(moment: Tensor) -> Tensor:
    """The mean rotation (..., 4) from summed outer products q q^T (..., 4, 4) (Markley et al. 2007)."""
    _, vectors = torch.linalg.eigh(moment)
    quat = vectors[..., -1]
    return torch.where(quat[..., :1] < 0, -quat, quat)
