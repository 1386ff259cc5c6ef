"""Rotation matrices in torch, for losses that need gradients; tests compare them with motion/rotations.py.

Units and conventions are those of motion/rotations.py, but rows and columns come first, because sums over first
dimensions are fast. Small angles use series, and roots use safe denominators, so that gradients stay finite. Products
are elementwise: the matrix units of a GPU would round their factors to 10 bits.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from motionkit.motion.rotations import SMALL_ANGLE


def multiply(a: Tensor, b: Tensor) -> Tensor:
    """Return the product a b of matrices (3, 3, ...): a rotation by b, then by a."""
    return (a[:, :, None] * b).sum(1)


def rotate(matrix: Tensor, vector: Tensor) -> Tensor:
    """Rotate vectors (3, ...) by matrices (3, 3, ...)."""
    return (matrix * vector).sum(1)


def yaw_to_matrix(yaw: Tensor) -> Tensor:
    """Return rotations (3, 3, ...) about Y by yaw (...) in radians."""
    cos, sin, zero = torch.cos(yaw), torch.sin(yaw), torch.zeros_like(yaw)
    return torch.stack([cos, zero, sin, zero, zero + 1.0, zero, -sin, zero, cos]).unflatten(0, (3, 3))


def expmap_to_matrix(expmap: Tensor) -> Tensor:
    """Return rotations (3, 3, ...) of exponential maps (3, ...), by Rodrigues' formula."""
    squared = expmap.square().sum(0)
    small = squared < SMALL_ANGLE**2
    safe = torch.where(small, 1.0, squared)
    angle = torch.sqrt(safe)
    half = torch.sin(0.5 * angle)
    along = torch.where(small, 0.5 - squared / 24.0, 2.0 * half * half / safe)
    across = torch.where(small, 1.0 - squared / 6.0, torch.sin(angle) / angle)
    cosine = 1.0 - along * squared
    x, y, z = across * expmap
    sums = torch.stack([cosine, -z, y, z, cosine, -x, -y, x, cosine]).unflatten(0, (3, 3))
    return sums + expmap[:, None] * (along * expmap)


def orthonormal(sixd: Tensor) -> Tensor:
    """Return two matrix columns (..., 6) made orthonormal (Gram-Schmidt)."""
    first = F.normalize(sixd[..., :3], dim=-1, eps=1e-8)
    second = sixd[..., 3:] - (first * sixd[..., 3:]).sum(-1, keepdim=True) * first
    return torch.cat([first, F.normalize(second, dim=-1, eps=1e-8)], dim=-1)


def sixd_to_matrix(sixd: Tensor) -> Tensor:
    """Return rotations (3, 3, ...) of two matrix columns (..., 6), after orthonormal()."""
    first, second = orthonormal(sixd).movedim(-1, 0).split(3)
    return torch.stack([first, second, torch.linalg.cross(first, second, dim=0)], dim=1)
