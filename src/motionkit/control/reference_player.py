"""Plays reference clips of a type, the source of a character's reference poses (features/reference.py)."""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Array
from motionkit.control.blending import SHORTEST_BLEND, Crossfade, Pause
from motionkit.control.momentum import at_speed, forward_speeds, ground_speeds, trajectory_speed
from motionkit.control.motion_index import pose_state
from motionkit.control.recording_choice import MATCHING, RecordingChoice
from motionkit.control.reference_controls import RECORDED_SHARE, ReferenceControls, rhythm_of
from motionkit.features.control import Controls
from motionkit.features.reference import PAUSE
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind, ReferenceClip


class ReferencePlayer:
    """Plays one reference clip of a type after another for one character; the same choice plays the same clips.

    RecordingChoice picks the clips, and ReferenceControls makes controls of them. Without a requested trajectory, gaits
    follow that of their recording, at the speed of their stay. With one, the player searches for frames that match it.
    """

    def __init__(
        self,
        model: MotionModel,
        choice: int = 0,
        recorded_share: float = RECORDED_SHARE,
        rests: bool = False,
        few: bool = False,
    ) -> None:
        """Start without a type.

        Args:
            recorded_share: the share of the recorded trajectory in a requested one.
            rests, few: as in RecordingChoice.
        """
        self.model = model
        self.recordings = RecordingChoice(model, choice, rests, few)
        self.controls = ReferenceControls(model, recorded_share)
        self.kind = ""
        self.clip: ReferenceClip | None = None
        self.at = 0
        self.leaves = 0  # frame at which the clip is left without a trajectory
        self.arrives = 0  # frame at which the cross-fade from another type ends
        self.left: Crossfade | None = None  # cross-fade from the clip before
        self.pause: Pause | None = None  # the present pause
        self._since = 0  # frames since the last search

    def begin(
        self,
        kind: str,
        near: Array | None = None,
        behind: int = 0,
        trajectory: Array | None = None,
        paused: bool = False,
        speed: float | None = None,
        stops: bool = False,
    ) -> None:
        """Change to a type.

        Args:
            near: (S, 24) present state of the body; by default that of the present recording.
            behind: frames of a performance that have been shown.
            trajectory: (24,) requested trajectory, which the entry frame should match.
            paused: insert a pause from the end of a performance (ends) to the beginning of this one.
            speed: speed of the body over the ground in cm/s; by default that of the present recording.
            stops: the body stops, and its stance is not known yet: recordings are moved to zero.
        """
        if near is None:
            near = self._present()
        if speed is None and self.clip is not None:
            speed = float(ground_speeds(self.clip.ground, self.model.fps)[min(self.at, len(self.clip) - 1)])
        first, within = not self.kind, kind == self.kind
        left, left_at, before = self.clip, self.at, self.left
        if not within:
            self.recordings.leave(self.kind)
        self.forget()
        self.kind, self._since = kind, 0
        if stops:
            self.recordings.set_stance(kind, None)
            near = left = None
        elif first and near is not None and trajectory is None and self.model.kind(kind) is MotionKind.STANCE:
            self.recordings.set_stance(kind, near[0])
        found = self.recordings.entry(kind, near, behind, trajectory, speed, within)
        if found is None:
            self.at = behind
            return
        self._enter(found)
        clip = found[0]
        # A performance begins without a blend: a handspring is on the hands before a blend would end.
        if left is not None and not clip.performed:
            self.left = Crossfade(left, left_at, *found, before)
            self.arrives += 0 if within else self.left.frames
        elif left is not None and paused:
            self.pause = Pause(left, *found)

    def lead_into(self, performed: str, frames: int) -> None:
        """Enter a recording of the present gait that leads to the beginning of a performance in some frames, if any."""
        near = self._present()
        found = None if near is None else self.recordings.leading(self.kind, near, performed, frames)
        if found is not None and self.clip is not None and found != (self.clip, self.at):
            self._jump(found)

    @property
    def ends(self) -> bool:
        """Whether a performance has played to its end."""
        return self.clip is not None and self.clip.performed and self.at >= len(self.clip)

    @property
    def speed(self) -> float | None:
        """Forward speed in cm/s of the present recording at its last played frame; None if none has been played."""
        if self.clip is None or not self.at:
            return None
        return float(forward_speeds(self.clip.ground[: self.at], self.model.fps)[-1])

    def forget(self) -> None:
        """Drop the present recording, so that the next one begins without a cross-fade."""
        self.kind, self.clip, self.at, self.left, self.pause = "", None, 0, None, None

    def event_frames(self) -> int:
        """Frames from here to the end of the next strike or jump; 0 if none comes."""
        if self.clip is None:
            rhythm = rhythm_of(self.model, self.kind)
            return 0 if rhythm is None else round(rhythm.frames)
        ahead = (self.clip.phases[self.at :] >= 0.0).tolist()
        if True not in ahead:
            return 0
        first = ahead.index(True)
        return ahead.index(False, first) if False in ahead[first:] else len(ahead)

    def play(self, frames: int, trajectories: Array | None = None, whole: bool = False) -> Controls:
        """Controls (frames, ...) of the next frames; at the end of a clip the player enters another one.

        Args:
            trajectories: (frames, 24) requested trajectories, if any.
            whole: whether these are all frames; a performance that would not end within them does not begin.
        """
        parts: list[Controls] = []
        played = 0
        while played < frames:
            requested = None if trajectories is None else trajectories[played:]
            if self.clip is not None and self.at >= self._end(requested is None):
                self._go_on(None if requested is None else requested[0], frames - played if whole else None)
            elif requested is not None and self._since >= MATCHING.every:
                self._reconsider(requested[0])
            count = frames - played
            parts.append(
                self._paused(self.pause, count, requested) if self.pause else self._stretch(count, requested)
            )
            played += len(parts[-1].phase)
        return Controls.concatenated(parts)

    def _end(self, free: bool) -> int:
        """The frame at which to leave the clip: its end, or what RecordingChoice says; 0 without a clip."""
        if self.clip is None:
            return 0
        return self.leaves if free else len(self.clip)

    def _go_on(self, trajectory: Array | None, frames: int | None) -> None:
        """Enter the next clip, after a pause if there is no time for a blend.

        Args:
            frames: those that are left to play, if known; with too few for a whole performance its last pose is held.
        """
        left = self.clip
        assert left is not None
        if frames is not None and left.performed and frames < PAUSE + len(left):
            self.pause = Pause(left, left, len(left) - 1)
            return
        speed = None if trajectory is None else trajectory_speed(trajectory, self.model.fps)
        phased = self.model.kind(self.kind).phased
        self.begin(self.kind, trajectory=None if phased else trajectory, speed=speed)
        assert self.clip is not None
        if left.performed or (self.clip.phases[self.at : self.at + SHORTEST_BLEND] >= 0.0).any():
            self.pause, self.left = Pause(left, self.clip, self.at), None

    def _reconsider(self, trajectory: Array) -> None:
        """Jump to a frame that matches the trajectory clearly better; types with a phase never jump."""
        self._since = 0
        clip = self.clip
        if clip is None or self.model.kind(self.kind).phased:
            return
        found = self.recordings.better(self.kind, clip, self.at, trajectory)
        if found != (clip, self.at):
            self._jump(found)

    def _jump(self, found: tuple[ReferenceClip, int]) -> None:
        """Fade from the present recording into another frame of any recording of the type."""
        assert self.clip is not None
        self.left = Crossfade(self.clip, self.at, *found, self.left)
        self._enter(found)

    def _enter(self, found: tuple[ReferenceClip, int]) -> None:
        self.clip, self.at = found
        self.arrives = self.at
        self.leaves = self.recordings.leaves(self.kind, self.clip, self.at)

    def _stretch(self, count: int, trajectories: Array | None) -> Controls:
        """Controls of up to `count` frames of the present clip, until its end or the next search."""
        if self.clip is not None:
            count = min(count, self._end(trajectories is None) - self.at)
        if trajectories is not None:
            count = min(count, max(1, MATCHING.every - self._since))
            trajectories = trajectories[:count]
        if self.clip is None:
            controls = self.controls.of_clock(self.kind, self.at, count, trajectories)
        else:
            frames = np.arange(self.at, self.at + count)
            controls = self.controls.of_clip(self.kind, self.clip, frames, self.left, trajectories)
            if trajectories is None and self.model.kind(self.kind) is MotionKind.GAIT:
                steady = frames >= self.arrives
                controls = at_speed(controls, self.recordings.pace, self.model.fps, steady)
            self.recordings.played.mark(self.clip, self.at, count)
        self.at += count
        self._since += count
        return controls

    def _paused(self, pause: Pause, count: int, trajectories: Array | None) -> Controls:
        """Controls of up to `count` frames of the pause; clears the pause at its end."""
        reference, recorded, ended = pause.next(count)
        if ended:
            self.pause = None
        requested = None if trajectories is None else trajectories[: len(reference)]
        return self.controls.of_pause(self.kind, reference, recorded, requested)

    def _present(self) -> Array | None:
        return None if self.clip is None else pose_state(self.clip, min(self.at, len(self.clip) - 1))
