"""Metrics of sets of motions: a Frechet distance like FID, and diversity.

Both work on windows of one second, 10 frames apart. A window is described by mean and standard deviation over time of
the 24 values of the pose embedding (features/reference.py). Papers use the activations of a trained motion classifier,
which does not exist for this skeleton. So values are comparable only among themselves.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.features.reference import PoseEmbedding
from motionkit.metrics.value import MetricValue, need

WINDOW, STRIDE = 60, 10  # frames
TYPE_PAIRS = 20  # random pairs of motions of each type for the multimodality (Guo et al. 2020)
PAIRS = 300  # random pairs of windows for the diversity (Guo et al. 2020)


def window_features(features: Array, embedding: PoseEmbedding) -> Array:
    """Descriptions (W, 48) of the windows of unnormalised features (T, 276); a shorter motion is one window."""
    poses = embedding.of(features).astype(np.float64)
    starts = range(0, max(1, len(poses) - WINDOW + 1), STRIDE)
    windows = [poses[start : start + WINDOW] for start in starts]
    return np.stack([np.concatenate([window.mean(axis=0), window.std(axis=0)]) for window in windows])


def frechet_distance(made: Array, real: Array, name: str = "fid-pose") -> MetricValue:
    """Frechet distance between Gaussians fitted to two sets of windows (N, D), with the id `name` (Heusel et al. 2017).

    |m1 - m2|^2 + tr(C1 + C2 - 2 (C1 C2)^(1/2)). The trace of (C1 C2)^(1/2) is computed from the eigenvalues of
    C1^(1/2) C2 C1^(1/2), which is symmetric.

    Raises:
        MotionkitError: there are fewer than two windows in a set.
    """
    if min(len(made), len(real)) < 2:
        raise MotionkitError(f"the Frechet distance needs 2 windows a set, found {len(made)} and {len(real)}")
    means = made.mean(axis=0) - real.mean(axis=0)
    first, second = (np.cov(each, rowvar=False) for each in (made, real))
    values, vectors = np.linalg.eigh(first)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    inner = np.linalg.eigvalsh(root @ second @ root)
    cross = float(np.sqrt(np.maximum(inner, 0.0)).sum())
    distance = float(means @ means + np.trace(first) + np.trace(second) - 2.0 * cross)
    return MetricValue(
        name, max(distance, 0.0), "", {"window": float(WINDOW), "values": float(made.shape[1])}
    )


def diversity(windows: Array, seed: int = 0) -> MetricValue:
    """Mean distance of PAIRS random pairs of windows (N, D), id "diversity" (Guo et al. 2020, Action2Motion).

    Raises:
        MotionkitError: there are fewer than two windows.
    """
    need(len(windows), 2, "diversity needs", "window")
    random = np.random.default_rng(seed)
    first = random.integers(len(windows), size=PAIRS)
    second = (first + random.integers(1, len(windows), size=PAIRS)) % len(windows)
    distance = np.linalg.norm(windows[first] - windows[second], axis=1).mean()
    return MetricValue("diversity", float(distance), "", {"window": float(WINDOW), "pairs": float(PAIRS)})


def multimodality(motions: Sequence[Sequence[Array]], seed: int = 0) -> MetricValue:
    """Mean distance of random windows of two motions of the same type, id "multimodality" (Guo et al. 2020).

    motions are for each type its motions, each as windows (N, D); TYPE_PAIRS pairs are drawn of each type.

    Raises:
        MotionkitError: no type has two motions.
    """
    random = np.random.default_rng(seed)
    several = [of_type for of_type in motions if len(of_type) > 1]
    need(len(several), 1, "multimodality needs two motions of", "type")
    distances = []
    for of_type in several:
        for _ in range(TYPE_PAIRS):
            first, second = (of_type[i] for i in random.choice(len(of_type), 2, replace=False))
            distances.append(np.linalg.norm(random.choice(first) - random.choice(second)))
    return MetricValue("multimodality", float(np.mean(distances)), "", {"pairs": float(TYPE_PAIRS)})
