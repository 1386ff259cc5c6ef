"""A body that comes to a stand finds a stance of its own; the recordings that it is shown then are moved to that.

Shown a recorded stance while it still walks, it would pull its feet there over the ground instead of stepping.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from motionkit.arrays import Array
from motionkit.control.momentum import carried_over
from motionkit.features.control import Controls
from motionkit.features.reference import REFERENCE_OFFSETS
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import ReferenceClip

# Frames after which a body that ran, walked or danced stands: no recording is shown until then.
SETTLING = 100
# cm/s from which on a body that is to stand is braked, at so many cm/s^2; slower ones stop by themselves in two steps.
BRAKED, BRAKING = 200.0, 200.0

# Answers the features (B, 276) of the last frame of all characters.
Present = Callable[[], Array]


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


def comes_to_stand(model: MotionModel, before: str | None, kind: str) -> bool:
    """Whether a type that is asked for after another, None for none, is one of standing with recordings."""
    known = model.types.get(kind)
    return (
        before not in (None, kind)
        and known is not None
        and known.stands
        and bool(known.reference_clips)
        and model.uses_references
    )


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


class Stances:
    """Moves the recordings of characters that have come to a stand to the stances that they have found."""

    def __init__(
        self,
        model: MotionModel,
        controls: Controls,
        stands: Sequence[Sequence[tuple[str, int, int | None]]],
        present: Present | None,
    ) -> None:
        """Take the controls (T, B, ...) to change.

        Args:
            stands: for each of the B characters the types it stands in after other ones, and the frames in which such
                a part begins and ends (exclusive), None for never.
            present: without it no recordings are shown there.
        """
        self.model, self.controls, self.present = model, controls, present
        self.coming = [
            (begin + SETTLING, end, i, kind)
            for i, parts in enumerate(stands)
            for kind, begin, end in parts
            if end is None or end > begin + SETTLING
        ]

    def at(self, frame: int) -> None:
        """Do what is to be done before the controls of a frame are read."""
        for begin, end, character, kind in self.coming:
            if frame == begin:
                self._settle(slice(begin, end), character, kind)

    def _settle(self, frames: slice, character: int, kind: str) -> None:
        clips = self.model.types[kind].reference_clips
        if self.present is not None:
            stance = self.model.pose_embedding.of(self.present()[character])
            if like_recorded(clips, stance):
                self.controls.reference[frames, character] += np.tile(stance, len(REFERENCE_OFFSETS))
                return
        self.controls.reference[frames, character] = 0.0
        self.controls.reference_gain[frames, character] = 0.0
