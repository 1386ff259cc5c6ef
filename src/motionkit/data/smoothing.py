"""Filters marker jitter out of recorded rotations.

Optical capture solves joints from noisy markers. In CMU walking, spine, toes and shoulders change more by noise than
by movement from frame to frame. A network cannot predict noise and learns to damp all movement instead. The filter
is that of Savitzky and Golay (1964): a cubic fitted to 9 frames, which passes frequencies below about 7 Hz at 60 fps.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from motionkit.arrays import Array, normalized
from motionkit.motion.rotations import quat_continuous

WINDOW = 9  # frames
DEGREE = 3


@lru_cache
def _kernel(window: int) -> Array:
    """Weights (window,) whose product with a window is the value of the fitted cubic in its middle."""
    place = np.arange(window, dtype=np.float64) - window // 2
    powers = place[:, None] ** np.arange(DEGREE + 1, dtype=np.float64)
    return np.linalg.pinv(powers)[0]


def window_at(fps: float) -> int:
    """Odd filter length in frames, at least 5, that passes the same frequencies at this rate as WINDOW at 60 fps."""
    return max(5, 2 * round((WINDOW / 2 * fps / 60.0) - 0.5) + 1)


def smooth(values: Array, window: int = WINDOW) -> Array:
    """Filter values (T, ...) over time, continued beyond their ends by point reflection.

    Sequences shorter than half a window are returned unchanged.
    """
    half = window // 2
    frames = len(values)
    if frames <= half:
        return values
    wide = values.astype(np.float64)
    before = 2.0 * wide[:1] - np.flip(wide[1 : half + 1], 0)
    after = 2.0 * wide[-1:] - np.flip(wide[-half - 1 : -1], 0)
    padded = np.concatenate([before, wide, after])
    out = sum(weight * padded[i : i + frames] for i, weight in enumerate(_kernel(window).tolist()))
    assert isinstance(out, np.ndarray)
    return out.astype(values.dtype)


def smooth_rotations(rotations: Array, window: int = WINDOW) -> Array:
    """Filter quaternions (T, ..., 4) by component and normalise them again."""
    return normalized(smooth(quat_continuous(rotations), window))
