"""Takes the trembling of markers out of recorded rotations.

Optical capture solves joints that hardly move from markers that tremble: in CMU walking the steps of spine,
toes and shoulders from one frame to the next are more noise than movement. A network cannot predict it, and
what it learns instead is to damp all movement. The filter is that of Savitzky and Golay (1964): a cubic fitted
to 9 frames, which keeps what is slower than about 7 Hz at 60 fps.
"""

from __future__ import annotations

from functools import lru_cache

import torch
from torch import Tensor

from motionkit.motion.rotations import quat_continuous

WINDOW = 9  # frames
DEGREE = 3


@lru_cache
def _kernel() -> Tensor:
    """Weights (WINDOW,) that give the fitted cubic's value in the middle."""
    place = torch.arange(WINDOW, dtype=torch.float64) - WINDOW // 2
    powers = place[:, None] ** torch.arange(DEGREE + 1, dtype=torch.float64)
    return torch.linalg.pinv(powers)[0]


def smooth(values: Tensor) -> Tensor:
    """Values (T, ...) filtered over time; beyond the ends they go on mirrored through the end values.

    Fewer frames than half a window come back as they are.
    """
    half = WINDOW // 2
    frames = len(values)
    if frames <= half:
        return values
    wide = values.double()
    before = 2.0 * wide[:1] - wide[1 : half + 1].flip(0)
    after = 2.0 * wide[-1:] - wide[-half - 1 : -1].flip(0)
    padded = torch.cat([before, wide, after])
    out = sum(weight * padded[i : i + frames] for i, weight in enumerate(_kernel().tolist()))
    assert isinstance(out, Tensor)
    return out.to(values.dtype)


def smooth_rotations(rotations: Tensor) -> Tensor:
    """Rotations (T, ..., 4) filtered as the four numbers they are, and made unit again."""
    return torch.nn.functional.normalize(smooth(quat_continuous(rotations)), dim=-1)
