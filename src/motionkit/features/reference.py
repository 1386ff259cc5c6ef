"""The reference: an outline of the coming second's poses, which tells a body what to do next.

The paper has no such signal. A walk can be told from its last steps; what comes next in a dance, and when a
stance turns into a kick, cannot, and a network that has to guess answers with the mean of all guesses, which
is to stand still. An outline writes a pose as a few numbers: where the joints are, along the directions in
which recorded poses differ most (principal components). The reference of a frame is the outline of poses a little
ahead of it. It says nothing of the way over the ground: that is the trajectory's.

The network is shown how far each of these poses is from the present one, which is nearly the movement it is to
make, and brings a body that has strayed back to what is asked for.

Half of the directions are even and half are odd under left and right exchanged, so that the outline of a
mirrored pose is the same outline with some signs changed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array
from motionkit.features.layout import FeatureLayout
from motionkit.features.normalize import Scaling

EMBEDDING_COUNT = 24
REFERENCE_OFFSETS: tuple[int, ...] = (5, 15, 30)  # frames ahead, at 60 fps
REFERENCE_COUNT = EMBEDDING_COUNT * len(REFERENCE_OFFSETS)
LEAST_SHARE = 1e-6  # of the largest variance, for a direction to count
# Near poses differ less from the present one; in these units all three are of about the same size.
REFERENCE_SCALES: tuple[float, ...] = (4.0, 2.0, 1.0)


@dataclass(frozen=True, eq=False)
class PoseEmbedding:
    """A linear map from unnormalised features to reference_clips, which have about unit size.

    Attributes:
        matrix: (276, 24); only joint positions count.
        offset: (24,) subtracted.
    """

    matrix: Array
    offset: Array

    def of(self, features: Array) -> Array:
        """Outlines (..., 24) of features (..., 276), unnormalised."""
        return features @ self.matrix - self.offset


def fit_pose_embedding(features: Array, weights: Array, layout: FeatureLayout) -> PoseEmbedding:
    """The directions in which poses differ most, those even and those odd under mirroring together in order.

    Args:
        features: (N, 276) unnormalised.
        weights: (N,) how much each frame counts.
    """
    block = layout.blocks["joint_positions"]
    poses = features[:, block].astype(np.float64)
    share = (weights / weights.sum()).astype(np.float64)
    indices, signs = layout.mirror_map()
    swap = np.zeros((poses.shape[1], poses.shape[1]), np.float64)
    rows = np.arange(poses.shape[1])
    swap[indices[block] - block.start, rows] = signs[block].astype(np.float64)
    mean = share @ poses
    # Over poses and their mirror images, whose mean is even and whose covariance keeps even and odd apart.
    mean = 0.5 * (mean + mean @ swap)
    moved = poses - mean
    spread = moved.T @ (moved * share[:, None])
    spread = 0.5 * (spread + swap.T @ spread @ swap)
    values, vectors = np.linalg.eigh(spread)
    best = np.argsort(-values, kind="stable")[:EMBEDDING_COUNT]
    directions = vectors[:, best]
    # A direction and its negative are one: the largest number of each is positive, the first of those that left and
    # right have in common.
    sizes = np.abs(directions)
    largest = (sizes > 0.999 * sizes.max(axis=0)).astype(np.int32).argmax(axis=0)
    directions = directions * np.sign(directions[largest, np.arange(len(best))])
    # Where poses differ along fewer directions the others would be any, and other ones on another machine.
    directions = directions * (values[best] > LEAST_SHARE * values[best[0]])
    # Small directions stay small beside large ones, but are not lost.
    scale = np.sqrt(np.maximum(values[best], 0.0))
    scale = np.maximum(np.maximum(scale, 0.3 * scale.max()), 1e-6)
    matrix = np.zeros((features.shape[1], EMBEDDING_COUNT), np.float64)
    matrix[block, : len(best)] = directions / scale
    return PoseEmbedding(matrix.astype(np.float32), (mean @ (directions / scale)).astype(np.float32))


def reference_signal(reference_clips: Array, frames: Array) -> Array:
    """Guides (..., 72) of frames (...), indices into reference_clips (T, 24); the last outline is held beyond its end."""
    ahead = frames[..., None] + np.array(REFERENCE_OFFSETS)
    return reference_clips[np.minimum(ahead, len(reference_clips) - 1)].reshape(
        *frames.shape, REFERENCE_COUNT
    )


@dataclass(frozen=True, eq=False)
class ReferenceMap:
    """What turns a reference into what the network is shown of it: gains x reference - (x @ matrix + constant).

    Attributes:
        gains: (72,).
        matrix, constant: (276, 72), (72,) of the present frame x, normalised.
    """

    gains: Array
    matrix: Array
    constant: Array

    def shown(self, reference: Array, x: Array) -> Array:
        """Guides (..., 72) as seen from normalised frames x (..., 276)."""
        return self.gains * reference - (x @ self.matrix + self.constant)


def reference_map(outline: PoseEmbedding, scaling: Scaling) -> ReferenceMap:
    """The map of an outline and of the scaling of features."""
    gains = np.array(REFERENCE_SCALES, np.float32).repeat(EMBEDDING_COUNT)
    matrix = np.tile(scaling.std[:, None] * outline.matrix, len(REFERENCE_OFFSETS))
    constant = np.tile(scaling.mean @ outline.matrix - outline.offset, len(REFERENCE_OFFSETS))
    return ReferenceMap(gains, matrix * gains, constant * gains)
