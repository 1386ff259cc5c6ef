"""Whole motions brake, push off and turn their joints no harder than recorded bodies do.

Where a flip follows a run, or one recording another, a network may do so. The way of the root is then eased by a
centimetre or two, before feet are held. A foot whose markers were lost in a flip spins as it did in the recording; its
turn is spread over more frames. Live characters do not know what comes, and move as the network has it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from motionkit.arrays import Array, length, smoothed, smoothstep
from motionkit.metrics.pace import PACE_SECONDS, ground_acceleration
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    expmap_to_quat,
    quat_angle,
    quat_inverse,
    quat_multiply,
    quat_normalize,
    quat_to_expmap,
)

# Of the recorded frames of a motion's types are below its limit; the others are outliers, and peaks that held feet add.
RECORDED_SHARE = 0.997
USUAL = 3.5  # m/s^2; any body accelerates so hard where it begins to do something else
# The way is eased step by step: by a share of what is too much, averaged over so many frames to both sides.
RATE, ROUNDS, SMOOTH = 0.1, 200, 4
# Degrees/s. In 99.9 % of the recorded frames of CMU no joint is faster than 1,715; feet turn a little more to be held.
TURN = 1650.0
TURN_RATE = 0.2
CLOSE = 1e-3  # share of a limit that may be left over


def acceleration_limit(model: MotionModel, kinds: Iterable[str]) -> float | None:
    """Acceleration over the ground in m/s^2 that recordings of some types keep below; None without recordings."""
    shortest = 2 * round(PACE_SECONDS * model.fps)
    clips = [clip for kind in dict.fromkeys(kinds) for clip in model.types[kind].reference_clips]
    found = [
        ground_acceleration(np.insert(clip.ground[:, :2], 1, 0.0, axis=1), model.fps)
        for clip in clips
        if len(clip) > shortest
    ]
    return max(float(np.quantile(np.concatenate(found), RECORDED_SHARE)), USUAL) if found else None


def eased_way(motion: Motion, most: float | None) -> Motion:
    """Return a motion whose root accelerates over the ground by at most some m/s^2, between velocities over 0.2 s.

    Each frame in which it is too fast moves towards the middle of the frames before and after, and these the other
    way, so that the way as a whole stays where it is.
    """
    span = max(1, round(PACE_SECONDS * motion.fps))
    if most is None or len(motion) <= 2 * span:
        return motion
    # For 1 m/s^2: twice as many cm as a frame is from the middle of those before and after.
    unit = 100.0 * (span / motion.fps) ** 2
    begun = _going_on(motion.root_positions[:, ::2].astype(np.float64), span)
    way = begun.copy()
    for _ in range(ROUNDS):
        bend = way[2 * span :] - 2.0 * way[span:-span] + way[: -2 * span]
        size = length(bend)
        excess = bend * (np.maximum(size - most * unit, 0.0) / np.maximum(size, 1e-9))[:, None]
        if length(excess).max() < CLOSE * most * unit:
            break
        push = RATE * smoothed(excess, SMOOTH)
        way[span:-span] += 2.0 * push
        way[2 * span :] -= push
        way[: -2 * span] -= push
    shift = (way - begun)[2 * span : -2 * span]
    if not shift.any():
        return motion
    # Motion goes on from where it begins: from a clip, or a path.
    shift -= shift[0] * (1.0 - smoothstep(np.minimum(np.arange(len(shift)) / (2 * span), 1.0)))[:, None]
    roots = motion.root_positions.copy()
    roots[:, ::2] += shift.astype(roots.dtype)
    return replace(motion, root_positions=roots)


def eased_turns(motion: Motion) -> Motion:
    """Return a motion none of whose joints turns faster than TURN: too fast a turn is spread over frames around it."""
    most = float(np.deg2rad(TURN)) / motion.fps
    turns = motion.local_rotations.astype(np.float64)
    fast = (quat_angle(turns[:-1], turns[1:]) > most).any(axis=0)
    if not fast.any():
        return motion
    some = turns[:, fast]
    for _ in range(ROUNDS):
        steps = quat_to_expmap(quat_multiply(quat_inverse(some[:-1]), some[1:]))
        size = length(steps)[..., None]
        push = TURN_RATE * steps * np.maximum(1.0 - most / np.maximum(size, 1e-9), 0.0)
        if length(push).max() < TURN_RATE * CLOSE * most:
            break
        ahead, back = np.pad(push, ((0, 1), (0, 0), (0, 0))), np.pad(push, ((1, 0), (0, 0), (0, 0)))
        ahead[0] = 0.0  # motion goes on from where it begins
        some = quat_normalize(quat_multiply(some, expmap_to_quat(ahead - back)))
    rotations = motion.local_rotations.copy()
    rotations[:, fast] = some.astype(rotations.dtype)
    return replace(motion, local_rotations=rotations)


def _going_on(way: Array, span: int) -> Array:
    """A way (T, 2) that comes and goes on at the velocity of its ends, for twice `span` frames each."""
    frames = np.arange(1, 2 * span + 1)[:, None]
    before, after = (way[1] - way[0]) * frames[::-1], (way[-1] - way[-2]) * frames
    return np.concatenate([way[0] - before, way, way[-1] + after])
