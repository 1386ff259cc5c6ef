"""Takes the trembling of markers out of recorded rotations.

Optical capture solves joints that hardly move from markers that tremble: in CMU walking the steps of spine,
toes and shoulders from one frame to the next are more noise than movement. A network cannot predict it, and
what it learns instead is to damp all movement. The filter is that of Savitzky and Golay (1964): a cubic fitted
to 9 frames, which keeps what is slower than about 7 Hz at 60 fps.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from motionkit.arrays import Array, normalized
from motionkit.motion.rotations import quat_continuous

WINDOW = 9  # frames
DEGREE = 3


@lru_cache
def _kernel() -> Array:
    """Weights (WINDOW,) that give the fitted cubic's value in the middle."""
    place = np.arange(WINDOW, dtype=np.float64) - WINDOW // 2
    powers = place[:, None] ** np.arange(DEGREE + 1, dtype=np.float64)
    return np.linalg.pinv(powers)[0]


def smooth(values: Array) -> Array:
    """Values (T, ...) filtered over time; beyond the ends they go on mirrored through the end values.

    Fewer frames than half a window come back as they are.
    """
    half = WINDOW // 2
    frames = len(values)
    if frames <= half:
        return values
    wide = values.astype(np.float64)
    before = 2.0 * wide[:1] - np.flip(wide[1 : half + 1], 0)
    after = 2.0 * wide[-1:] - np.flip(wide[-half - 1 : -1], 0)
    padded = np.concatenate([before, wide, after])
    out = sum(weight * padded[i : i + frames] for i, weight in enumerate(_kernel().tolist()))
    assert isinstance(out, np.ndarray)
    return out.astype(values.dtype)


def smooth_rotations(rotations: Array) -> Array:
    """Rotations (T, ..., 4) filtered as the four numbers they are, and made unit again."""
    return normalized(smooth(quat_continuous(rotations)))
