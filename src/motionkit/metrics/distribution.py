"""Metrics of sets of motions: a Frechet distance like FID, and diversity.

Both work on windows of one second, 10 frames apart. A window is described by mean and standard deviation over time of
the 24 values of the pose embedding (features/reference.py). Papers use the activations of a trained motion classifier,
which does not exist for this skeleton. So values are comparable only among themselves.
"""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.features.reference import EMBEDDING_COUNT, PoseEmbedding
from motionkit.metrics.value import MetricValue, need

WINDOW, STRIDE = 60, 10  # frames
WINDOW_VALUES = 2 * EMBEDDING_COUNT
PAIRS = 300  # random pairs of windows for the diversity (Guo et al. 2020)


def window_features(features: Array, embedding: PoseEmbedding) -> Array:
    """Descriptions (W, 48) of a motion's windows; a motion shorter than a window is one window.

    Args:
        features: (T, 276) unnormalised.
    """
    poses = embedding.of(features).astype(np.float64)
    starts = range(0, max(1, len(poses) - WINDOW + 1), STRIDE)
    windows = [poses[start : start + WINDOW] for start in starts]
    return np.stack([np.concatenate([window.mean(axis=0), window.std(axis=0)]) for window in windows])


def frechet_distance(made: Array, real: Array) -> MetricValue:
    """Frechet distance between Gaussians fitted to two sets of windows (N, D), id "fid-pose" (Heusel et al. 2017).

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
        "fid-pose", max(distance, 0.0), "", {"window": float(WINDOW), "values": float(made.shape[1])}
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
