"""Frames no cleaning can mend: a joint leaps and the motion goes on elsewhere. Clips are cut there."""

from __future__ import annotations

import torch
from torch import Tensor

# A joint that covers more than this in a 60 fps frame, against the root, and far more than in the frames
# around, has leapt: the fastest real feet of the CMU flips move 16 to 23 cm a frame.
LEAP_DISTANCE = 25.0  # cm
LEAP_RATIO = 2.2
# cm a frame for the whole body: nothing moves at 600 m/s, and it would rule the scaling.
ROOT_LEAP = 1000.0
_REACH = 4  # frames compared on each side, the two nearest left out


def find_leaps(global_positions: Tensor) -> list[int]:
    """Frames t such that some joint leaps against the root, or the root itself, between t - 1 and t.

    Args:
        global_positions: (T, 23, 3) in cm at 60 fps.
    """
    relative = global_positions - global_positions[:, :1]
    steps = torch.diff(relative, dim=0).norm(dim=-1)  # step t leads from frame t to t + 1
    if len(steps) < 2 * _REACH + 1:
        return []
    padded = torch.cat([steps[:1].expand(_REACH, -1), steps, steps[-1:].expand(_REACH, -1)])
    windows = padded.unfold(0, 2 * _REACH + 1, 1)
    around = torch.cat([windows[..., : _REACH - 1], windows[..., _REACH + 2 :]], dim=-1).median(dim=-1).values
    leaps = (steps > LEAP_DISTANCE) & (steps > LEAP_RATIO * around)
    lost = torch.diff(global_positions[:, 0], dim=0).norm(dim=-1) > ROOT_LEAP
    return (torch.nonzero(leaps.any(dim=-1) | lost).flatten() + 1).tolist()


def cut_at_leaps(start: int, end: int, leaps: list[int]) -> list[tuple[int, int]]:
    """The stretches of start to end (exclusive) that hold no leap; the frame on each side goes too."""
    out = []
    for leap in sorted(leaps):
        if start <= leap <= end:
            out.append((start, min(end, leap - 1)))
            start = leap + 1
    out.append((start, end))
    return [(a, b) for a, b in out if b - a >= 2]
