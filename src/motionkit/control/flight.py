"""Whole motions in the air: flights fall freely, and bodies that glide a little above the ground come down to it.

A network that answers with the mean of what may come falls too slowly in some jumps, and too fast in others, and
between two steps or two hands it may hold a body up by nothing. Take-off and landing stay where they are; live
characters do not know when they will land, and move as the network has it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motionkit.arrays import Array, smoothstep, spans
from motionkit.metrics.flight import FIT_FRAMES, FREE_FALL, centre_of_mass, flights, vertical_acceleration
from motionkit.metrics.touch import FALLING, TOUCH_HEIGHTS, touching
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion

# m/s^2; what is further from free fall is no flight but a body on its hands, or one that glides. What is nearer than
# the first stays as it is: short flights of runs would not get nearer.
CLOSE, NEAR = 0.75, 4.5
EASE = 5  # frames over which a correction comes and goes, since a corner in the way jerks
GLIDES = 6.0  # cm; a body that comes higher above the ground than this, or falls most of the time, flies
SMOOTH = 2  # frames to both sides over which what it comes down is averaged
STANDS = 2.0  # cm below TOUCH_HEIGHTS, where standing feet are


def falling_freely(motion: Motion) -> Motion:
    """Return a motion at 60 fps, the ground at height zero, whose flights of at least 0.2 s fall freely."""
    positions = motion_kinematics(motion)[1]
    if len(positions) < 3:
        return motion
    heights = centre_of_mass(positions)[:, 1]
    roots = motion.root_positions.copy()
    for flight in flights(positions, ~touching(positions)):
        before, after = flight.start - 1, flight.end
        if before < 0 or after >= len(positions) or not CLOSE < abs(flight.error) <= NEAR:
            continue
        frames = np.arange(before, after + 1)
        since, left = frames - before, after - frames
        straight = np.interp(frames, [before, after], heights[[before, after]])
        wanted = straight - 0.5 * 100.0 * FREE_FALL * since * left / motion.fps**2
        ease = smoothstep(np.minimum(np.minimum(since, left) / EASE, 1.0))
        roots[frames, 1] += (ease * (wanted - heights[frames])).astype(roots.dtype)
    return replace(motion, root_positions=roots)


def come_down(motion: Motion) -> Motion:
    """Return a motion at 60 fps, the ground at height zero, whose body no longer glides a little above the ground.

    Where nothing touches it, though the body is never higher than GLIDES and mostly does not fall, its lowest joint
    goes on between its heights before and after. In a motion too short to tell how it falls nothing is changed.
    """
    positions = motion_kinematics(motion)[1]
    if len(positions) < FIT_FRAMES:
        return motion
    above = (positions[..., 1] - TOUCH_HEIGHTS).min(axis=-1)
    held_up = vertical_acceleration(centre_of_mass(positions)[:, 1]) > FALLING
    drop = np.zeros(len(positions))
    for start, end in spans(above >= 0.0):
        if above[start:end].max() < GLIDES and held_up[start:end].mean() > 0.5:
            first, last = max(start - EASE, 0), min(end + EASE, len(positions)) - 1
            drop[first : last + 1] = np.maximum(drop[first : last + 1], _excess(above, first, last))
    if not drop.any():
        return motion
    drop = np.convolve(
        np.pad(drop, SMOOTH, mode="edge"), np.full(2 * SMOOTH + 1, 1.0 / (2 * SMOOTH + 1)), "valid"
    )
    roots = motion.root_positions.copy()
    roots[:, 1] -= drop.astype(roots.dtype)
    return replace(motion, root_positions=roots)


def _excess(above: Array, first: int, last: int) -> Array:
    """How much heights (T,) are above the line between two frames, eased at both ends, for these frames."""
    frames = np.arange(first, last + 1)
    line = np.clip(np.interp(frames, [first, last], above[[first, last]]), -STANDS, 0.0)
    to_end = np.minimum(frames - first, last - frames) + 1
    return smoothstep(np.minimum(to_end / EASE, 1.0)) * np.maximum(above[first : last + 1] - line, 0.0)
