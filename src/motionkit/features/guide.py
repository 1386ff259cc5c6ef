"""The guide: an outline of the coming second's poses, which tells a body what to do next.

The paper has no such signal. A walk can be told from its last steps; what comes next in a dance, and when a
stance turns into a kick, cannot, and a network that has to guess answers with the mean of all guesses, which
is to stand still. An outline writes a pose as a few numbers: where the joints are, along the directions in
which recorded poses differ most (principal components). The guide of a frame is the outline of poses a little
ahead of it. It says nothing of the way over the ground: that is the trajectory's.

The network is shown how far each of these poses is from the present one, which is nearly the movement it is to
make, and brings a body that has strayed back to what is asked for.

Half of the directions are even and half are odd under left and right exchanged, so that the outline of a
mirrored pose is the same outline with some signs changed.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from motionkit.features.layout import FeatureLayout
from motionkit.features.normalize import Scaling

OUTLINE_COUNT = 24
GUIDE_OFFSETS: tuple[int, ...] = (5, 15, 30)  # frames ahead, at 60 fps
GUIDE_COUNT = OUTLINE_COUNT * len(GUIDE_OFFSETS)
LEAST_SHARE = 1e-6  # of the largest variance, for a direction to count
# Near poses differ less from the present one; in these units all three are of about the same size.
GUIDE_GAINS: tuple[float, ...] = (4.0, 2.0, 1.0)


@dataclass(frozen=True, eq=False)
class PoseOutline:
    """A linear map from unnormalised features to outlines, which have about unit size.

    Attributes:
        matrix: (276, 24); only joint positions count.
        offset: (24,) subtracted.
    """

    matrix: Tensor
    offset: Tensor

    def of(self, features: Tensor) -> Tensor:
        """Outlines (..., 24) of features (..., 276), unnormalised."""
        return features @ self.matrix - self.offset


def fit_outline(features: Tensor, weights: Tensor, layout: FeatureLayout) -> PoseOutline:
    """The directions in which poses differ most, those even and those odd under mirroring together in order.

    Args:
        features: (N, 276) unnormalised.
        weights: (N,) how much each frame counts.
    """
    block = layout.blocks["joint_positions"]
    poses = features[:, block].double()
    share = (weights / weights.sum()).double()
    indices, signs = layout.mirror_map()
    swap = torch.zeros(poses.shape[1], poses.shape[1], dtype=torch.float64)
    rows = torch.arange(poses.shape[1])
    swap[indices[block] - block.start, rows] = signs[block].double()
    mean = share @ poses
    # Over poses and their mirror images, whose mean is even and whose covariance keeps even and odd apart.
    mean = 0.5 * (mean + mean @ swap)
    moved = poses - mean
    spread = moved.T @ (moved * share[:, None])
    spread = 0.5 * (spread + swap.T @ spread @ swap)
    values, vectors = torch.linalg.eigh(spread)
    best = values.argsort(descending=True)[:OUTLINE_COUNT]
    directions = vectors[:, best]
    # A direction and its negative are one: the largest number of each is positive, the first of those that left and
    # right have in common.
    sizes = directions.abs()
    largest = (sizes > 0.999 * sizes.amax(dim=0)).int().argmax(dim=0)
    directions = directions * directions[largest, torch.arange(len(best))].sign()
    # Where poses differ along fewer directions the others would be any, and other ones on another machine.
    directions = directions * (values[best] > LEAST_SHARE * values[best[0]])
    # Small directions stay small beside large ones, but are not lost.
    scale = values[best].clamp(min=0.0).sqrt()
    scale = torch.maximum(scale, 0.3 * scale.max()).clamp(min=1e-6)
    matrix = torch.zeros(features.shape[1], OUTLINE_COUNT, dtype=torch.float64)
    matrix[block, : len(best)] = directions / scale
    return PoseOutline(matrix.float(), (mean @ (directions / scale)).float())


def guide_signal(outlines: Tensor, frames: Tensor) -> Tensor:
    """Guides (..., 72) of frames (...), indices into outlines (T, 24); the last outline is held beyond its end."""
    ahead = frames[..., None] + torch.tensor(GUIDE_OFFSETS)
    return outlines[ahead.clamp(max=len(outlines) - 1)].flatten(-2)


@dataclass(frozen=True, eq=False)
class GuideMap:
    """What turns a guide into what the network is shown of it: gains x guide - (x @ matrix + constant).

    Attributes:
        gains: (72,).
        matrix, constant: (276, 72), (72,) of the present frame x, normalised.
    """

    gains: Tensor
    matrix: Tensor
    constant: Tensor

    def shown(self, guide: Tensor, x: Tensor) -> Tensor:
        """Guides (..., 72) as seen from normalised frames x (..., 276)."""
        return self.gains * guide - (x @ self.matrix + self.constant)

    def to(self, device: torch.device) -> GuideMap:
        """The map on a device."""
        return GuideMap(*(value.to(device) for value in vars(self).values()))


def guide_map(outline: PoseOutline, scaling: Scaling) -> GuideMap:
    """The map of an outline and of the scaling of features."""
    gains = torch.tensor(GUIDE_GAINS).repeat_interleave(OUTLINE_COUNT)
    matrix = (scaling.std[:, None] * outline.matrix).repeat(1, len(GUIDE_OFFSETS))
    constant = (scaling.mean @ outline.matrix - outline.offset).repeat(len(GUIDE_OFFSETS))
    return GuideMap(gains, matrix * gains, constant * gains)
