"""Reference poses: embeddings of recorded poses up to half a second ahead, which show the body what to do next.

The paper has no such signal. A network can continue a walk from its last steps, but it cannot know what comes next
in a dance, or when a stance turns into a kick. If it has to guess, it predicts the mean of all continuations, which
is to stand still. A pose embedding describes a pose by 24 numbers: its joint positions along the principal components
of recorded poses. The reference of a frame holds the embeddings at REFERENCE_OFFSETS ahead of it. The path over the
ground is not part of it; that is the trajectory.

The network sees the difference between each of these poses and the present one. The difference resembles the movement
to make, and it leads a body that has drifted back to the reference.

Each principal component is even or odd under a swap of left and right. So mirroring a pose only changes signs of its
embedding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array, row_products
from motionkit.features.layout import FeatureLayout
from motionkit.features.normalize import Scaling

EMBEDDING_COUNT = 24
REFERENCE_OFFSETS: tuple[int, ...] = (5, 15, 30)  # frames ahead, at 60 fps
REFERENCE_COUNT = EMBEDDING_COUNT * len(REFERENCE_OFFSETS)
PAUSE = 20  # frames between the end of a performance, strike or jump and the beginning of the next
BEFORE_EVENT = 15  # playback of a clip of strikes or jumps begins this many frames before one
LEAST_SHARE = 1e-6  # share of the largest variance; components with less are dropped
# Nearer reference poses differ less from the present pose; these factors bring the three to about the same size.
REFERENCE_SCALES: tuple[float, ...] = (4.0, 2.0, 1.0)


@dataclass(frozen=True, eq=False)
class PoseEmbedding:
    """A linear map from unnormalised features to pose embeddings with values of about unit size.

    Attributes:
        matrix: (276, 24), zero except in the rows of joint positions.
        offset: (24,) subtracted from the product.
    """

    matrix: Array
    offset: Array

    def of(self, features: Array) -> Array:
        """Pose embeddings (..., 24) of unnormalised features (..., 276)."""
        return features @ self.matrix - self.offset

    def columns(self, numbers: list[int]) -> Array:
        """Matrix (24, N) from differences of embeddings to the least differences of N columns of the features."""
        return np.linalg.pinv(self.matrix.astype(np.float64))[:, numbers]


def fit_pose_embedding(features: Array, weights: Array, layout: FeatureLayout) -> PoseEmbedding:
    """Fit the principal components of the joint positions of unnormalised features (N, 276) with weights (N,).

    They have the largest variance, and each is even or odd under mirroring.
    """
    block = layout.blocks["joint_positions"]
    poses = features[:, block].astype(np.float64)
    share = (weights / weights.sum()).astype(np.float64)
    indices, signs = layout.mirror_map()
    swap = np.zeros((poses.shape[1], poses.shape[1]), np.float64)
    rows = np.arange(poses.shape[1])
    swap[indices[block] - block.start, rows] = signs[block].astype(np.float64)
    mean = share @ poses
    # Averaged over poses and their mirror images, the mean is even, and the covariance separates even from odd.
    mean = 0.5 * (mean + mean @ swap)
    moved = poses - mean
    spread = moved.T @ (moved * share[:, None])
    spread = 0.5 * (spread + swap.T @ spread @ swap)
    values, vectors = np.linalg.eigh(spread)
    best = np.argsort(-values, kind="stable")[:EMBEDDING_COUNT]
    directions = vectors[:, best]
    # Eigenvectors have no sign of their own: make the largest component positive (the first if left and right tie).
    sizes = np.abs(directions)
    largest = (sizes > 0.999 * sizes.max(axis=0)).astype(np.int32).argmax(axis=0)
    directions = directions * np.sign(directions[largest, np.arange(len(best))])
    # Directions without variance are arbitrary and depend on the machine: drop them.
    directions = directions * (values[best] > LEAST_SHARE * values[best[0]])
    # Divide by the deviation, but not by less than 0.3 of the largest, so that small components are not blown up.
    scale = np.sqrt(np.maximum(values[best], 0.0))
    scale = np.maximum(np.maximum(scale, 0.3 * scale.max()), 1e-6)
    matrix = np.zeros((features.shape[1], EMBEDDING_COUNT), np.float64)
    matrix[block, : len(best)] = directions / scale
    return PoseEmbedding(matrix.astype(np.float32), (mean @ (directions / scale)).astype(np.float32))


def reference_signal(reference_clips: Array, frames: Array) -> Array:
    """Reference poses (..., 72) at frames (...) of a reference clip (T, 24), whose last pose is held beyond its end."""
    ahead = frames[..., None] + np.array(REFERENCE_OFFSETS)
    return reference_clips[np.minimum(ahead, len(reference_clips) - 1)].reshape(
        *frames.shape, REFERENCE_COUNT
    )


def event_begins(phases: Array) -> Array:
    """Frames (N,) at which phases (T,) begin a strike or jump; phases are negative outside of them."""
    return np.flatnonzero((phases[1:] >= 0.0) & (phases[:-1] < 0.0)) + 1


@dataclass(frozen=True, eq=False)
class ReferenceMap:
    """Maps reference poses to the network's input: gains * reference - (x @ matrix + constant).

    Attributes:
        gains: (72,) scale of each value.
        matrix, constant: (276, 72) and (72,), which give the scaled embedding of the present normalised frame x.
    """

    gains: Array
    matrix: Array
    constant: Array

    def network_input(self, reference: Array, x: Array, alone: bool = True) -> Array:
        """Reference poses (..., 72) relative to the present normalised frames x (..., 276).

        alone: multiply row by row, so that the last digits of a row do not depend on the others.
        """
        product = row_products(x, self.matrix) if alone else x @ self.matrix
        return self.gains * reference - (product + self.constant)


def reference_map(embedding: PoseEmbedding, scaling: Scaling) -> ReferenceMap:
    """The ReferenceMap of a pose embedding and the scaling of the features."""
    gains = np.array(REFERENCE_SCALES, np.float32).repeat(EMBEDDING_COUNT)
    matrix = np.tile(scaling.std[:, None] * embedding.matrix, len(REFERENCE_OFFSETS))
    constant = np.tile(scaling.mean @ embedding.matrix - embedding.offset, len(REFERENCE_OFFSETS))
    return ReferenceMap(gains, matrix * gains, constant * gains)
