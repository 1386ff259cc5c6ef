"""Rotation functions in torch, for losses that need gradients; tests compare them with motion/rotations.py.

Shapes, units and conventions are those of motion/rotations.py. Small angles use series, and roots use safe
denominators, so that gradients stay finite.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from motionkit.features.layout import feature_layout
from motionkit.motion.rotations import SMALL_ANGLE
from motionkit.motion.skeleton import JOINT_COUNT


def quat_multiply(a: Tensor, b: Tensor) -> Tensor:
    """Return the product a b (..., 4): a rotation by b, then by a."""
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
    """Rotate vectors (..., 3) by unit quaternions (..., 4)."""
    axis, vector = torch.broadcast_tensors(quat[..., 1:], vector)
    twice_cross = 2.0 * torch.linalg.cross(axis, vector)
    return vector + quat[..., :1] * twice_cross + torch.linalg.cross(axis, twice_cross)


def quat_from_yaw(yaw: Tensor) -> Tensor:
    """Return rotations (..., 4) about Y by yaw (...) in radians."""
    zero = torch.zeros_like(yaw)
    return torch.stack([torch.cos(0.5 * yaw), zero, torch.sin(0.5 * yaw), zero], dim=-1)


def expmap_to_quat(expmap: Tensor) -> Tensor:
    """Return unit quaternions (..., 4) of exponential maps (..., 3)."""
    squared = (expmap * expmap).sum(-1, keepdim=True)
    small = squared < SMALL_ANGLE**2
    angle = torch.sqrt(torch.where(small, torch.ones_like(squared), squared))
    half = 0.5 * angle
    scale = torch.where(small, 0.5 - squared / 48.0, torch.sin(half) / angle)
    cosine = torch.where(small, 1.0 - squared / 8.0, torch.cos(half))
    return torch.cat([cosine, scale * expmap], dim=-1)


def matrix_to_quat(matrix: Tensor) -> Tensor:
    """Return unit quaternions (..., 4) with w >= 0 of rotation matrices (..., 3, 3)."""
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
    quat = F.normalize(picked, dim=-1, eps=1e-12)
    return torch.where(quat[..., :1] < 0, -quat, quat)


def orthonormal(sixd: Tensor) -> Tensor:
    """Return two matrix columns (..., 6) made orthonormal (Gram-Schmidt)."""
    first = F.normalize(sixd[..., :3], dim=-1, eps=1e-8)
    second = sixd[..., 3:] - (first * sixd[..., 3:]).sum(-1, keepdim=True) * first
    return torch.cat([first, F.normalize(second, dim=-1, eps=1e-8)], dim=-1)


def sixd_to_quat(sixd: Tensor) -> Tensor:
    """Return unit quaternions (..., 4) of two matrix columns (..., 6), after orthonormal()."""
    columns = orthonormal(sixd)
    first, second = columns[..., :3], columns[..., 3:]
    return matrix_to_quat(torch.stack([first, second, torch.linalg.cross(first, second)], dim=-1))


def decode_rotations(
    features: Tensor,
    reference_rotations: Tensor,
    layout: str,
    joints: Sequence[int] = range(1, JOINT_COUNT),
) -> Tensor:
    """Return local rotations (..., 1 + N, 4) of the root and of N joints, the other 22 by default.

    features (..., 276) are unnormalised. The root's rotation is relative to its heading.
    """
    columns = feature_layout(layout)
    root = features[..., columns.blocks["root_rotation"]]
    root = (sixd_to_quat if columns.root_is_sixd else expmap_to_quat)(root)
    expmaps = features[..., columns.blocks["joint_rotations"]]
    # Slices, because a list of indices comes from the CPU, and a CUDA graph cannot wait for that.
    expmaps = torch.stack([expmaps[..., 3 * j - 3 : 3 * j] for j in joints], dim=-2)
    references = torch.stack([reference_rotations[j] for j in joints]).to(expmaps)
    return torch.cat([root[..., None, :], quat_multiply(references, expmap_to_quat(expmaps))], dim=-2)
