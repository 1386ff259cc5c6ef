"""Finds the floor of a clip from its standing feet: their height, or the shift that brings them to the floor."""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Array, lower_median
from motionkit.errors import MotionkitError
from motionkit.motion.contacts import joint_speeds
from motionkit.motion.kinematics import forward_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import FOOT_JOINTS, JOINT_NAMES, STANDING_HEIGHTS

# Height in cm of the toe joint (ball of the foot) of a standing foot: the median over the CMU subjects with a level
# floor.
TOE_HEIGHT = STANDING_HEIGHTS[1]
TOES = (JOINT_NAMES.index("LeftToeBase"), JOINT_NAMES.index("RightToeBase"))

# Settings of floor_height; published metrics depend on them.
STILL_SPEED = 30.0  # cm/s; the lowest foot joint stands below this speed
STANCE_QUANTILE = 0.25  # of the standing heights: low, but robust to a body that sinks now and then
STANCE_FRAMES = 3  # least standing frames; with fewer, as in a short run, the lowest frames count
LOWEST_QUANTILE = 0.05  # of all heights, if no foot stands

# Settings of floor_shift.
STANCE_SPEED = 20.0  # cm/s; slower toes stand
STANCE_BAND = 6.0  # cm; height of a band of standing toes
STANCE_SHARE = 0.75  # share of the fullest band's toes that the lowest band must have
STEP_DOWN = 8.0  # cm; toes this far below the band may stand on the floor beside a platform
STEP_SHARE = 0.1  # share of all standing toes that must be there


def foot_positions(global_positions: Array) -> Array:
    """The four foot joints (T, 4, 3) of canonical joint positions (T, 23, 3)."""
    return global_positions[:, list(FOOT_JOINTS)]


def floor_height(feet: Array, fps: float = 60.0) -> float:
    """Floor height of a clip in cm: the lower quartile of the lowest foot joint's height while it stands.

    This is the height of the joints (T, 4, 3), in cm, not of the soles below them. Raises MotionkitError without
    frames.
    """
    if len(feet) == 0:
        raise MotionkitError("floor height needs at least 1 frame, found 0")
    feet = feet.astype(np.float64)
    foot = feet[..., 1].argmin(axis=1)
    lowest = feet[np.arange(len(feet)), foot, 1]
    if len(feet) < 2:
        return float(lowest[0])
    still = joint_speeds(feet, fps)[np.arange(len(feet)), foot] < STILL_SPEED
    enough_still = int(still.sum()) >= STANCE_FRAMES
    heights, quantile = (lowest[still], STANCE_QUANTILE) if enough_still else (lowest, LOWEST_QUANTILE)
    return float(np.sort(heights)[int(quantile * (len(heights) - 1))])


def floor_shift(motion: Motion) -> tuple[float, tuple[str, ...]]:
    """The shift of the root height in cm that brings standing toes to TOE_HEIGHT, and notes."""
    legs = max(TOES) + 1  # hips and legs come first
    skeleton = motion.skeleton
    _, positions = forward_kinematics(
        motion.local_rotations[:, :legs],
        motion.root_positions,
        skeleton.offsets[:legs],
        skeleton.parents[:legs],
    )
    toes = positions[:, list(TOES)]
    heights = toes[..., 1]
    slow = heights[standing_toes(toes, motion.fps)]
    if len(slow) < 5:
        lowest = float(np.quantile(heights, 0.02))
        return TOE_HEIGHT - lowest, ("no stance found; floor set from the lowest toe",)
    return TOE_HEIGHT - _lowest_band(slow), ()


def standing_toes(toes: Array, fps: float) -> Array:
    """Whether toes (T, ..., 3), in cm, stand still (T, ...)."""
    still: Array = speeds(toes, fps) < STANCE_SPEED
    return still


def speeds(places: Array, fps: float) -> Array:
    """Speeds (T, ...) in cm/s of places (T, ..., 3), by central differences, one-sided at the ends."""
    if len(places) < 2:
        return np.zeros(places.shape[:-1], places.dtype)
    steps = (places[1:] - places[:-1]) * fps
    both = 0.5 * (steps[1:] + steps[:-1])
    return np.linalg.norm(np.concatenate([steps[:1], both, steps[-1:]]), axis=-1)


def _lowest_band(heights: Array) -> float:
    """Median of heights (N,) in the lowest band that is nearly as full as the fullest one.

    This ignores feet held still in the air (a raised leg, a handstand) and stray low frames. If many heights are a
    whole step lower, the band is a platform, and the lower heights are the floor.
    """
    ordered = np.sort(heights)
    counts = np.searchsorted(ordered, ordered + STANCE_BAND, side="right") - np.arange(len(ordered))
    first = int(np.flatnonzero(counts >= STANCE_SHARE * counts.max())[0])
    below = ordered[ordered < ordered[first] - STEP_DOWN]
    if len(below) >= max(5, STEP_SHARE * len(heights)):
        return _lowest_band(below)
    return float(lower_median(ordered[first : first + int(counts[first])]))
