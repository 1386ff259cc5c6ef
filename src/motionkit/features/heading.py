"""The direction a body faces on the ground, without flips while it is upside down."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from motionkit.motion.skeleton import JOINT_NAMES

# The trunk counts as upright within 60 degrees of vertical; beyond, its left-right axis tells nothing
# sure about the facing.
UPRIGHT_COSINE = 0.5
SMOOTHING_SECONDS = 0.08


def heading_angles(global_positions: Tensor, fps: float) -> Tensor:
    """Yaw (T,) in radians of the facing direction, continuous over time; 0 faces +Z, pi/2 faces +X.

    Upright frames take the mean of the axes across hips and shoulders. Inverted spans take the shortest
    arc from the last upright heading to the next. The result is smoothed lightly.

    Args:
        global_positions: (T, 23, 3) joints of the canonical skeleton in the world.
        fps: frames per second.
    """
    yaw, upright = _raw_heading(global_positions.double())
    yaw = _bridge(yaw, upright)
    return _smooth(yaw, SMOOTHING_SECONDS * fps).to(global_positions.dtype)


def _raw_heading(positions: Tensor) -> tuple[Tensor, Tensor]:
    at = JOINT_NAMES.index
    across_hips = positions[:, at("LeftUpLeg")] - positions[:, at("RightUpLeg")]
    across_shoulders = positions[:, at("LeftArm")] - positions[:, at("RightArm")]
    across = F.normalize(across_hips, dim=-1) + F.normalize(across_shoulders, dim=-1)
    trunk = F.normalize(positions[:, at("Neck")] - positions[:, 0], dim=-1)
    # Facing is across x up: left along +X and up along +Y face +Z.
    yaw = torch.atan2(-across[:, 2], across[:, 0])
    level = across[:, [0, 2]].norm(dim=-1) > 0.6
    return yaw, (trunk[:, 1] > UPRIGHT_COSINE) & level


def _bridge(yaw: Tensor, upright: Tensor) -> Tensor:
    """Unroll upright headings along the shortest arcs and interpolate between them."""
    known = torch.nonzero(upright).flatten()
    if len(known) == 0:
        known = torch.arange(len(yaw))
    steps = torch.diff(yaw[known])
    steps = torch.remainder(steps + math.pi, 2 * math.pi) - math.pi
    unrolled = torch.cat([yaw[known[:1]], yaw[known[:1]] + torch.cumsum(steps, 0)])
    frames = torch.arange(len(yaw))
    right = torch.searchsorted(known, frames).clamp(max=len(known) - 1)
    left = (right - 1).clamp(min=0)
    left = torch.where(frames >= known[right], right, left)
    span = (known[right] - known[left]).clamp(min=1)
    weight = ((frames - known[left]).double() / span).clamp(0.0, 1.0)
    return unrolled[left] * (1 - weight) + unrolled[right] * weight


def _smooth(values: Tensor, sigma: float) -> Tensor:
    """Gaussian smoothing (T,) with the ends continued in a straight line."""
    radius = max(1, math.ceil(3 * sigma))
    if len(values) < 3:
        return values
    kernel = torch.exp(-0.5 * (torch.arange(-radius, radius + 1, dtype=values.dtype) / sigma) ** 2)
    kernel = kernel / kernel.sum()
    before = values[0] - (values[1] - values[0]) * torch.arange(radius, 0, -1, dtype=values.dtype)
    after = values[-1] + (values[-1] - values[-2]) * torch.arange(1, radius + 1, dtype=values.dtype)
    padded = torch.cat([before, values, after])
    return F.conv1d(padded[None, None], kernel[None, None])[0, 0]
