"""Transitions between reference clips: cross-fades, and pauses between performances."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from motionkit.arrays import Array, lerp
from motionkit.features.control import future_trajectory
from motionkit.features.reference import PAUSE, reference_signal
from motionkit.models.motion_type import ReferenceClip

# Limits in frames of a cross-fade; chosen. In between, poses change at the pace of the new clip.
SHORTEST_BLEND, LONGEST_BLEND = 15, 45

# A signal (T, F) of a clip at frames (T,).
Signal = Callable[[ReferenceClip, Array], Array]


def recorded_poses(clip: ReferenceClip, frames: Array) -> Array:
    """Reference poses (T, 72) at frames (T,) of a clip."""
    return reference_signal(clip.poses, frames)


def recorded_trajectory(clip: ReferenceClip, frames: Array) -> Array:
    """Trajectories (T, 24) at frames (T,) of a clip; frames after its end get the last one."""
    return future_trajectory(clip.ground, np.minimum(frames, len(clip) - 1))


class Crossfade:
    """A clip that plays on while it fades into the next one."""

    def __init__(
        self,
        clip: ReferenceClip,
        at: int,
        entered: ReferenceClip,
        entered_at: int,
        before: Crossfade | None = None,
    ) -> None:
        """Fade from a clip and its frame to the entered clip and its frame.

        Args:
            before: an unfinished cross-fade into the first clip.
        """
        self.clip, self.at, self.entered_at = clip, at, entered_at
        self.before = None if before is None or before.over(at) else before
        distance = np.linalg.norm(entered.poses[entered_at] - clip.poses[at])
        frames = round(float(distance) / entered.pace)
        self.frames: int = min(max(SHORTEST_BLEND, frames), LONGEST_BLEND)

    def over(self, frame: int) -> bool:
        """Whether the cross-fade has ended at a frame of the entered clip."""
        return frame >= self.entered_at + self.frames

    def fading(self, frames: Array, current: Array, signal: Signal) -> Array:
        """Blend what is shown (T, F) at frames (T,) of the entered clip with the same signal of the fading clip."""
        since = frames - self.entered_at
        before = signal(self.clip, self.at + since)
        if self.before is not None and self.before.over(self.at + int(since[0])):
            self.before = None  # otherwise quick changes would build a long chain of cross-fades
        if self.before is not None:
            before = self.before.fading(self.at + since, before, signal)
        share = np.minimum(since / self.frames, 1.0).astype(np.float32)[:, None]
        return lerp(before, current, share)


class Pause:
    """PAUSE frames from the last frame of a clip to the entry frame of the next, without movement.

    Performances, strikes and jumps begin after a pause, because a blend of two of them is neither.
    """

    def __init__(self, left: ReferenceClip, entered: ReferenceClip, at: int) -> None:
        """Lead from the end of a clip to a frame of the entered clip."""
        self.ends = (left, np.array([len(left) - 1])), (entered, np.array([at]))
        self.played = 0

    def next(self, frames: int) -> tuple[Array, Array, bool]:
        """Reference poses (n, 72) and trajectories (n, 24) of up to `frames` frames, and whether the pause is over."""
        first, self.played = self.played, min(self.played + frames, PAUSE)
        share = (np.arange(first + 1, self.played + 1, dtype=np.float32) / PAUSE)[:, None]
        before, after = (reference_signal(clip.poses, at) for clip, at in self.ends)
        left, entered = (future_trajectory(clip.ground, at) for clip, at in self.ends)
        return lerp(before, after, share), lerp(left, entered, share), self.played == PAUSE
