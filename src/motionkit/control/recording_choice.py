"""Chooses the recordings of a type that are shown, and the frames they are entered at (motion matching)."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array
from motionkit.control.momentum import ground_speeds, speeds_ahead
from motionkit.control.motion_index import MotionIndex, pose_state, pose_states
from motionkit.control.standing import about_zero, in_stance
from motionkit.features.reference import BEFORE_EVENT, event_begins
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind, MotionType, ReferenceClip

# Clips, each with the frames that it may be entered at.
Entries = list[tuple[ReferenceClip, list[int]]]


@dataclass(frozen=True)
class EntrySettings:
    """Where clips are entered; all numbers are chosen, by the motion of roll-outs."""

    # Random entry frames of which the one most like the present pose is taken, at a change of type and within one. Few
    # at a change: of many, the one most like a standing body is one where nothing happens.
    candidates: int = 24
    candidates_within: int = 200
    suited: float = 2.0  # performances that begin at so many times the least cost, and 1, are as good
    # Shares of all frames that an entry frame moves more, and less, than; and the share of the usual movement that a
    # clip has to exceed somewhere to be entered.
    movement: tuple[float, float] = (0.4, 0.8)
    still: float = 0.2
    seconds: float = 1.5  # of a clip that must follow the frame it is entered at
    gait_seconds: float = 0.75  # the same of gaits and of standing: most runs are recorded for a second
    going: float = 0.6  # share of a gait's usual speed below which, in the coming second, a clip brakes
    # cm/s between strike or jump and body, beyond the nearest of all: a leap out of a run needs the run.
    other_speed: float = 60.0
    played: float = 0.5  # a frame is not entered if a larger share of the seconds from it on has been played
    few_seconds: float = 12.0  # of recordings of a type, where few are enough


@dataclass(frozen=True)
class MatchingSettings:
    """When another frame that suits the trajectory better is gone over to; chosen: every change drags the feet."""

    every: int = 20  # frames between two searches, and frames that must follow in a clip
    clearly: float = 0.4  # share of the present cost that another frame has to stay below


ENTRY, MATCHING = EntrySettings(), MatchingSettings()
# Multiples of the first number fill 0 to 1 most evenly; those of the others, nearly as well. They lead from draw to
# draw, one for as many successive choices as draw evenly.
GOLDEN, STEPS = (math.sqrt(5.0) - 1.0) / 2.0, tuple(math.sqrt(n) % 1.0 for n in (2.0, 3.0, 7.0, 11.0))
SIBLINGS = 32


@dataclass(frozen=True)
class GaitClip:
    """Where a clip of a gait goes on.

    Attributes:
        entries: the frames it is entered at.
        brakes: for each frame (L,) the next at which it brakes, or its length.
    """

    entries: list[int]
    brakes: Array


class PlayedFrames:
    """Which frames of which clips have been played."""

    def __init__(self, fps: float) -> None:
        self.fps = fps
        self._played: dict[ReferenceClip, Array] = {}

    def mark(self, clip: ReferenceClip, at: int, count: int) -> None:
        """Take in that frames have been played."""
        self._of(clip)[at : at + count] = True

    def forget(self, clips: Sequence[ReferenceClip]) -> None:
        """All frames of some clips may be played again."""
        for clip in clips:
            self._of(clip)[:] = False

    def any(self, clip: ReferenceClip) -> bool:
        """Whether some of a clip has been played."""
        return bool(self._of(clip).any())

    def after(self, clip: ReferenceClip) -> Array:
        """Share of ENTRY.seconds from each frame (L,) on, or of what is left of the clip, that has been played."""
        frames = np.arange(len(clip))
        ends = np.minimum(frames + round(ENTRY.seconds * self.fps), len(clip))
        played = np.concatenate([[0], np.cumsum(self._of(clip))])
        return np.asarray((played[ends] - played[frames]) / (ends - frames))

    def _of(self, clip: ReferenceClip) -> Array:
        return self._played.setdefault(clip, np.zeros(len(clip), bool))


class RecordingChoice:
    """Chooses recordings for one character; the same choice chooses the same.

    A type that is one performance is played from its beginning, one recording of it after another. A clip of another
    type is drawn, the more likely the more of it has not been played yet, and by successive choices evenly among all.
    It is entered in the middle: some frames are drawn, for strikes and jumps shortly before one of them and about as
    fast as the body goes, and the frame most like the present pose is taken. Nothing is played again before all has
    been played. A character that stands keeps its stance: recordings are shown moved to it, so that they tell it how to
    sway.
    """

    def __init__(self, model: MotionModel, choice: int = 0, rests: bool = False, few: bool = False) -> None:
        """Begin with nothing played.

        Args:
            rests: where a trajectory is asked for, frames that little movement follows may suit it, too.
            few: use few recordings of each type (few_clips).
        """
        self.model, self.choice, self.rests, self.few = model, choice, rests, few
        self.random = random.Random(choice)
        self.draws = 0  # clips that have been drawn
        self.played = PlayedFrames(model.fps)
        self.stance: tuple[ReferenceClip, ...] = ()  # clips of standing, moved to the body's stance
        self._indices: dict[str, MotionIndex] = {}
        self._gait_clips: dict[ReferenceClip, GaitClip] = {}

    def stand(self, kind: str, stance: Array | None) -> None:
        """Move the clips of standing to a stance (24,), to zero where it is not known yet."""
        clips = self._type(kind).reference_clips
        self.stance = about_zero(clips) if stance is None else in_stance(clips, stance)

    def leave(self, kind: str) -> None:
        """Another type comes: the stance is lost."""
        if self.stance:
            self.stance = ()
            self._indices.pop(kind, None)

    def clips(self, kind: str) -> tuple[ReferenceClip, ...]:
        """The clips of a type, in the stance of a body that began by standing."""
        clips = self.stance or self._type(kind).reference_clips
        return few_clips(clips, self.model.fps) if self.few else clips

    def entry(
        self,
        kind: str,
        near: Array | None,
        behind: int = 0,
        trajectory: Array | None = None,
        speed: float | None = None,
        within: bool = False,
    ) -> tuple[ReferenceClip, int] | None:
        """The clip and the frame that a type is entered at; None without recordings.

        Args:
            near: (S, 24) embeddings of the present pose and of those STATE_FRAMES ago, if they are known.
            behind: frames of a performance that have been shown already.
            trajectory: (24,) the trajectory asked for, which the frame should suit.
            speed: of the body over the ground in cm/s, if it is known.
            within: the type goes on.
        """
        clips = self.clips(kind)
        if not clips:
            return None
        if self.model.kind(kind) is MotionKind.PERFORMANCE:
            clip = self._performance(clips, near, behind)
            return clip, behind % len(clip)
        if trajectory is not None and near is not None:
            number, at = self._index(kind).nearest(near, trajectory, MATCHING.every)
            return clips[number], at
        count = ENTRY.candidates_within if within else ENTRY.candidates
        return self._drawn(self._as_fast(kind, self.entry_frames(kind, clips), speed), count, near)

    def better(self, kind: str, clip: ReferenceClip, at: int, trajectory: Array) -> tuple[ReferenceClip, int]:
        """The clip and the frame that clearly suit a trajectory (24,) better than a frame of a clip, or that frame."""
        index = self._index(kind)
        stay = index.first[index.clips.index(clip)] + at
        number, found = index.nearest(
            pose_state(clip, at), trajectory, MATCHING.every, stay, MATCHING.clearly
        )
        return index.clips[number], found

    def brakes(self, kind: str, clip: ReferenceClip, at: int) -> int:
        """The frame at which a gait's clip brakes after a frame, or its length."""
        return int(self._gait_clip(kind, clip).brakes[min(at, len(clip) - 1)])

    def entry_frames(self, kind: str, clips: Sequence[ReferenceClip]) -> Entries:
        """The frames at which clips that are no performances are entered, for each clip that has some."""
        if before := _before_events(clips):
            return before
        if not self.model.kind(kind).steered:
            return _lively(clips, round(ENTRY.seconds * self.model.fps))
        return [(clip, self._gait_clip(kind, clip).entries) for clip in clips]

    def _type(self, kind: str) -> MotionType:
        return self.model.types.get(kind, MotionType())

    def _index(self, kind: str) -> MotionIndex:
        if kind not in self._indices:
            self._indices[kind] = MotionIndex(self.clips(kind), self.rests)
        return self._indices[kind]

    def _performance(self, clips: Sequence[ReferenceClip], near: Array | None, behind: int) -> ReferenceClip:
        """One of the recorded performances that go on about as well as any from the present pose, each in turn.

        A body that is shown another performance than the one it has begun, to the other side, would flip over.
        """
        suited = list(clips)
        if near is not None:
            states = np.stack([pose_state(clip, behind % len(clip)) for clip in clips])
            costs = np.square(states - near).sum(axis=(1, 2))
            most = 1.0 + ENTRY.suited * costs.min()
            suited = [clip for clip, cost in zip(clips, costs, strict=True) if cost <= most]
        fresh = [clip for clip in suited if not self.played.any(clip)]
        if not fresh:
            self.played.forget(suited)
        return (fresh or suited)[self.choice % len(fresh or suited)]

    def _drawn(self, entries: Entries, count: int, near: Array | None) -> tuple[ReferenceClip, int]:
        """Of some random entry frames of what has not been played the one most like the present pose."""
        found = self._fresh(entries)
        self.draws += 1
        clip, frames = found[drawn_evenly([len(frames) for _, frames in found], self.choice, self.draws)]
        frames = self.random.sample(frames, min(count, len(frames)))
        if near is None:
            return clip, frames[0]
        states = np.stack([pose_state(clip, at) for at in frames])
        return clip, frames[int(np.square(states - near).sum(axis=(1, 2)).argmin())]

    def _as_fast(self, kind: str, found: Entries, speed: float | None) -> Entries:
        """The entry frames at which strikes or jumps go about as fast as the body (cm/s), for each clip that has some.

        Other movements have time to change their speed.
        """
        if speed is None or not self.model.kind(kind).phased:
            return found
        gaps = [np.abs(ground_speeds(clip.ground, self.model.fps)[frames] - speed) for clip, frames in found]
        most = ENTRY.other_speed + min(float(gap.min()) for gap in gaps)
        kept = [
            (clip, [at for at, gap in zip(frames, each.tolist(), strict=True) if gap <= most])
            for (clip, frames), each in zip(found, gaps, strict=True)
        ]
        return [each for each in kept if each[1]]

    def _fresh(self, found: Entries) -> Entries:
        """The entry frames before what has not been played, at least in part; all of them again after the last."""
        played = [self.played.after(clip) for clip, _ in found]
        fresh = [
            (clip, [at for at in frames if after[at] <= ENTRY.played])
            for (clip, frames), after in zip(found, played, strict=True)
        ]
        if any(frames for _, frames in fresh):
            return [each for each in fresh if each[1]]
        self.played.forget([clip for clip, _ in found])
        return found

    def _gait_clip(self, kind: str, clip: ReferenceClip) -> GaitClip:
        """Where a clip of a gait or of standing is entered, and where it brakes: recorded runs end with a stop.

        A clip that is slow all along is none that brakes.
        """
        if clip not in self._gait_clips:
            fps, gait, length = self.model.fps, self._type(kind).gait, len(clip)
            least, frames = min(round(ENTRY.gait_seconds * fps), length - 1), np.arange(length)
            brakes, entries = np.full(length, length), frames[: length - least]
            if self.model.kind(kind) is MotionKind.GAIT and gait is not None:
                # Skip the stop at the end of recorded runs.
                going = ENTRY.going * gait.speed
                slow = np.append(np.flatnonzero(speeds_ahead(clip.ground, fps) < going), length)
                until = slow[np.searchsorted(slow, frames)]
                if (until - frames > least).any():
                    brakes, entries = until, np.flatnonzero(until - frames > least)
            self._gait_clips[clip] = GaitClip(entries.tolist(), brakes)
        return self._gait_clips[clip]


def few_clips(clips: tuple[ReferenceClip, ...], fps: float) -> tuple[ReferenceClip, ...]:
    """The first clips of a type that last ENTRY.few_seconds together, and one at least: enough for first steps."""
    ends = np.cumsum([len(clip) for clip in clips])
    return clips[: max(1, int(np.searchsorted(ends, ENTRY.few_seconds * fps, side="right")))]


def drawn_evenly(sizes: Sequence[int], choice: int, number: int) -> int:
    """Which of some sizes is drawn, the larger the more often, and by successive choices evenly among all.

    Random draws would show half of thirty clips by twenty choices.

    Args:
        choice: a whole number of at least 0.
        number: of the draw by this choice, from 1 on.
    """
    share = (choice * GOLDEN + number * STEPS[choice // SIBLINGS % len(STEPS)]) % 1.0
    return int(np.searchsorted(np.cumsum(sizes), share * sum(sizes), side="right"))


def frames_behind(model: MotionModel, kind: str, near: Array) -> int:
    """Frames of a performance of a type that a body has shown already; 0 where it may as well begin one.

    Args:
        near: (S, 24) pose embeddings of its last frames (last_poses).
    """
    if model.kind(kind) is not MotionKind.PERFORMANCE:
        return 0
    costs = [
        np.square(pose_states(clip, np.arange(len(clip))) - near).sum(axis=(1, 2))
        for clip in model.types[kind].reference_clips
    ]
    begins = min(float(cost[0]) for cost in costs)
    best = min(costs, key=lambda cost: float(cost.min()))
    return int(best.argmin()) if begins > 1.0 + ENTRY.suited * float(best.min()) else 0


def _before_events(clips: Sequence[ReferenceClip]) -> Entries:
    """Frames shortly before strikes or jumps, for each clip that has some."""
    begins = [(clip, event_begins(clip.phases)) for clip in clips]
    return [(clip, np.maximum(each - BEFORE_EVENT, 0).tolist()) for clip, each in begins if len(each)]


def _lively(clips: Sequence[ReferenceClip], least: int) -> Entries:
    """Frames that at least the usual movement follows, though not the liveliest, for each clip that has some.

    A standing body is most like a standing one, in any type: the reference would keep it standing. Of a clip that is
    livelier or calmer than all that, the frames that are usual in it.

    Args:
        least: frames that must follow.
    """
    movements = [clip.movement[: max(1, len(clip) - least)] for clip in clips]
    of_all = np.concatenate(movements)
    usual = np.quantile(of_all, ENTRY.movement[0], method="lower")
    found = []
    for clip, movement in zip(clips, movements, strict=True):
        frames = _between(movement, of_all)
        if not frames and movement.max() > ENTRY.still * usual:
            frames = _between(movement, movement)
        if frames:
            found.append((clip, frames))
    return found


def _between(movement: Array, of_all: Array) -> list[int]:
    """The frames of a movement (L,) that lie between the shares ENTRY.movement of all."""
    # The methods leave at least one frame even of two.
    usual = np.quantile(of_all, ENTRY.movement[0], method="lower")
    lively = np.quantile(of_all, ENTRY.movement[1], method="higher")
    return np.flatnonzero((movement >= usual) & (movement <= lively)).tolist()
