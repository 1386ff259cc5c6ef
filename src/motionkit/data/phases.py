"""How far a performance has come: the phase of types that turn the body over, such as cartwheels.

The paper has no such signal. A run can be told from its last poses; a cartwheel begins from standing,
and when to begin is not in the poses. Its phase, from 0 at the start of a labelled stretch to 1 at the
end, says so (docs/features.md).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from motionkit.features.decode import decode_rotations
from motionkit.motion.rotations import quat_rotate

NO_PHASE = -1.0
# A stretch turns over when the hips' up axis points this far below level at some frame.
_INVERTED = -0.3


def turns_over(features: Tensor, layout: str) -> bool:
    """Whether the hips are upside down at some frame of features (T, 276), unnormalised."""
    root = decode_rotations(features, None, layout)[:, 0]
    up = quat_rotate(root, torch.tensor([0.0, 1.0, 0.0]).expand(len(root), 3))
    return bool((up[:, 1] < _INVERTED).any())


def type_stretches(types: np.ndarray) -> list[tuple[int, int, int]]:
    """Stretches (start, end, type id) of equal ids in a track (T,)."""
    edges = [0, *(np.flatnonzero(np.diff(types)) + 1).tolist(), len(types)]
    return [(a, b, int(types[a])) for a, b in pairwise(edges)]


def phase_types(clips: Iterable[tuple[Tensor, np.ndarray]], layout: str) -> dict[int, float]:
    """Type ids that turn over in most of their stretches, with the mean length of a stretch in frames.

    Args:
        clips: features (T, 276) and type ids (T,) of every clip.
    """
    turned: dict[int, list[bool]] = defaultdict(list)
    lengths: dict[int, list[int]] = defaultdict(list)
    for features, types in clips:
        for start, end, kind in type_stretches(types):
            turned[kind].append(turns_over(features[start:end], layout))
            lengths[kind].append(end - start)
    return {
        kind: float(np.mean(lengths[kind])) for kind, flags in turned.items() if 2 * sum(flags) > len(flags)
    }


def phase_track(types: np.ndarray, with_phase: Iterable[int]) -> np.ndarray:
    """Progress (T,) in [0, 1) through each stretch of the given types, NO_PHASE elsewhere."""
    out = np.full(len(types), NO_PHASE, np.float32)
    wanted = set(with_phase)
    for start, end, kind in type_stretches(types):
        if kind in wanted:
            out[start:end] = np.arange(end - start, dtype=np.float32) / (end - start)
    return out
