"""From one reference clip to the next: cross-fades, and pauses between performances."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from motionkit.arrays import Array, lerp
from motionkit.features.control import future_trajectory
from motionkit.features.reference import PAUSE, reference_signal
from motionkit.models.motion_type import ReferenceClip

# Least and most frames of a cross-fade, which poses pass at the pace of the clip entered; chosen.
SHORTEST_BLEND, LONGEST_BLEND = 15, 45

# What is shown (T, F) of a clip at frames (T,).
Signal = Callable[[ReferenceClip, Array], Array]


def recorded_poses(clip: ReferenceClip, frames: Array) -> Array:
    """References (T, 72) at frames (T,) of a clip."""
    return reference_signal(clip.poses, frames)


def recorded_trajectory(clip: ReferenceClip, frames: Array) -> Array:
    """Trajectories (T, 24) at frames (T,) of a clip; after its end the last."""
    return future_trajectory(clip.ground, np.minimum(frames, len(clip) - 1))


class Crossfade:
    """A clip that was left for another: it plays on while it fades into that."""

    def __init__(
        self,
        clip: ReferenceClip,
        at: int,
        entered: ReferenceClip,
        entered_at: int,
        before: Crossfade | None = None,
    ) -> None:
        """Take the clip and the frame it was left at, those that were entered, and what still faded into the clip."""
        self.clip, self.at, self.entered_at = clip, at, entered_at
        self.before = None if before is None or before.over(at) else before
        distance = np.linalg.norm(entered.poses[entered_at] - clip.poses[at])
        frames = round(float(distance) / entered.pace)
        self.frames: int = min(max(SHORTEST_BLEND, frames), LONGEST_BLEND)

    def over(self, frame: int) -> bool:
        """Whether nothing of it is left at a frame of the clip entered."""
        return frame >= self.entered_at + self.frames

    def fading(self, frames: Array, shown: Array, signal: Signal) -> Array:
        """What is shown (T, F) at frames (T,) of the clip entered, blended with the same signal of the clip left."""
        since = frames - self.entered_at
        before = signal(self.clip, self.at + since)
        if self.before is not None and self.before.over(self.at + int(since[0])):
            self.before = None  # or clips that are left soon after one another would grow to a long chain
        if self.before is not None:
            before = self.before.fading(self.at + since, before, signal)
        share = np.minimum(since / self.frames, 1.0).astype(np.float32)[:, None]
        return lerp(before, shown, share)


class Pause:
    """PAUSE frames from the last of a clip to the one that the next is entered at, where no movement is shown.

    Performances, strikes and jumps begin after it: half a blend of two of them is neither.
    """

    def __init__(self, left: ReferenceClip, entered: ReferenceClip, at: int) -> None:
        """Take the clip that has ended, and the clip and the frame that were entered."""
        self.ends = (left, np.array([len(left) - 1])), (entered, np.array([at]))
        self.shown = 0

    def next(self, frames: int) -> tuple[Array, Array, bool]:
        """References (n, 72) and recorded trajectories (n, 24) of at most so many frames, and whether it has ended."""
        first, self.shown = self.shown, min(self.shown + frames, PAUSE)
        share = (np.arange(first + 1, self.shown + 1, dtype=np.float32) / PAUSE)[:, None]
        before, after = (reference_signal(clip.poses, at) for clip, at in self.ends)
        left, entered = (future_trajectory(clip.ground, at) for clip, at in self.ends)
        return lerp(before, after, share), lerp(left, entered, share), self.shown == PAUSE
