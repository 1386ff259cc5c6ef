"""A body that comes to a stand finds a stance of its own; the recordings that it is shown then are moved to that.

Shown a recorded stance while it still walks, it would pull its feet there over the ground instead of stepping.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from motionkit.arrays import Array
from motionkit.control.momentum import carried_over
from motionkit.features.control import Controls
from motionkit.models.motion_type import ReferenceClip

# Frames after which a body that ran, walked or danced stands: no recording is shown until then.
SETTLING = 100
# cm/s from which on a body that is to stand is braked, at so many cm/s^2; slower ones stop by themselves in two steps.
BRAKED, BRAKING = 200.0, 200.0


def in_stance(clips: Sequence[ReferenceClip], stance: Array) -> tuple[ReferenceClip, ...]:
    """Clips of standing still with their mean poses moved to a stance (24,); none if it is unlike all that they show.

    A standing body that is shown one recorded stance after another takes none of them, but their mean.
    """
    if not clips or not like_recorded(clips, stance):
        return ()
    return tuple(_moved(clip, stance) for clip in clips)


def about_zero(clips: Sequence[ReferenceClip]) -> tuple[ReferenceClip, ...]:
    """Clips of standing still with their mean poses moved to zero, for a stance that is not known yet."""
    return tuple(_moved(clip, np.float32(0.0)) for clip in clips)


def _moved(clip: ReferenceClip, stance: Array | np.float32) -> ReferenceClip:
    return replace(clip, poses=clip.poses + (stance - clip.poses.mean(axis=0)))


def like_recorded(clips: Sequence[ReferenceClip], stance: Array) -> bool:
    """Whether a stance (24,) is no further from the mean pose of some clips than the furthest of theirs."""
    poses = np.concatenate([clip.poses for clip in clips])
    usual = poses.mean(axis=0)
    return bool(np.linalg.norm(stance - usual) <= np.linalg.norm(poses - usual, axis=1).max())


def settling(controls: Controls, before: float | None, fps: float) -> Controls:
    """The controls (T, ...) of standing, without its recordings while the body comes to a stand.

    Args:
        before: speed of the body in cm/s, if it is known.
    """
    if before is not None and before > BRAKED:
        still = np.zeros((len(controls.phase), 3), np.float32)
        controls = carried_over(controls, still, before, fps, BRAKING)
    shown = (np.arange(len(controls.phase)) >= SETTLING).astype(np.float32)
    return replace(
        controls,
        reference=controls.reference * shown[:, None],
        reference_gain=controls.reference_gain * shown,
    )
