"""Plays reference clips of a type: the source of a character's reference poses (features/reference.py)."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from motionkit.arrays import Array, lerp
from motionkit.control.momentum import asked_speed, forward_speeds, ground_speeds, speeds_ahead
from motionkit.control.motion_index import STATE_FRAMES, MotionIndex, pose_state, pose_states
from motionkit.control.standing import about_zero, in_stance
from motionkit.features.control import Controls, future_trajectory, straight_trajectory
from motionkit.features.decode import integrate_ground
from motionkit.features.reference import BEFORE_EVENT, PAUSE, event_begins, reference_signal
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionType, ReferenceClip, Rhythm

# Random entry frames of a clip, of which the one most like the present pose is taken. Few at a change of type: of many,
# the one most like a standing body is one where nothing happens. Many to go on within a type.
CANDIDATES, CANDIDATES_WITHIN = 24, 200
SUITED = 2.0  # performances whose beginning costs up to so many times as much as that of the best, and 1, are as good
# Least and most frames of the blend from one clip to the next, which poses cross at the pace of the clip entered.
SHORTEST_BLEND, LONGEST_BLEND = 15, 45
# Clips are entered in frames that move more than the first of these shares of all, and less than the second.
ENTRY_MOVEMENT = (0.4, 0.8)
# Of the usual movement of all: a clip that nowhere moves more is one of standing, and is not entered.
STILL = 0.2
LEAST_SECONDS = 1.5  # of a clip that must follow the frame it is entered at
GAIT_LEAST = 0.75  # the same of gaits and of standing: most runs are recorded for a second
# A gait brakes where a clip goes slower than this share of its usual speed in the coming second.
GOING = 0.6
# cm/s by which a strike or jump may go faster or slower than the body, beyond the nearest of all: a leap out of a run
# needs the run.
OTHER_SPEED = 60.0
# With a trajectory, every so many frames the player looks for a frame that suits it better, and jumps there if its
# cost is less than this share of the present one.
RECONSIDERED, CLEARLY = 20, 0.4
# Share of the recorded trajectory in the one shown, where one is asked for: recorded feet stand where the recording
# went, and the root-slip correction (inference/slip_correction.py) follows the feet.
OWN_SHARE = 0.5
PLAYED = 0.5  # a frame is not entered if more than this share of the LEAST_SECONDS from it on has been played
# Multiples of the first number fill 0 to 1 most evenly; those of the others, nearly as well. They lead from draw to
# draw, one for as many successive choices as draw evenly.
GOLDEN, STEPS = (math.sqrt(5.0) - 1.0) / 2.0, tuple(math.sqrt(n) % 1.0 for n in (2.0, 3.0, 7.0, 11.0))
SIBLINGS = 32
FEW_SECONDS = 12.0  # of recordings of a type, for players of few


# What is shown (T, F) of a clip at frames (T,).
Signal = Callable[[ReferenceClip, Array], Array]


def recorded_poses(clip: ReferenceClip, frames: Array) -> Array:
    """References (T, 72) at frames (T,) of a clip."""
    return reference_signal(clip.poses, frames)


def recorded_way(clip: ReferenceClip, frames: Array) -> Array:
    """Trajectories (T, 24) at frames (T,) of a clip; after its end the last."""
    return future_trajectory(clip.ground, np.minimum(frames, len(clip) - 1))


class Left:
    """A clip that was left for another: it plays on while it fades into that."""

    def __init__(
        self,
        clip: ReferenceClip,
        at: int,
        entered: ReferenceClip,
        entered_at: int,
        before: Left | None = None,
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


@dataclass(frozen=True)
class Way:
    """Where a clip of a gait goes on.

    Attributes:
        entries: the frames it is entered at.
        brakes: for each frame (L,) the next at which it brakes, or its length.
    """

    entries: list[int]
    brakes: Array


class ReferencePlayer:
    """Plays one reference clip of a type after another for one character; the same choice plays the same.

    A type that is one performance is played from its beginning, one recording of it after another. A clip of another
    type is drawn, the more likely the more of it has not been played yet, and by successive choices evenly among all.
    It is entered in the middle: some frames are drawn, for strikes and jumps shortly before one of them and about as
    fast as the body goes, and the frame most like the present pose is taken. Nothing is played again before all has
    been played. Gaits go where their recordings went; where a trajectory is asked for, the player looks for frames that
    go that way. A character that stands keeps its stance: recordings are shown moved to it, so that they tell it how to
    sway.
    """

    def __init__(
        self,
        model: MotionModel,
        choice: int = 0,
        own_share: float = OWN_SHARE,
        rests: bool = False,
        few: bool = False,
    ) -> None:
        """Start with no type.

        Args:
            own_share: the share of the recorded trajectory in one that is asked for.
            rests: where a trajectory is asked for, frames that little movement follows may suit it, too.
            few: play few recordings of each type (few_clips).
        """
        self.model, self.choice, self.own_share, self.rests, self.few = model, choice, own_share, rests, few
        self.random = random.Random(choice)
        self.kind = ""
        self.clip: ReferenceClip | None = None
        self.at = 0
        self.left: Left | None = None  # the clip before
        self.pause: Pause | None = None  # that is being shown
        self._in_stance: tuple[ReferenceClip, ...] = ()  # clips of standing, moved to its stance
        self._indices: dict[str, MotionIndex] = {}
        self._ways: dict[ReferenceClip, Way] = {}
        self._played: dict[ReferenceClip, Array] = {}  # for each clip which frames (L,) have been played
        self._since = 0  # frames since the last search
        self._draws = 0  # clips that have been drawn

    def begin(
        self,
        kind: str,
        near: Array | None = None,
        behind: int = 0,
        trajectory: Array | None = None,
        paused: bool = False,
        speed: float | None = None,
        settles: bool = False,
    ) -> None:
        """Change to a type.

        Args:
            near: (S, 24) embeddings of the present pose and of those STATE_FRAMES ago; those played by default.
            behind: frames of a performance that have been shown already.
            trajectory: (24,) the trajectory asked for, which the frame entered should suit.
            paused: lead to the beginning of a performance over a pause, from the end of another one (ends).
            speed: of the body over the ground in cm/s; that of the recording played by default.
            settles: the type is one of standing, and the stance is not known yet: recordings are moved to zero.
        """
        if near is None:
            near = self._present()
        if speed is None and self.clip is not None:
            speed = float(self._speeds(self.clip)[min(self.at, len(self.clip) - 1)])
        count = CANDIDATES_WITHIN if kind == self.kind else CANDIDATES
        left, left_at, before = self.clip, self.at, self.left
        first = not self.kind
        if self._in_stance and kind != self.kind:
            self._in_stance = ()
            self._indices.pop(self.kind, None)
        self.kind, self.clip, self.at, self._since = kind, None, 0, 0
        self.left = self.pause = None
        if first and near is not None and trajectory is None and self._type.stands:
            self._in_stance = in_stance(self._type.reference_clips, near[0])
        elif settles:
            self._in_stance, near, left = about_zero(self._type.reference_clips), None, None
        clips = self._clips
        if not clips:
            self.at, self.rights = (
                behind,
                not behind and bool(self.choice % 2),
            )  # start poses begin with a left one
            return
        if self._type.performed:
            self.clip = self._performance(clips, near, behind)
            self.at = behind % len(self.clip)
        elif trajectory is not None and near is not None:
            number, self.at = self._index().nearest(near, trajectory, RECONSIDERED)
            self.clip = clips[number]
        else:
            self.clip, self.at = self._drawn(clips, count, near, speed)
        # A performance begins without a blend: a handspring is over the hands before the blend would be.
        if left is not None and not self.clip.performed:
            self.left = Left(left, left_at, self.clip, self.at, before)
        elif left is not None and paused:
            self.pause = Pause(left, self.clip, self.at)

    @property
    def ends(self) -> bool:
        """Whether a performance has been played to its end."""
        return self.clip is not None and self.clip.performed and self.at >= len(self.clip)

    @property
    def speed(self) -> float | None:
        """Speed in cm/s with which the recording that is played has gone ahead; None where nothing has been played."""
        if self.clip is None or not self.at:
            return None
        return float(forward_speeds(self.clip.ground[: self.at], self.model.fps)[-1])

    def forget(self) -> None:
        """Forget the recording that is played: the body has gone its own way since, and the next fades in from none."""
        self.kind, self.clip, self.at, self.left, self.pause = "", None, 0, None, None

    def event_frames(self) -> int:
        """Frames from here to the end of the next strike or jump, zero if none comes."""
        if self.clip is None:
            return 0 if self._rhythm is None else round(self._rhythm.frames)
        ahead = (self.clip.phases[self.at :] >= 0.0).tolist()
        if True not in ahead:
            return 0
        first = ahead.index(True)
        return ahead.index(False, first) if False in ahead[first:] else len(ahead)

    def play(self, frames: int, trajectories: Array | None = None) -> Controls:
        """Controls (frames, ...) of the coming frames; at the end of a clip another one is entered.

        Args:
            trajectories: (frames, 24) the trajectories asked for, if any.
        """
        parts: list[Controls] = []
        played = 0
        while played < frames:
            wanted = None if trajectories is None else trajectories[played:]
            end = self._end(wanted is None)
            if self.clip is not None and self.at >= end:
                self._go_on(None if wanted is None else wanted[0])
            elif wanted is not None and self._since >= RECONSIDERED:
                self._reconsider(wanted[0])
            count = frames - played
            if self.pause is not None:
                parts.append(self._paused(self.pause, count, wanted))
                played += len(parts[-1].phase)
                continue
            if self.clip is not None:
                count = min(count, self._end(wanted is None) - self.at)
            if wanted is not None:
                count = min(count, max(1, RECONSIDERED - self._since))
                wanted = wanted[:count]
            parts.append(self._stretch(count, wanted))
            if self.clip is not None:
                self._played_of(self.clip)[self.at : self.at + count] = True
            self.at += count
            self._since += count
            played += count
        return Controls.concatenated(parts)

    def _end(self, free: bool) -> int:
        """The frame at which the clip is left: its end, or where a gait brakes that goes free; 0 without a clip."""
        if self.clip is None:
            return 0
        if not (free and self._type.goes):
            return len(self.clip)
        return int(self._way(self.clip).brakes[min(self.at, len(self.clip) - 1)])

    def _go_on(self, trajectory: Array | None) -> None:
        """Enter the next clip at the end of one; after a pause where there is no time for a blend."""
        left = self.clip
        assert left is not None
        speed = None if trajectory is None else asked_speed(trajectory, self.model.fps)
        self.begin(self.kind, trajectory=None if self._type.has_phase else trajectory, speed=speed)
        assert self.clip is not None
        if left.performed or (self.clip.phases[self.at : self.at + SHORTEST_BLEND] >= 0.0).any():
            self.pause, self.left = Pause(left, self.clip, self.at), None

    def _reconsider(self, trajectory: Array) -> None:
        """Jump to a frame that suits the trajectory clearly better; types of strikes and jumps play on to theirs."""
        self._since = 0
        clip = self.clip
        if clip is None or self._type.has_phase:
            return
        index = self._index()
        stay = index.first[index.clips.index(clip)] + self.at
        number, at = index.nearest(pose_state(clip, self.at), trajectory, RECONSIDERED, stay, CLEARLY)
        if (index.clips[number], at) != (clip, self.at):
            self.left = Left(clip, self.at, index.clips[number], at, self.left)
            self.clip, self.at = index.clips[number], at

    def _index(self) -> MotionIndex:
        if self.kind not in self._indices:
            self._indices[self.kind] = MotionIndex(self._clips, self.rests)
        return self._indices[self.kind]

    def _stretch(self, count: int, trajectories: Array | None) -> Controls:
        """Controls of the next frames of the present clip."""
        clip = self.clip
        free = Controls.of_types(self._weights(count))
        if clip is None:
            free = replace(free, phase=self._clock(count))
            if trajectories is None and self._type.velocity is not None:
                usual = straight_trajectory(self._type.velocity, self.model.fps)
                trajectories = np.tile(usual, (count, 1))
            return free if trajectories is None else replace(free, trajectory=trajectories).with_mask(1.0)
        frames = np.arange(self.at, self.at + count)
        reference = recorded_poses(clip, frames)
        if self.left is not None:
            reference = self.left.fading(frames, reference, recorded_poses)
        asked = replace(
            free,
            reference=reference,
            reference_gain=free.reference_gain + self._gain(),
            phase=clip.phases[frames],
        )
        trajectory = self._trajectory(clip, frames, trajectories)
        return asked if trajectory is None else replace(asked, trajectory=trajectory).with_mask(1.0)

    @property
    def _rhythm(self) -> Rhythm | None:
        """Of the performances, strikes or jumps of a type without recordings; None for other types."""
        length = round(self.model.phase_seconds(self.kind) * self.model.fps)
        return (self._type.rhythm or Rhythm(length, length + PAUSE)) if length else None

    def _clock(self, count: int) -> Array:
        """Phases (count,) of a type without recordings, in its rhythm."""
        rhythm = self._rhythm
        if rhythm is None:
            return np.full(count, -1.0, np.float32)
        return rhythm.phases(self.at, count)

    def _trajectory(self, clip: ReferenceClip, frames: Array, trajectories: Array | None) -> Array | None:
        """The trajectories (T, 24) to show at frames of a clip, None for none."""
        gait = self._type.goes and self.model.uses_references
        if trajectories is None and not (clip.performed or gait):
            return None
        if trajectories is not None and not self.own_share:
            return trajectories
        # A cartwheel to the left is as good as one to the right, a slow walk as a fast one; the recorded trajectory
        # decides.
        own = recorded_way(clip, frames)
        if trajectories is not None:
            return lerp(trajectories, own, self.own_share)
        return own if self.left is None else self.left.fading(frames, own, recorded_way)

    def _paused(self, pause: Pause, frames: int, trajectories: Array | None) -> Controls:
        """Controls of at most so many frames of the pause, which then may end."""
        reference, own, ended = pause.next(frames)
        count = len(reference)
        if ended:
            self.pause = None
        free = Controls.of_types(self._weights(count))
        asked = replace(free, reference=reference, reference_gain=free.reference_gain + self._gain())
        if trajectories is None and not self._type.performed:
            return asked
        return replace(asked, trajectory=own if trajectories is None else trajectories[:count]).with_mask(1.0)

    def _gain(self) -> np.float32:
        """The reference gain of the type; 0 for models without references."""
        return np.float32(self._type.preset.reference_gain if self.model.uses_references else 0.0)

    def _weights(self, count: int) -> Array:
        """Type weights (count, N) of the type alone; zeros for a type the model does not have."""
        weights = np.zeros((count, len(self.model.types)), np.float32)
        if self.kind in self.model.types:
            weights[:, self.model.type_id(self.kind)] = 1.0
        return weights

    @property
    def _type(self) -> MotionType:
        return self.model.types.get(self.kind, MotionType())

    @property
    def _clips(self) -> tuple[ReferenceClip, ...]:
        """The clips of the type, in the stance of a body that began by standing."""
        clips = self._in_stance or self._type.reference_clips
        return few_clips(clips, self.model.fps) if self.few else clips

    def _present(self) -> Array | None:
        return None if self.clip is None else pose_state(self.clip, min(self.at, len(self.clip) - 1))

    def _performance(self, clips: Sequence[ReferenceClip], near: Array | None, behind: int) -> ReferenceClip:
        """One of the recorded performances that go on about as well as any from the present pose, each in turn.

        A body that is shown another performance than the one it has begun, to the other side, would flip over.
        """
        suited = list(clips)
        if near is not None:
            states = np.stack([pose_state(clip, behind % len(clip)) for clip in clips])
            costs = np.square(states - near).sum(axis=(1, 2))
            suited = [
                clip for clip, cost in zip(clips, costs, strict=True) if cost <= 1.0 + SUITED * costs.min()
            ]
        fresh = [clip for clip in suited if not self._played_of(clip).any()]
        if not fresh:
            for clip in suited:
                self._played_of(clip)[:] = False
        return (fresh or suited)[self.choice % len(fresh or suited)]

    def _drawn(
        self, clips: Sequence[ReferenceClip], count: int, near: Array | None, speed: float | None
    ) -> tuple[ReferenceClip, int]:
        """Of some random entry frames of what has not been played the one most like the present pose."""
        found = self._fresh(self._as_fast(self.entry_frames(clips), speed))
        self._draws += 1
        clip, frames = found[drawn_evenly([len(frames) for _, frames in found], self.choice, self._draws)]
        frames = self.random.sample(frames, min(count, len(frames)))
        if near is None:
            return clip, frames[0]
        states = np.stack([pose_state(clip, at) for at in frames])
        return clip, frames[int(np.square(states - near).sum(axis=(1, 2)).argmin())]

    def entry_frames(self, clips: Sequence[ReferenceClip]) -> list[tuple[ReferenceClip, list[int]]]:
        """The frames at which clips that are no performances are entered, for each clip that has some."""
        if before := self._before_events(clips):
            return before
        if not self._type.steered:
            return self._lively(clips)
        return [(clip, self._way(clip).entries) for clip in clips]

    def _as_fast(
        self, found: list[tuple[ReferenceClip, list[int]]], speed: float | None
    ) -> list[tuple[ReferenceClip, list[int]]]:
        """The entry frames at which strikes or jumps go about as fast as the body (cm/s), for each clip that has some.

        Other movements have time to change their speed.
        """
        if speed is None or not self._type.has_phase:
            return found
        gaps = [np.abs(self._speeds(clip)[frames] - speed) for clip, frames in found]
        most = OTHER_SPEED + min(float(gap.min()) for gap in gaps)
        kept = [
            (clip, [at for at, gap in zip(frames, each.tolist(), strict=True) if gap <= most])
            for (clip, frames), each in zip(found, gaps, strict=True)
        ]
        return [each for each in kept if each[1]]

    def _speeds(self, clip: ReferenceClip) -> Array:
        """Speeds (L,) in cm/s with which a recording goes over the ground."""
        return ground_speeds(clip.ground, self.model.fps)

    def _fresh(self, found: list[tuple[ReferenceClip, list[int]]]) -> list[tuple[ReferenceClip, list[int]]]:
        """The entry frames before what has not been played, at least in part; all of them again after the last."""
        played = [self._played_after(clip) for clip, _ in found]
        fresh = [
            (clip, [at for at in frames if after[at] <= PLAYED])
            for (clip, frames), after in zip(found, played, strict=True)
        ]
        if any(frames for _, frames in fresh):
            return [each for each in fresh if each[1]]
        for clip, _ in found:
            self._played_of(clip)[:] = False
        return found

    def _played_after(self, clip: ReferenceClip) -> Array:
        """Share of the LEAST_SECONDS from each frame (L,) on, or of what is left of the clip, that has been played."""
        frames = np.arange(len(clip))
        ends = np.minimum(frames + round(LEAST_SECONDS * self.model.fps), len(clip))
        played = np.concatenate([[0], np.cumsum(self._played_of(clip))])
        return np.asarray((played[ends] - played[frames]) / (ends - frames))

    def _played_of(self, clip: ReferenceClip) -> Array:
        return self._played.setdefault(clip, np.zeros(len(clip), bool))

    def _before_events(self, clips: Sequence[ReferenceClip]) -> list[tuple[ReferenceClip, list[int]]]:
        """Frames shortly before strikes or jumps, for each clip that has some."""
        found = []
        for clip in clips:
            begins = event_begins(clip.phases)
            if len(begins):
                found.append((clip, np.maximum(begins - BEFORE_EVENT, 0).tolist()))
        return found

    def _way(self, clip: ReferenceClip) -> Way:
        """Where a gait is entered, goes on from for GAIT_LEAST, and brakes.

        Runs are recorded with the stop at their end, which nobody asks for who asks for a run. A clip that is slow all
        along is none that brakes.
        """
        if clip not in self._ways:
            fps, gait, length = self.model.fps, self._type.gait, len(clip)
            least, frames = min(round(GAIT_LEAST * fps), length - 1), np.arange(length)
            brakes, entries = np.full(length, length), frames[: length - least]
            if self._type.goes and gait is not None:
                slow = np.append(np.flatnonzero(speeds_ahead(clip.ground, fps) < GOING * gait.speed), length)
                until = slow[np.searchsorted(slow, frames)]
                if (until - frames > least).any():
                    brakes, entries = until, np.flatnonzero(until - frames > least)
            self._ways[clip] = Way(entries.tolist(), brakes)
        return self._ways[clip]

    def _lively(self, clips: Sequence[ReferenceClip]) -> list[tuple[ReferenceClip, list[int]]]:
        """Frames that at least the usual movement follows, though not the liveliest, for each clip that has some.

        A standing body is most like a standing one, in any type: the reference would keep it standing. Of a clip that
        is livelier or calmer than all that, the frames that are usual in it.
        """
        least = round(LEAST_SECONDS * self.model.fps)
        movements = [clip.movement[: max(1, len(clip) - least)] for clip in clips]
        of_all = np.concatenate(movements)
        usual = np.quantile(of_all, ENTRY_MOVEMENT[0], method="lower")
        found = []
        for clip, movement in zip(clips, movements, strict=True):
            frames = _between(movement, of_all)
            if not frames and movement.max() > STILL * usual:
                frames = _between(movement, movement)
            if frames:
                found.append((clip, frames))
        return found


def few_clips(clips: tuple[ReferenceClip, ...], fps: float) -> tuple[ReferenceClip, ...]:
    """The first clips of a type that last FEW_SECONDS together, and one at least: enough for first steps."""
    ends = np.cumsum([len(clip) for clip in clips])
    return clips[: max(1, int(np.searchsorted(ends, FEW_SECONDS * fps, side="right")))]


def _between(movement: Array, of_all: Array) -> list[int]:
    """The frames of a movement (L,) that lie between the shares ENTRY_MOVEMENT of all."""
    # The methods leave at least one frame even of two.
    usual = np.quantile(of_all, ENTRY_MOVEMENT[0], method="lower")
    lively = np.quantile(of_all, ENTRY_MOVEMENT[1], method="higher")
    return np.flatnonzero((movement >= usual) & (movement <= lively)).tolist()


def drawn_evenly(sizes: Sequence[int], choice: int, number: int) -> int:
    """Which of some sizes is drawn, the larger the more often, and by successive choices evenly among all.

    Random draws would show half of thirty clips by twenty choices.

    Args:
        choice: a whole number of at least 0.
        number: of the draw by this choice, from 1 on.
    """
    share = (choice * GOLDEN + number * STEPS[choice // SIBLINGS % len(STEPS)]) % 1.0
    return int(np.searchsorted(np.cumsum(sizes), share * sum(sizes), side="right"))


def last_poses(model: MotionModel, features: Array) -> Array:
    """Pose embeddings (S, 24) of the frames of (T, 276) that are STATE_FRAMES before the last."""
    return model.pose_embedding.of(features[[max(0, len(features) - 1 - before) for before in STATE_FRAMES]])


def last_speed(model: MotionModel, features: Array) -> float:
    """Speed over the ground in cm/s at the last of frames (T, 276); 0 at one alone."""
    if len(features) < 2:
        return 0.0
    ground = integrate_ground(features, np.zeros(3), model.fps, model.config.layout)
    return float(ground_speeds(ground, model.fps)[-1])


def frames_behind(model: MotionModel, kind: str, near: Array) -> int:
    """Frames of a performance of a type that a body has shown already; 0 where it may as well begin one.

    Args:
        near: (S, 24) pose embeddings of its last frames (last_poses).
    """
    known = model.types.get(kind)
    if known is None or not known.performed:
        return 0
    costs = [
        np.square(pose_states(clip, np.arange(len(clip))) - near).sum(axis=(1, 2))
        for clip in known.reference_clips
    ]
    begins = min(float(cost[0]) for cost in costs)
    best = min(costs, key=lambda cost: float(cost.min()))
    return int(best.argmin()) if begins > 1.0 + SUITED * float(best.min()) else 0
