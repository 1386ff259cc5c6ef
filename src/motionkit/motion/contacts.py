"""Foot contact labels from the speed and height of the foot joints."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from motionkit.arrays import Array
from motionkit.motion.skeleton import FOOT_JOINTS

# A joint below both limits is in contact. Heights in cm above the floor, for left foot, left toe, right foot, right
# toe; STANDING_HEIGHTS are 10.5 and 4.1.
CONTACT_HEIGHTS = (14.0, 6.0, 14.0, 6.0)
CONTACT_SPEED = 40.0  # cm per second
_FILTER = 2  # frames at 60 fps to both sides in the majority vote, which removes single-frame flicker


def foot_contacts(global_positions: Array, fps: float) -> Array:
    """Contact labels (T, 4), float32 0 or 1, of left foot, left toe, right foot, right toe.

    global_positions (T, 23, 3) are those of the canonical joints in cm, the floor at height zero.
    """
    feet = global_positions[:, list(FOOT_JOINTS)]
    if len(feet) < 2:
        return (feet[..., 1] < np.array(CONTACT_HEIGHTS)).astype(np.float32)
    touching = (joint_speeds(feet, fps) < CONTACT_SPEED) & (feet[..., 1] < np.array(CONTACT_HEIGHTS))
    return _majority(touching.astype(np.float32), max(1, round(_FILTER * fps / 60.0)))


def joint_speeds(places: Array, fps: float) -> Array:
    """Speeds (T, ...) in cm/s of places (T >= 2, ..., 3): the mean of the speeds before and after each frame.

    A trembling place counts as fast here, but not with central differences (floor.speeds).
    """
    steps = np.linalg.norm(np.diff(places, axis=0), axis=-1) * fps
    return 0.5 * (np.concatenate([steps[:1], steps]) + np.concatenate([steps, steps[-1:]]))


def _majority(labels: Array, half: int) -> Array:
    """Majority vote for labels (T, 4) over `half` frames before and after each."""
    padded = np.pad(labels, ((half, half), (0, 0)), mode="edge")
    return (sliding_window_view(padded, 2 * half + 1, axis=0).mean(-1) > 0.5).astype(labels.dtype)
