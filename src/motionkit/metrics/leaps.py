"""Discontinuities: leaps, which are single frames in which a joint jumps, and the fastest turn of any joint."""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Array, length
from motionkit.errors import MotionkitError
from motionkit.metrics.body_movement import geodesic_movement
from motionkit.metrics.value import FRAME_RATE, MetricValue, need
from motionkit.motion.skeleton import JOINT_NAMES

KNEES = tuple(JOINT_NAMES.index(name) for name in ("LeftLeg", "RightLeg"))
ELBOWS = tuple(JOINT_NAMES.index(name) for name in ("LeftForeArm", "RightForeArm"))
# Change in cm between two successive steps that makes a leap. 25 minutes of recordings have none; a knee that flips to
# the other side moves 10 to 30 cm.
LEAP = 6.0
LEAST_RATE = 0.95 * FRAME_RATE
SAME_LEAP = 3  # frames within which later jumps belong to the same leap


def leap_frames(positions: Array) -> Array:
    """Frames (N,) right after a leap, a step that differs by more than LEAP from the steps before and after it.

    Steps of one joint's positions (T, 3), in cm at 60 fps, are compared as vectors, so a joint that jumps away and back
    within a frame leaps too. A joint that goes on jumping leaps again after SAME_LEAP frames.
    """
    steps = np.diff(positions.astype(np.float64), axis=0)
    changes = length(np.diff(steps, axis=0))
    found = np.flatnonzero(np.minimum(changes[:-1], changes[1:]) > LEAP) + 2
    kept: list[int] = []
    for frame in found.tolist():
        if not kept or frame > kept[-1] + SAME_LEAP:
            kept.append(frame)
    return np.array(kept, np.int64)


def leaps(positions: Array, recorded_fps: float = FRAME_RATE) -> MetricValue:
    """Leaps per minute of knees and elbows in positions (T, 23, 3) in cm at 60 fps, summed over the four joints.

    recorded_fps is the rate before resampling to 60 fps, which divides the leaps of a lower rate into small steps.

    Raises:
        MotionkitError: there are fewer than four frames, or the recorded rate is below LEAST_RATE.
    """
    need(len(positions), 4, "leaps need")
    if recorded_fps < LEAST_RATE:
        raise MotionkitError(f"leaps are single frames at 60 fps, which a file at {recorded_fps:g} fps lacks")
    count = sum(len(leap_frames(positions[:, joint])) for joint in (*KNEES, *ELBOWS))
    return MetricValue("leaps", count * 60.0 * FRAME_RATE / len(positions), "1/min", {"leap_cm": LEAP})


def fastest_turn(local_rotations: Array, fps: float = FRAME_RATE, start: int = 0) -> MetricValue:
    """Largest angular speed in degrees per second of any joint between two frames of rotations (T, 23, 4).

    Its parameters name the joint and the second of the two frames; start is the number of the first frame.

    Raises:
        MotionkitError: there are fewer than two frames.
    """
    need(len(local_rotations), 2, "angular speed needs")
    speeds = geodesic_movement(local_rotations) * fps
    frame, joint = np.unravel_index(int(speeds.argmax()), speeds.shape)
    parameters: dict[str, float | str] = {"joint": JOINT_NAMES[int(joint)], "frame": float(start + frame + 1)}
    return MetricValue("turn-max", float(speeds.max()), "deg/s", parameters)
