"""Plays recordings of a type in outline: where the references of a character come from (features/reference.py)."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array, lerp
from motionkit.control.motion_index import STATE_FRAMES, MotionIndex, pose_state
from motionkit.features.control import TRAJECTORY_COUNT, future_trajectory
from motionkit.features.reference import REFERENCE_COUNT, reference_signal
from motionkit.inference.rollout import FrameControls
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionType, ReferenceClip

# MotionIndex a recording may be entered at, of which the one most like the present pose is taken. Few at a change of
# type, for of many the most alike to one who stands is one where nothing happens; many to go on within a type.
CANDIDATES, CANDIDATES_WITHIN = 24, 200
PAUSE = 20  # frames from the end of a performance to the beginning of the next one
BLEND = 15  # frames over which one recording goes over to the next of its type
EVENT_CANDIDATES = 4
LIVELY = 0.85  # share of the places that move less than the liveliest
# A recording is entered where so many seconds of it are left; a strike so many frames before it begins.
LEAST_SECONDS = 1.5
BEFORE_EVENT = 15
# Where the trajectory is given, every so many frames another place is gone over to that suits it clearly better.
RECONSIDERED, CLEARLY = 20, 0.4
# A recording's feet stand where it went itself. Where characters go where their feet let them (synthesis/slip_correction.py), so
# much of the trajectory shown is the recording's, the rest the one asked for.
OWN_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class Signals:
    """What a player asks of one character for T frames.

    Attributes:
        reference, reference_gain: (T, 72), and (T,) how many times larger than it is it is shown, 0 for not.
        trajectory, given: (T, 24) the trajectory to show, and (T,) 1 where there is one: that of a recorded performance,
            or where a trajectory is asked for, one between it and the recording's.
        progress: (T,) through a performance, negative for none.
    """

    reference: Array
    reference_gain: Array
    trajectory: Array
    trajectory_mask: Array
    phase: Array

    @staticmethod
    def joined(parts: list[Signals]) -> Signals:
        """One after another."""
        return Signals(**{name: np.concatenate([getattr(p, name) for p in parts]) for name in vars(parts[0])})

    @staticmethod
    def side_by_side(characters: list[Signals]) -> Signals:
        """Those of B characters as one: (T, B, ...), the shorter ones going on with their last frame."""
        frames = max(len(c.phase) for c in characters)
        rows = [np.minimum(np.arange(frames), len(c.phase) - 1) for c in characters]
        pairs = list(zip(characters, rows, strict=True))
        return Signals(
            **{name: np.stack([getattr(c, name)[r] for c, r in pairs], 1) for name in vars(characters[0])}
        )

    def controls(self, frame: int, type_weights: Array) -> FrameControls:
        """What they ask of B characters at a frame, with type weights (B, N)."""
        signals = (self.trajectory, self.trajectory_mask, self.phase, self.reference, self.reference_gain)
        return FrameControls(type_weights, *(values[frame] for values in signals))


class ReferencePlayer:
    """Plays one recording of a type after another for one character; the same choice plays the same.

    A type that is one performance is played from its beginning and repeated. Of others a recording is
    entered in the middle: a few places are drawn, types of strikes and jumps shortly before one of these,
    and the one most like the present pose is taken. Where a character is to go some trajectory while it dances, places
    are sought that go such a trajectory.
    """

    def __init__(self, model: MotionModel, choice: int = 0, own_share: float = OWN_SHARE) -> None:
        """own_share: how much of a trajectory asked for gives trajectory to the recording's."""
        self.model, self.choice, self.own_share = model, choice, own_share
        self.random = random.Random(choice)
        self.kind = ""
        self.clip: ReferenceClip | None = None
        self.at = 0
        # The recording before, its place, and that of this one.
        self.left: tuple[ReferenceClip, int, int] | None = None
        self._places: dict[str, MotionIndex] = {}
        self._since = 0  # frames since a place was sought

    def begin(
        self, kind: str, near: Array | None = None, behind: int = 0, trajectory: Array | None = None
    ) -> None:
        """Go over to a type.

        Args:
            near: (S, 24) reference_clips of the pose STATE_FRAMES ago; that of what was played by default.
            behind: frames of a performance that lie behind already.
            trajectory: (24,) the trajectory that is asked for, if the place is to suit it.
        """
        if near is None:
            near = self._present()
        count = CANDIDATES_WITHIN if kind == self.kind else CANDIDATES
        left, place = self.clip, self.at
        self.kind, self.clip, self.at, self.left, self._since = kind, None, 0, None, 0
        reference_clips = self._type.reference_clips
        if not reference_clips:
            return
        if self._type.performed:
            self.clip = reference_clips[self.choice % len(reference_clips)]
            self.at = behind % len(self.clip)
        elif trajectory is not None and near is not None:
            number, self.at = self._sought().nearest(near, trajectory, RECONSIDERED)
            self.clip = reference_clips[number]
        else:
            self.clip, self.at = self._drawn(reference_clips, count, near)
        # A performance is entered as it begins: its phase and its trajectory do not wait for the reference.
        if left is not None and not self.clip.performed:
            self.left = (left, place, self.at)

    def event_frames(self) -> int:
        """Frames from here to the end of the strike or jump that comes first, zero if none comes."""
        if self.clip is None:
            return 0
        ahead = (self.clip.phases[self.at :] >= 0.0).tolist()
        if True not in ahead:
            return 0
        first = ahead.index(True)
        return ahead.index(False, first) if False in ahead[first:] else len(ahead)

    def play(self, frames: int, trajectories: Array | None = None) -> Signals:
        """Signals of the coming frames; at the end of a recording another one is entered.

        trajectories: (frames, 24) the trajectories that are asked for, if what is played is to suit them.
        """
        parts: list[Signals] = []
        played = 0
        while played < frames:
            trajectory = None if trajectories is None else trajectories[played]
            if self.clip is not None and self.at >= len(self.clip):
                left = self.clip
                self.begin(self.kind, trajectory=None if self._strikes() else trajectory)
                if left.performed:
                    parts.append(
                        self._between(
                            left, frames - played, None if trajectories is None else trajectories[played:]
                        )
                    )
                    played += len(parts[-1].phase)
                    continue
            elif trajectory is not None and self._since >= RECONSIDERED:
                self._reconsider(trajectory)
            count = frames - played
            if self.clip is not None:
                count = min(count, len(self.clip) - self.at)
            if trajectories is not None:
                count = min(count, max(1, RECONSIDERED - self._since))
            parts.append(
                self._stretch(count, None if trajectories is None else trajectories[played : played + count])
            )
            self.at += count
            self._since += count
            played += count
        return Signals.joined(parts)

    def _reconsider(self, trajectory: Array) -> None:
        """Go over to a place that suits the trajectory clearly better; strikes and jumps would be kept from coming."""
        self._since = 0
        reference_clip = self.clip
        if reference_clip is None or self._strikes():
            return
        places = self._sought()
        stay = places.first[places.reference_clips.index(reference_clip)] + self.at
        number, at = places.nearest(
            pose_state(reference_clip, self.at), trajectory, RECONSIDERED, stay, CLEARLY
        )
        if (places.reference_clips[number], at) != (reference_clip, self.at):
            self.left = (reference_clip, self.at, at)
            self.clip, self.at = places.reference_clips[number], at

    def _strikes(self) -> bool:
        """Whether the type is a performance or made of strikes or jumps."""
        return self._type.has_phase

    def _sought(self) -> MotionIndex:
        if self.kind not in self._places:
            self._places[self.kind] = MotionIndex(self._type.reference_clips)
        return self._places[self.kind]

    def _stretch(self, count: int, trajectories: Array | None) -> Signals:
        reference_clip = self.clip
        zeros = np.zeros(count, np.float32)
        if reference_clip is None:
            trajectory = (
                np.zeros((count, TRAJECTORY_COUNT), np.float32) if trajectories is None else trajectories
            )
            return Signals(
                np.zeros((count, REFERENCE_COUNT), np.float32),
                zeros,
                trajectory,
                zeros + float(trajectories is not None),
                zeros - 1.0,
            )
        frames = np.arange(self.at, self.at + count)
        reference = reference_signal(reference_clip.poses, frames)
        if self.left is not None:
            # The poses that follow the recording that was left go over into those of this one.
            left, place, entered = self.left
            since = frames - entered
            before = reference_signal(left.poses, place + since)
            reference = lerp(before, reference, np.minimum(since / np.float32(BLEND), 1.0)[:, None])
        trajectory, given = self._trajectory(reference_clip, frames, trajectories)
        strength = np.full(count, self._strength(), np.float32)
        return Signals(reference, strength, trajectory, zeros + given, reference_clip.phases[frames])

    def _trajectory(
        self, reference_clip: ReferenceClip, frames: Array, trajectories: Array | None
    ) -> tuple[Array, float]:
        """The trajectories (T, 24) to show at frames of an reference_clip, and whether they count."""
        if trajectories is None and not reference_clip.performed:
            return np.zeros((len(frames), TRAJECTORY_COUNT), np.float32), 0.0
        if trajectories is not None and not self.own_share:
            return trajectories, 1.0
        # A cartwheel to the left is as good as one to the right; the trajectory of the recorded one decides.
        own = future_trajectory(reference_clip.ground, frames)
        return (own if trajectories is None else lerp(trajectories, own, self.own_share)), 1.0

    def _between(self, left: ReferenceClip, frames: int, trajectories: Array | None) -> Signals:
        """From the end of a performance to the beginning of the next one, in no more than so many frames."""
        assert self.clip is not None
        count = min(PAUSE, frames)
        share = (np.arange(1, count + 1, dtype=np.float32) / PAUSE)[:, None]
        end, start = np.array([len(left) - 1]), np.array([0])
        reference = lerp(reference_signal(left.poses, end), reference_signal(self.clip.poses, start), share)
        if trajectories is None:
            trajectory = lerp(
                future_trajectory(left.ground, end), future_trajectory(self.clip.ground, start), share
            )
        else:
            trajectory = trajectories[:count]
        ones = np.ones(count, np.float32)
        return Signals(reference, self._strength() * ones, trajectory, ones, -ones)

    def _strength(self) -> float:
        """The reference gain of the type; 0 for models without references."""
        return self._type.preset.reference_gain if self.model.uses_references else 0.0

    @property
    def _type(self) -> MotionType:
        return self.model.types.get(self.kind, MotionType())

    def _present(self) -> Array | None:
        return None if self.clip is None else pose_state(self.clip, min(self.at, len(self.clip) - 1))

    def _drawn(
        self, reference_clips: Sequence[ReferenceClip], count: int, near: Array | None
    ) -> tuple[ReferenceClip, int]:
        """Of some places drawn the one most like the pose."""
        places = self._events(reference_clips) or self._anywhere(reference_clips, count)
        if near is None:
            return places[0]
        states = np.stack([pose_state(reference_clip, at) for reference_clip, at in places])
        return places[int(np.square(states - near).sum(axis=(1, 2)).argmin())]

    def _events(self, reference_clips: Sequence[ReferenceClip]) -> list[tuple[ReferenceClip, int]]:
        """Some places shortly before a strike or jump; none for types without."""
        found = []
        for reference_clip in reference_clips:
            begins = (
                np.flatnonzero((reference_clip.phases[1:] >= 0.0) & (reference_clip.phases[:-1] < 0.0)) + 1
            )
            found += [(reference_clip, max(0, int(at) - BEFORE_EVENT)) for at in begins]
        return self.random.sample(found, min(EVENT_CANDIDATES, len(found)))

    def _anywhere(
        self, reference_clips: Sequence[ReferenceClip], count: int
    ) -> list[tuple[ReferenceClip, int]]:
        """Some places that are followed by at least the usual movement, though not the liveliest.

        Who stands is most like those who stand, in any type: he would be reference_gain to go on standing.
        """
        least = round(LEAST_SECONDS * self.model.fps)
        movements = [
            reference_clip.movement[: max(1, len(reference_clip) - least)]
            for reference_clip in reference_clips
        ]
        all_movements = np.concatenate(movements)
        # Of two places one has to be left.
        usual = np.quantile(all_movements, 0.5, method="lower")
        lively = np.quantile(all_movements, LIVELY, method="higher")
        found = [
            (reference_clip, at)
            for reference_clip, movement in zip(reference_clips, movements, strict=True)
            for at in np.flatnonzero((movement >= usual) & (movement <= lively)).tolist()
        ]
        return self.random.sample(found, min(count, len(found)))


def last_poses(model: MotionModel, features: Array) -> Array:
    """Outlines (S, 24) of the frames (T, 276) that are STATE_FRAMES before the last."""
    return model.pose_embedding.of(features[[max(0, len(features) - 1 - before) for before in STATE_FRAMES]])
