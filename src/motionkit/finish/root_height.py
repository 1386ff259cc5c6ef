"""The height of the root in whole motions: no joint in the ground, free fall in flights, nothing that glides.

A network that answers with the mean of what may
come falls too slowly in some jumps and too fast in others, and between two steps or two hands it may hold a body up by
nothing. Take-off and landing stay where they are. Live characters do not know what comes: the root-height correction of
inference is all they have.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from motionkit.arrays import Array, peak_smoothed, smoothed, smoothstep, spans
from motionkit.metrics.flight import FIT_FRAMES, FREE_FALL, centre_of_mass, flights, vertical_acceleration
from motionkit.metrics.touch import FALLING, TOUCH_HEIGHTS, touching
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import FOOT_JOINTS, JOINT_COUNT

# Joints that the ground keeps up by lifting the whole body; feet are moved by themselves.
ABOVE = np.delete(np.arange(JOINT_COUNT), FOOT_JOINTS)


@dataclass(frozen=True)
class HeightSettings:
    """How the root's height is corrected; frames at 60 fps, chosen on validation.

    Attributes:
        rise_frames: the body is lifted so many frames before a hand would go through the ground.
        flight_error: (least, most) difference to free fall in m/s^2 that is corrected. Short flights of runs are
            nearer; what is further off is a body on its hands, or one that glides.
        ease_frames: frames over which a change comes and goes.
        glide_height: cm; a body that comes higher than this above the ground flies.
        stands: cm below the heights at which joints may touch, where standing feet are.
        smooth_frames: frames to both sides over which the way down is averaged.
    """

    rise_frames: int = 10
    flight_error: tuple[float, float] = (0.75, 4.5)
    ease_frames: int = 5
    glide_height: float = 6.0
    stands: float = 2.0
    smooth_frames: int = 2


HEIGHT = HeightSettings()


def above_ground(motion: Motion) -> Motion:
    """A motion whose body rises, smoothly, so that hands, head and trunk stay above the ground.

    Args:
        motion: T frames on the canonical joints, in cm, the ground at height zero.
    """
    positions = motion_kinematics(motion)[1]
    missing = np.maximum(-positions[:, ABOVE, 1].min(axis=1), 0.0)
    frames = max(1, round(HEIGHT.rise_frames * motion.fps / 60.0))
    return _raised(motion, peak_smoothed(missing, missing[:, None], frames)[:, 0])


def in_the_air(motion: Motion, size: float = 1.0) -> Motion:
    """A motion whose flights of at least 0.2 s fall freely, and whose body does not glide above the ground.

    Args:
        motion: T frames on the canonical joints at 60 fps, in cm, the ground at height zero; feet are locked already,
            since legs decide where a flight begins and ends. One too short to tell how it falls stays as it is.
        size: of the body that is shown, against this one: a small body falls faster in its own lengths.
    """
    if len(motion) < FIT_FRAMES:
        return motion
    positions = motion_kinematics(motion)[1]
    drop = _glide(positions)
    positions[..., 1] -= drop[:, None]
    return _raised(motion, _free_fall(positions, motion.fps, size) - drop)


def _raised(motion: Motion, lift: Array) -> Motion:
    if not lift.any():
        return motion
    roots = motion.root_positions.copy()
    roots[:, 1] += lift.astype(roots.dtype)
    return replace(motion, root_positions=roots)


def _glide(positions: Array) -> Array:
    """How far (T,) a body comes down that glides a little above the ground without falling.

    Its lowest joint goes on between its heights before and after.
    """
    above = (positions[..., 1] - TOUCH_HEIGHTS).min(axis=-1)
    held_up = vertical_acceleration(centre_of_mass(positions)[:, 1]) > FALLING
    drop = np.zeros(len(positions))
    for start, end in spans(above >= 0.0):
        if above[start:end].max() < HEIGHT.glide_height and held_up[start:end].mean() > 0.5:
            first = max(start - HEIGHT.ease_frames, 0)
            last = min(end + HEIGHT.ease_frames, len(positions)) - 1
            drop[first : last + 1] = np.maximum(drop[first : last + 1], _excess(above, first, last))
    return smoothed(drop[:, None], HEIGHT.smooth_frames)[:, 0]


def _excess(above: Array, first: int, last: int) -> Array:
    """How much heights (T,) are above the line between two frames, eased at both ends, for these frames."""
    frames = np.arange(first, last + 1)
    line = np.clip(np.interp(frames, [first, last], above[[first, last]]), -HEIGHT.stands, 0.0)
    to_end = np.minimum(frames - first, last - frames) + 1
    return smoothstep(np.minimum(to_end / HEIGHT.ease_frames, 1.0)) * np.maximum(
        above[first : last + 1] - line, 0.0
    )


def _free_fall(positions: Array, fps: float, size: float) -> Array:
    """How far (T,) the root rises so that the centre of mass of flights of at least 0.2 s falls freely."""
    shown = positions * size
    heights = centre_of_mass(shown)[:, 1]
    lift = np.zeros(len(positions))
    least, most = HEIGHT.flight_error
    for flight in flights(shown, ~touching(positions)):
        before, after = flight.start - 1, flight.end
        if before < 0 or after >= len(positions) or not least < abs(flight.error) <= most:
            continue
        frames = np.arange(before, after + 1)
        since, left = frames - before, after - frames
        straight = np.interp(frames, [before, after], heights[[before, after]])
        wanted = straight - 0.5 * 100.0 * FREE_FALL * since * left / fps**2
        ease = smoothstep(np.minimum(np.minimum(since, left) / HEIGHT.ease_frames, 1.0))
        lift[frames] += ease * (wanted - heights[frames]) / size
    return lift
