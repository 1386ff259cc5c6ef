"""The floor of a clip, and what feet do against it: skating and sinking.

Feet are always (T, 4, 3): left foot, left toe, right foot, right toe, in cm with Y up.
"""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.metrics.value import FRAME_RATE, MetricSettings, MetricValue
from motionkit.motion.skeleton import FOOT_JOINTS

TOES = (1, 3)  # of the four foot joints
STANCE_SPEED = 30.0  # cm/s below which the lowest foot joint counts as standing
STANCE_QUANTILE = 0.25  # of the standing heights: low, yet a body that sinks now and then cannot move it
STANCE_FRAMES = 10  # with fewer standing frames, all frames are taken
SINK_MARGIN = 0.5  # cm below the floor that measuring noise alone reaches


def foot_positions(global_positions: Array) -> Array:
    """The four foot joints (T, 4, 3) of canonical joints (T, 23, 3)."""
    return global_positions[:, list(FOOT_JOINTS)]


def floor_height(feet: Array, fps: float = FRAME_RATE) -> float:
    """Height in cm of the clip's own floor: the lower quartile of the lowest foot joint while it stands still.

    The level is that of the joints at rest, not of the soles under them.

    Args:
        feet: (T, 4, 3) foot joints in cm.
        fps: frames per second.

    Raises MotionkitError if there are no frames.
    """
    if len(feet) == 0:
        raise MotionkitError("a floor cannot be found in a motion without frames")
    feet = feet.astype(np.float64)
    foot = feet[..., 1].argmin(axis=1)
    lowest = feet[np.arange(len(feet)), foot, 1]
    if len(feet) < 2:
        return float(lowest[0])
    moves = np.linalg.norm(np.diff(feet, axis=0), axis=-1) * fps
    speed = 0.5 * (np.concatenate([moves[:1], moves]) + np.concatenate([moves, moves[-1:]]))
    still = speed[np.arange(len(feet)), foot] < STANCE_SPEED
    heights = lowest[still] if int(still.sum()) >= STANCE_FRAMES else lowest
    return float(np.sort(heights)[int(STANCE_QUANTILE * (len(heights) - 1))])


def ground_speed(feet: Array) -> Array:
    """Distance (T - 1, 4) in cm that each foot joint moves along the ground from frame to frame."""
    return np.linalg.norm(np.diff(feet.astype(np.float64)[..., [0, 2]], axis=0), axis=-1)


def foot_skate_ratio(feet: Array, floor: float, settings: MetricSettings | None = None) -> MetricValue:
    """The share of standing toe samples that move along the ground faster than a threshold.

    Each toe in each frame is a sample; it stands where its height above the floor is under a threshold
    in this frame and the one before. The paper has no such metric; feet off the ground do not dilute it.

    Args:
        feet: (T, 4, 3) foot joints in cm, at 60 fps.
        floor: height of the floor in cm.
        settings: thresholds skate_height and skate_speed.

    Raises MotionkitError for fewer than two frames, or where no toe ever stands.
    """
    settings = settings or MetricSettings()
    if len(feet) < 2:
        raise MotionkitError(f"foot skate needs at least 2 frames, found {len(feet)}")
    toes = feet.astype(np.float64)[:, list(TOES)]
    low = toes[..., 1] - floor < settings.skate_height
    standing = low[1:] & low[:-1]
    if not bool(standing.any()):
        raise MotionkitError(f"no toe comes within {settings.skate_height:g} cm of the floor in two frames")
    skating = standing & (ground_speed(toes) * FRAME_RATE > settings.skate_speed)
    parameters: dict[str, float | str] = {
        "height_cm": settings.skate_height,
        "speed_cm_s": settings.skate_speed,
        "floor_cm": floor,
    }
    return MetricValue("skate-ratio", float(skating.sum() / standing.sum()), "", parameters)


def penetration(feet: Array, floor: float) -> tuple[MetricValue, MetricValue]:
    """How far the lowest foot joint sinks below the floor: mean over all frames, and largest, in cm.

    Args:
        feet: (T, 4, 3) foot joints in cm.
        floor: height of the floor in cm.

    Raises MotionkitError if there are no frames.
    """
    if len(feet) == 0:
        raise MotionkitError("penetration needs at least 1 frame, found 0")
    depth = np.maximum((floor - feet.astype(np.float64)[..., 1]).max(axis=1), 0.0)
    parameters: dict[str, float | str] = {"floor_cm": floor}
    return (
        MetricValue("penetration-mean", float(depth.mean()), "cm", parameters),
        MetricValue("penetration-max", float(depth.max()), "cm", parameters),
    )
