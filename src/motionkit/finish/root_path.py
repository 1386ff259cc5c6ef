"""Corrects the root's path over the ground in whole motions: less foot sliding, no harder acceleration than recorded.

Where a flip follows a run, or one recording another, a network may brake or push off harder than any body can. Live
characters do not know the frames ahead, so their acceleration is not corrected.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from motionkit.arrays import Array, length, smoothed, smoothstep
from motionkit.metrics.pace import PACE_SECONDS
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.leg_ik import root_slip
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import FOOT_JOINTS


@dataclass(frozen=True)
class RootPathSettings:
    """Settings of the root's path; chosen on validation.

    Attributes:
        hold_frames: frames to both sides over which the sliding of feet is averaged, because predicted feet tremble.
        rate: share of the excess acceleration that one round removes.
        rounds: most rounds.
        smooth_frames: frames to both sides over which the excess is averaged.
        close: excess at which the rounds end, as a share of the limit.
    """

    hold_frames: int = 6
    rate: float = 0.1
    rounds: int = 200
    smooth_frames: int = 4
    close: float = 1e-3


ROOT_PATH = RootPathSettings()


def corrected_path(motion: Motion, contacts: Array, share: Array | float, most: float | None) -> Motion:
    """Reduce foot sliding, then limit the root's acceleration over the ground.

    Args:
        motion: T frames on the canonical joints at 60 fps, in cm.
        contacts: (T, 4) labels or probabilities: left foot, left toe, right foot, right toe.
        share: (T,), or one for all frames, of foot sliding to remove. 0 keeps the path; with 1 the feet decide it.
        most: limit in m/s^2 between velocities over 0.2 s; None for no limit.
    """
    path = motion.root_positions[:, ::2].astype(np.float64)
    shift = _hold(motion, contacts, share)
    shift = shift + _eased(path + shift, most, motion.fps)
    if not shift.any():
        return motion
    roots = motion.root_positions.copy()
    roots[:, ::2] += shift.astype(roots.dtype)
    return replace(motion, root_positions=roots)


def _hold(motion: Motion, contacts: Array, share: Array | float) -> Array:
    """Shifts (T, 2) of the root in cm that remove the sliding of feet in contact, smoothed."""
    shift = np.zeros((len(motion), 2))
    shares = np.broadcast_to(np.asarray(share, np.float32), len(motion))[1:, None]
    if not shares.any():
        return shift
    feet = motion_kinematics(motion)[1][:, list(FOOT_JOINTS)]
    slip = shares * root_slip(feet[:-1], feet[1:], contacts[1:])
    shift[1:] = -np.cumsum(slip, axis=0, dtype=np.float64)
    return smoothed(shift, ROOT_PATH.hold_frames)


def _eased(track: Array, most: float | None, fps: float) -> Array:
    """Shifts (T, 2) in cm that bring the acceleration of a path (T, 2) below a limit in m/s^2.

    Each frame above the limit moves towards the midpoint of the frames before and after. Those move the other way, so
    the path as a whole stays in place.
    """
    span = max(1, round(PACE_SECONDS * fps))
    if most is None or len(track) <= 2 * span:
        return np.zeros_like(track)
    unit = 100.0 * (span / fps) ** 2  # second difference of the path in cm at 1 m/s^2
    first = _extended(track, span)
    path = first.copy()
    for _ in range(ROOT_PATH.rounds):
        bend = path[2 * span :] - 2.0 * path[span:-span] + path[: -2 * span]
        size = length(bend)
        excess = bend * (np.maximum(size - most * unit, 0.0) / np.maximum(size, 1e-9))[:, None]
        if length(excess).max() < ROOT_PATH.close * most * unit:
            break
        push = ROOT_PATH.rate * smoothed(excess, ROOT_PATH.smooth_frames)
        path[span:-span] += 2.0 * push
        path[2 * span :] -= push
        path[: -2 * span] -= push
    shift = (path - first)[2 * span : -2 * span]
    # The first frame stays in place: the motion continues a clip or a path.
    return shift - shift[0] * (1.0 - smoothstep(np.minimum(np.arange(len(shift)) / (2 * span), 1.0)))[:, None]


def _extended(path: Array, span: int) -> Array:
    """Extend a path (T, 2) at both ends by twice `span` frames, at the velocities of its ends."""
    frames = np.arange(1, 2 * span + 1)[:, None]
    before, after = (path[1] - path[0]) * frames[::-1], (path[-1] - path[-2]) * frames
    return np.concatenate([path[0] - before, path, path[-1] + after])
