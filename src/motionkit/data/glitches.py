"""Finds leaps: a joint jumps and does not return. Cleaning cannot repair them, so clips are cut there."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from motionkit.arrays import Array, lower_median

# A joint leaps if its step relative to the root at 60 fps exceeds LEAP_DISTANCE (cm), and LEAP_RATIO times the median
# of the steps around it. The fastest feet in CMU flips move 16 to 23 cm per frame.
LEAP_DISTANCE = 25.0
LEAP_RATIO = 2.2
# cm per frame of the root (600 m/s); a larger step would dominate the scaling of the features.
ROOT_LEAP = 1000.0
_REACH = 4  # steps on each side of a step; the nearest one is left out of the comparison


def find_leaps(global_positions: Array) -> list[int]:
    """Frames t that follow a leap: between t - 1 and t the root jumps, or a joint relative to the root.

    Args:
        global_positions: (T, 23, 3) in cm at 60 fps.
    """
    relative = global_positions - global_positions[:, :1]
    steps = np.linalg.norm(np.diff(relative, axis=0), axis=-1)  # step t leads from frame t to t + 1
    if len(steps) < 2 * _REACH + 1:
        return []
    padded = np.pad(steps, ((_REACH, _REACH), (0, 0)), mode="edge")
    windows = sliding_window_view(padded, 2 * _REACH + 1, axis=0)
    around = lower_median(np.concatenate([windows[..., : _REACH - 1], windows[..., _REACH + 2 :]], -1), -1)
    leaps = (steps > LEAP_DISTANCE) & (steps > LEAP_RATIO * around)
    lost = np.linalg.norm(np.diff(global_positions[:, 0], axis=0), axis=-1) > ROOT_LEAP
    return (np.flatnonzero(leaps.any(axis=-1) | lost) + 1).tolist()


def cut_at_leaps(start: int, end: int, leaps: list[int]) -> list[tuple[int, int]]:
    """The stretches between leaps of frames start to end (exclusive), without the frames next to a leap."""
    out = []
    for leap in sorted(leaps):
        if start <= leap <= end:
            out.append((start, min(end, leap - 1)))
            start = leap + 1
    out.append((start, end))
    return [(a, b) for a, b in out if b - a >= 2]
