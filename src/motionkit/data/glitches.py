"""Finds leaps that cleaning cannot repair: a joint jumps and the motion continues elsewhere. Clips are cut there."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from motionkit.arrays import Array, lower_median

# A joint leaps if it moves more than this per frame at 60 fps, relative to the root, and far more than in the frames
# around; the fastest real feet in CMU flips move 16 to 23 cm per frame.
LEAP_DISTANCE = 25.0  # cm
LEAP_RATIO = 2.2
# cm per frame for the whole body (600 m/s); larger steps would dominate the scaling.
ROOT_LEAP = 1000.0
_REACH = 4  # frames compared on each side, without the two nearest


def find_leaps(global_positions: Array) -> list[int]:
    """Frames t such that the root leaps between t - 1 and t, or some joint relative to the root.

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
    """The stretches of start to end (exclusive) between leaps, without the frame on each side of a leap."""
    out = []
    for leap in sorted(leaps):
        if start <= leap <= end:
            out.append((start, min(end, leap - 1)))
            start = leap + 1
    out.append((start, end))
    return [(a, b) for a, b in out if b - a >= 2]
