"""Corrects the root height of whole motions: no joint below the ground, free fall in flights, no floating.

A network predicts the mean of what may come. So some jumps float and others drop, and a body may float above the ground
between two steps or two hands. Take-off and landing stay where they are. Live characters do not know the frames ahead;
they have only the root-height correction (inference/height_correction.py).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from motionkit.arrays import Array, peak_smoothed, smoothed, smoothstep, spans
from motionkit.metrics.flight import FIT_FRAMES, FREE_FALL, centre_of_mass, flights, vertical_acceleration
from motionkit.metrics.touch import FALLING, TOUCH_HEIGHTS, touching
from motionkit.motion.frame_rate import frames_at
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import FOOT_JOINTS, JOINT_COUNT

TAKE_OFF_FRAMES = 3  # frames over which the speed of a take-off is measured; chosen
# Joints that lift the whole body where they would go below the ground. Foot locking moves the feet.
ABOVE = np.delete(np.arange(JOINT_COUNT), FOOT_JOINTS)


@dataclass(frozen=True)
class HeightSettings:
    """Settings of the root height; frames at 60 fps, chosen on validation.

    Attributes:
        rise_frames: frames by which the body rises before a hand would go below the ground.
        flight_error: (least, most) error of the fall in m/s^2 that is corrected. Short flights of runs have less; a
            body on its hands or a floating one has more.
        take_off: cm/s by which a fall may begin faster upwards than the body does; a slower body has not taken off yet.
        ease_frames: frames over which a correction comes and goes.
        floating_height: cm above the ground up to which a body floats; a higher one flies.
        standing_depth: cm by which standing feet are below the touch heights.
        smooth_frames: frames to both sides over which the descent of a floating body is averaged.
    """

    rise_frames: int = 10
    flight_error: tuple[float, float] = (0.75, 4.5)
    take_off: float = 250.0
    ease_frames: int = 5
    floating_height: float = 6.0
    standing_depth: float = 2.0
    smooth_frames: int = 2


HEIGHT = HeightSettings()


def above_ground(motion: Motion) -> Motion:
    """Raise the body smoothly so that hands, head and trunk stay above the ground.

    Args:
        motion: T frames on the canonical joints, in cm, the ground at height zero.
    """
    positions = motion_kinematics(motion)[1]
    missing = np.maximum(-positions[:, ABOVE, 1].min(axis=1), 0.0)
    frames = frames_at(HEIGHT.rise_frames, motion.fps)
    return _raised(motion, peak_smoothed(missing, missing[:, None], frames)[:, 0])


def in_the_air(motion: Motion, size: float = 1.0) -> Motion:
    """Make flights of at least 0.2 s fall freely, and bring a floating body down to the ground.

    A motion of fewer than FIT_FRAMES frames stays as it is.

    Args:
        motion: T frames on the canonical joints at 60 fps, in cm, the ground at height zero. Feet are locked already,
            because the legs decide where a flight begins and ends.
        size: scale of the shown body relative to this one. Measured in its own lengths, a small body falls faster.
    """
    if len(motion) < FIT_FRAMES:
        return motion
    positions = motion_kinematics(motion)[1]
    drop = _floating(positions)
    positions[..., 1] -= drop[:, None]
    return _raised(motion, _free_fall(positions, motion.fps, size) - drop)


def _raised(motion: Motion, lift: Array) -> Motion:
    if not lift.any():
        return motion
    roots = motion.root_positions.copy()
    roots[:, 1] += lift.astype(roots.dtype)
    return replace(motion, root_positions=roots)


def _floating(positions: Array) -> Array:
    """Descent (T,) in cm of a body that floats a little above the ground without falling.

    The height of its lowest joint is interpolated between the frames before and after.
    """
    above = (positions[..., 1] - TOUCH_HEIGHTS).min(axis=-1)
    supported = vertical_acceleration(centre_of_mass(positions)[:, 1]) > FALLING
    drop = np.zeros(len(positions))
    for start, end in spans(above >= 0.0):
        if above[start:end].max() < HEIGHT.floating_height and supported[start:end].mean() > 0.5:
            first = max(start - HEIGHT.ease_frames, 0)
            last = min(end + HEIGHT.ease_frames, len(positions)) - 1
            drop[first : last + 1] = np.maximum(drop[first : last + 1], _excess(above, first, last))
    return smoothed(drop[:, None], HEIGHT.smooth_frames)[:, 0]


def _excess(above: Array, first: int, last: int) -> Array:
    """Heights above the line between two frames, for the frames from first to last; eased at both ends."""
    frames = np.arange(first, last + 1)
    line = np.clip(np.interp(frames, [first, last], above[[first, last]]), -HEIGHT.standing_depth, 0.0)
    to_end = np.minimum(frames - first, last - frames) + 1
    return smoothstep(np.minimum(to_end / HEIGHT.ease_frames, 1.0)) * np.maximum(
        above[first : last + 1] - line, 0.0
    )


def _free_fall(positions: Array, fps: float, size: float) -> Array:
    """Rise (T,) of the root in cm that makes the centre of mass fall freely in flights of at least 0.2 s."""
    scaled = positions * size
    heights = centre_of_mass(scaled)[:, 1]
    lift = np.zeros(len(positions))
    least, most = HEIGHT.flight_error
    for flight in flights(scaled, ~touching(positions)):
        before, after = flight.start - 1, flight.end
        if before < 0 or after >= len(positions) or not least < abs(flight.error) <= most:
            continue
        fall = 0.5 * 100.0 * FREE_FALL * (after - before) / fps
        climb = (heights[after] - heights[before]) * fps / (after - before) - fall
        first = max(before - TAKE_OFF_FRAMES, 0)
        climbs = (heights[before] - heights[first]) * fps / max(before - first, 1)
        if before > first and climb - climbs > HEIGHT.take_off:
            continue
        frames = np.arange(before, after + 1)
        since, left = frames - before, after - frames
        straight = np.interp(frames, [before, after], heights[[before, after]])
        target = straight - 0.5 * 100.0 * FREE_FALL * since * left / fps**2
        ease = smoothstep(np.minimum(np.minimum(since, left) / HEIGHT.ease_frames, 1.0))
        lift[frames] += ease * (target - heights[frames]) / size
    return lift
