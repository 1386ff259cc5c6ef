"""Standing: a body that stops finds its own stance, and the recordings of standing are moved to it.

If it saw a recorded stance while it still walks, it would drag its feet there instead of stepping.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from motionkit.arrays import Array
from motionkit.control.momentum import carried_over
from motionkit.features.control import Controls
from motionkit.models.motion_type import ReferenceClip

STOPPING_FRAMES = 100  # frames without a recording, until a body that ran, walked or danced stands
# Speed (cm/s) above which a trajectory brakes the body, and its deceleration (cm/s^2). Slower bodies stop by themselves
# in two steps.
BRAKED, BRAKING = 200.0, 200.0


def in_stance(clips: Sequence[ReferenceClip], stance: Array) -> tuple[ReferenceClip, ...]:
    """Move the mean poses of clips of standing to a stance (24,); returns no clips if the stance is unlike all of them.

    If a standing body saw one recorded stance after another, it would stand in their mean.
    """
    if not clips or not like_recorded(clips, stance):
        return ()
    return tuple(_moved(clip, stance) for clip in clips)


def about_zero(clips: Sequence[ReferenceClip]) -> tuple[ReferenceClip, ...]:
    """Move the mean poses of clips of standing to zero, for a stance that is not known yet."""
    return tuple(_moved(clip, np.float32(0.0)) for clip in clips)


def _moved(clip: ReferenceClip, stance: Array | np.float32) -> ReferenceClip:
    return replace(clip, poses=clip.poses + (stance - clip.poses.mean(axis=0)))


def like_recorded(clips: Sequence[ReferenceClip], stance: Array) -> bool:
    """Whether a stance (24,) is at most as far from the mean pose of some clips as their furthest pose."""
    poses = np.concatenate([clip.poses for clip in clips])
    usual = poses.mean(axis=0)
    return bool(np.linalg.norm(stance - usual) <= np.linalg.norm(poses - usual, axis=1).max())


def stopping(controls: Controls, before: float | None, fps: float) -> Controls:
    """Remove the reference poses from the first STOPPING_FRAMES frames of controls (T, ...) of standing.

    Args:
        before: speed of the body in cm/s, if known.
    """
    if before is not None and before > BRAKED:
        still = np.zeros((len(controls.phase), 3), np.float32)
        controls = carried_over(controls, still, before, fps, BRAKING)
    mask = (np.arange(len(controls.phase)) >= STOPPING_FRAMES).astype(np.float32)
    return replace(
        controls,
        reference=controls.reference * mask[:, None],
        reference_gain=controls.reference_gain * mask,
    )
