"""Chooses which recordings of a type are shown and at which frames they are entered (motion matching)."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from motionkit.arrays import Array
from motionkit.control.momentum import ground_speeds, speeds_ahead
from motionkit.control.motion_index import MotionIndex, pose_state, pose_states, state_costs
from motionkit.control.standing import about_zero, in_stance
from motionkit.features.layout import feature_layout
from motionkit.features.reference import BEFORE_EVENT, event_begins
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind, MotionType, ReferenceClip
from motionkit.motion.floor import TOES
from motionkit.motion.skeleton import FOOT_JOINTS

# Clips, each with its possible entry frames.
Entries = list[tuple[ReferenceClip, list[int]]]


@dataclass(frozen=True)
class EntrySettings:
    """Where clips are entered; all numbers are chosen, by the motion of roll-outs."""

    # Random entry frames from which the one most like the present pose is taken, at a change of type and within a type.
    # A change draws few, because among many a standing body would get a frame in which nothing happens.
    candidates: int = 24
    candidates_within: int = 200
    suited: float = 2.0  # performances that cost up to 1 plus this times the least cost are equally good
    # Quantiles of movement between which entry frames lie, and the share of the lower one that some frame of a clip
    # must exceed.
    movement: tuple[float, float] = (0.4, 0.8)
    still: float = 0.2
    seconds: float = 1.5  # of the clip that must follow an entry frame
    # Difference in speed (cm/s) between an entry of a strike or jump and the body, beyond the smallest one. A leap out
    # of a run needs the run.
    other_speed: float = 60.0
    played: float = 0.5  # largest share already played of the seconds after an entry frame
    few_seconds: float = 12.0  # of recordings of a type that `few` keeps


@dataclass(frozen=True)
class GaitSettings:
    """Where clips of gaits are entered and left, and those of standing entered; chosen by the motion of roll-outs.

    Attributes:
        seconds: of the clip that must follow an entry frame; most runs are recorded for a second.
        going: share of a gait's usual speed; a clip brakes where its next second is slower.
        pace: differences between the speed of the recording and that of the stay, as shares of the latter: the largest
            at an entry, and the one at which the recording is left.
        clips: clips of which the frame most like the present pose is entered, since one may have no such stride.
        before: frames before an entry, because a pose alone does not show how the legs swing.
        ahead: frames before the last pose is held at which a clip is left: references look ahead.
        strikes: frames to both sides within which feet are nowhere further apart than at a heel strike.
        lifts: frames after it at which the rear foot begins its step; then the body drops least.
    """

    seconds: float = 0.75
    going: float = 0.6
    pace: tuple[float, float] = (0.05, 0.15)
    clips: int = 12
    before: int = 5
    ahead: int = 15
    strikes: int = 12
    lifts: int = 10


@dataclass(frozen=True)
class MatchingSettings:
    """When to jump to a frame that suits the trajectory better; chosen. Every jump drags the feet."""

    every: int = 30  # frames between two searches, and frames that must follow in a clip
    clearly: float = 0.7  # share of the present cost that another frame must stay below


@dataclass(frozen=True)
class LeadingSettings:
    """How a gait leads to a performance; chosen by the length of flights from runs to handsprings.

    Attributes:
        ahead: frames after the beginning of the performance at which feet are compared.
        foot, speed: differences of foot joints (cm) and of speeds (cm/s) that cost as much as a pose value off by one.
    """

    ahead: tuple[int, ...] = (0, 5, 10)
    foot: float = 10.0
    speed: float = 20.0


ENTRY, GAIT, MATCHING, LEADING = EntrySettings(), GaitSettings(), MatchingSettings(), LeadingSettings()
# Multiples of GOLDEN, modulo 1, fill 0 to 1 most evenly; multiples of the STEPS do nearly as well. GOLDEN leads from
# choice to choice, and one of the STEPS from draw to draw; SIBLINGS successive choices share a step.
GOLDEN, STEPS = (math.sqrt(5.0) - 1.0) / 2.0, tuple(math.sqrt(n) % 1.0 for n in (2.0, 3.0, 7.0, 11.0))
SIBLINGS = 32


@dataclass(frozen=True)
class GaitClip:
    """Entry frames, braking and speeds of a clip of a gait or of standing.

    Attributes:
        entries: possible entry frames.
        brakes: (L,) for each frame, the next frame at which the clip brakes, or its length.
        speeds: (L,) speed in cm/s over the second after each frame.
    """

    entries: list[int]
    brakes: Array
    speeds: Array


class PlayedFrames:
    """Records which frames of which clips have been played."""

    def __init__(self, fps: float) -> None:
        self.fps = fps
        self._played: dict[ReferenceClip, Array] = {}

    def mark(self, clip: ReferenceClip, at: int, count: int) -> None:
        """Mark frames as played."""
        self._of(clip)[at : at + count] = True

    def forget(self, clips: Sequence[ReferenceClip]) -> None:
        """Mark all frames of some clips as not played."""
        for clip in clips:
            self._of(clip)[:] = False

    def next(self, clip: ReferenceClip, at: int) -> int:
        """The first frame from `at` on that has been played; the length of the clip if none has."""
        ahead = np.flatnonzero(self._of(clip)[at:])
        return at + int(ahead[0]) if len(ahead) else len(clip)

    def any(self, clip: ReferenceClip) -> bool:
        """Whether any frame of a clip has been played."""
        return bool(self._of(clip).any())

    def after(self, clip: ReferenceClip) -> Array:
        """For each frame (L,), the played share of the ENTRY.seconds after it, or of the rest of the clip."""
        frames = np.arange(len(clip))
        ends = np.minimum(frames + round(ENTRY.seconds * self.fps), len(clip))
        played = np.concatenate([[0], np.cumsum(self._of(clip))])
        return np.asarray((played[ends] - played[frames]) / (ends - frames))

    def _of(self, clip: ReferenceClip) -> Array:
        return self._played.setdefault(clip, np.zeros(len(clip), bool))


class RecordingChoice:
    """Chooses recordings for one character; the same choice gives the same recordings.

    A performance plays from its beginning, one recording after another. For other types a clip is drawn; it is more
    likely the more of it has not been played, and successive choices draw evenly. It is entered in the middle: some
    frames are drawn, and the one most like the present pose is taken. For strikes and jumps, these frames come shortly
    before one and at about the speed of the body. Nothing plays again before everything has played. A standing
    character keeps its stance: recordings are moved to it, so that they only tell it how to sway.
    """

    def __init__(self, model: MotionModel, choice: int = 0, rests: bool = False, few: bool = False) -> None:
        """Begin with nothing played.

        Args:
            rests: with a trajectory, also match frames with little movement after them.
            few: use few recordings of each type (few_clips), and enter those of gaits where a step begins.
        """
        self.model, self.choice, self.rests, self.few = model, choice, rests, few
        self.random = random.Random(int(choice))  # not of numpy
        self.draws = 0  # clips that have been drawn
        self.played = PlayedFrames(model.fps)
        self.stance: tuple[ReferenceClip, ...] = ()  # clips of standing, moved to the body's stance
        self.expected: ReferenceClip | None = None  # performance that a gait leads to
        self.pace = 0.0  # cm/s; speed of the present stay in a gait
        self._indices: dict[str, MotionIndex] = {}
        self._gait_clips: dict[ReferenceClip, GaitClip] = {}

    def set_stance(self, kind: str, stance: Array | None) -> None:
        """Move the clips of standing to a stance (24,), or to zero if it is not known yet."""
        clips = self._type(kind).reference_clips
        self.stance = about_zero(clips) if stance is None else in_stance(clips, stance)

    def leave(self, kind: str) -> None:
        """Forget the stance, because another type comes."""
        if self.stance:
            self.stance = ()
            self._indices.pop(kind, None)

    def clips(self, kind: str) -> tuple[ReferenceClip, ...]:
        """The clips of a type; those of standing are moved to the stance of the body, if it has one."""
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
        """Choose the clip and the frame at which a type is entered; None without recordings.

        Args:
            near: (S, 24) present state of the body, if known.
            behind: frames of a performance that have been shown.
            trajectory: (24,) requested trajectory, which the frame should match.
            speed: speed of the body over the ground in cm/s, if known.
            within: whether the type stays the same.
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
        found = self._as_fast(kind, self.entry_frames(kind, clips), speed)
        if self.model.kind(kind) is not MotionKind.GAIT:
            return self._drawn(found, count, near)
        if within:
            return self._strides(self._at_pace(kind, found), near)
        clip, at = self._drawn(self._stepping_off(found) if self.few else found, count, near)
        gait = self._gait_clip(kind, clip)
        self.pace = float(gait.speeds[at : max(int(gait.brakes[at]), at + 1)].mean())
        return clip, at

    def leading(
        self, kind: str, near: Array, performed: str, frames: int
    ) -> tuple[ReferenceClip, int] | None:
        """Find the clip and frame of a gait that lead in some frames to the first step of a performance.

        The performance is entered next with the recording that is led to: one that begins on the other foot would make
        the body float until its legs have changed.

        Args:
            near: (S, 24) present state of the body.
            performed: type of the performance.

        Returns:
            None if no clip is long enough.
        """
        fps, ahead = self.model.fps, np.array(LEADING.ahead)
        leads = [clip for clip in self.clips(kind) if len(clip) > frames + ahead[-1]]
        goals = [goal for goal in self.clips(performed) if len(goal) > ahead[-1]]
        if not leads or not goals:
            return None
        firsts = [np.arange(len(clip) - frames - ahead[-1]) for clip in leads]
        begins, ends, speeds = (
            np.concatenate([of(clip, at) for clip, at in zip(leads, firsts, strict=True)])
            for of in (
                lambda clip, at: np.square(pose_states(clip, at) - near).sum(axis=(1, 2)),
                lambda clip, at: clip.poses[at[:, None] + frames + ahead],
                lambda clip, at: ground_speeds(clip.ground, fps)[at + frames],
            )
        )
        layout = feature_layout(self.model.config.layout)
        feet = self.model.pose_embedding.columns(layout.block_columns("joint_positions", FOOT_JOINTS))
        costs = np.stack([
            begins
            + np.square((ends - goal.poses[ahead]) @ feet / LEADING.foot).sum(axis=(1, 2))
            + np.square((speeds - ground_speeds(goal.ground, fps)[0]) / LEADING.speed)
            for goal in goals
        ])  # fmt: skip
        number, place = np.unravel_index(int(costs.argmin()), costs.shape)
        self.expected = goals[number]
        places = [(clip, at) for clip, first in zip(leads, firsts, strict=True) for at in first.tolist()]
        return places[place]

    def better(self, kind: str, clip: ReferenceClip, at: int, trajectory: Array) -> tuple[ReferenceClip, int]:
        """Find a clip and frame that match a trajectory (24,) clearly better than the given ones; else return these."""
        index = self._index(kind)
        stay = index.first[index.clips.index(clip)] + at
        number, found = index.nearest(
            pose_state(clip, at), trajectory, MATCHING.every, stay, MATCHING.clearly
        )
        return index.clips[number], found

    def leaves(self, kind: str, clip: ReferenceClip, entered: int) -> int:
        """The frame at which a clip that was entered just now is left, if no trajectory is requested.

        A gait leaves it where it brakes, or loses the speed of the stay; other types where it has been played, but not
        within a strike or jump; performances never.
        """
        if self.model.kind(kind) is not MotionKind.GAIT:
            if clip.performed or self.model.kind(kind).steered:
                return len(clip)
            end = self.played.next(clip, entered + round(ENTRY.seconds * self.model.fps))
            outside = np.flatnonzero(clip.phases[end:] < 0.0)
            return end + int(outside[0]) if len(outside) else len(clip)
        gait = self._gait_clip(kind, clip)
        end = int(gait.brakes[min(entered, len(clip) - 1)])
        # Where the last pose is held, legs would stop in the air.
        end = min(end, max(clip.recorded - GAIT.ahead, entered + GAIT.ahead))
        other = np.abs(gait.speeds[entered:end] - self.pace) > GAIT.pace[1] * self.pace
        least = round(GAIT.seconds * self.model.fps)
        other[:least] = False
        return entered + int(other.argmax()) if other.any() else end

    def entry_frames(self, kind: str, clips: Sequence[ReferenceClip]) -> Entries:
        """Entry frames of clips of any type but performances, for each clip that has some."""
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
        """Choose, in turn, one of the recorded performances that continue the present pose about equally well.

        If the body has begun one to the left, a performance to the right would make it flip over.
        """
        suited = list(clips)
        expected, self.expected = self.expected, None
        if any(clip is expected for clip in clips):
            suited = [clip for clip in clips if clip is expected]
        elif near is not None:
            states = np.stack([pose_state(clip, behind % len(clip)) for clip in clips])
            costs = np.square(states - near).sum(axis=(1, 2))
            most = 1.0 + ENTRY.suited * costs.min()
            suited = [clip for clip, cost in zip(clips, costs, strict=True) if cost <= most]
        fresh = [clip for clip in suited if not self.played.any(clip)]
        if not fresh:
            self.played.forget(suited)
        return (fresh or suited)[self.choice % len(fresh or suited)]

    def _drawn(self, entries: Entries, count: int, near: Array | None) -> tuple[ReferenceClip, int]:
        """Draw some entry frames that have not been played, and take the one most like the present pose."""
        found = self._fresh(entries)
        clip, frames = self._next_clip(found)
        frames = self.random.sample(frames, min(count, len(frames)))
        if near is None:
            return clip, frames[0]
        states = np.stack([pose_state(clip, at) for at in frames])
        return clip, frames[int(np.square(states - near).sum(axis=(1, 2)).argmin())]

    def _next_clip(self, found: Entries) -> tuple[ReferenceClip, list[int]]:
        """Draw a clip with its entry frames, in proportion to their number."""
        self.draws += 1
        if self.choice == 0 and self.draws == 1:  # the default seed shows the most typical clip
            return found[0]
        return found[drawn_evenly([len(frames) for _, frames in found], self.choice, self.draws)]

    def _strides(self, entries: Entries, near: Array | None) -> tuple[ReferenceClip, int]:
        """Take the entry frame most like the present pose among those of a gait's clips, some of them drawn."""
        found = self._fresh(entries)
        drawn: list[tuple[float, ReferenceClip, int]] = []
        for _ in range(GAIT.clips):
            clip, frames = self._next_clip(found)
            costs = np.zeros(len(frames)) if near is None else state_costs(clip, frames, near)
            drawn.append((float(costs.min()), clip, frames[int(costs.argmin())]))
        _, clip, at = min(drawn, key=lambda each: each[0])
        return clip, at

    def _stepping_off(self, found: Entries) -> Entries:
        """Keep the entry frames at which the rear foot begins its step, as a standing body does.

        Elsewhere the recording is in the middle of a step, and the standing body lifts the foot it stands on.
        """
        layout = feature_layout(self.model.config.layout)
        ahead = layout.block_columns("joint_positions", TOES)[2::3]
        feet = self.model.pose_embedding.columns(ahead) @ [1.0, -1.0]
        kept = []
        for clip, frames in found:
            apart = np.pad(np.abs(clip.poses[: len(clip)] @ feet), GAIT.strikes, mode="edge")
            widest = sliding_window_view(apart, 2 * GAIT.strikes + 1).max(axis=-1)
            strikes = np.flatnonzero(apart[GAIT.strikes : -GAIT.strikes] >= widest)
            kept.append((clip, sorted(set((strikes + GAIT.lifts).tolist()) & set(frames))))
        return [each for each in kept if each[1]] or found

    def _as_fast(self, kind: str, found: Entries, speed: float | None) -> Entries:
        """Keep the entry frames of strikes or jumps at about the speed (cm/s) of the body.

        Other movements have time to change their speed, so all their entry frames stay.
        """
        if speed is None or not self.model.kind(kind).phased:
            return found
        gaps = [np.abs(ground_speeds(clip.ground, self.model.fps)[frames] - speed) for clip, frames in found]
        most = ENTRY.other_speed + min(float(gap.min()) for gap in gaps)
        return _kept(found, gaps, most)

    def _at_pace(self, kind: str, found: Entries) -> Entries:
        """Keep the entry frames of a gait after which its speed is that of the stay, as nearly as recorded."""
        late = [(clip, [at for at in frames if at >= GAIT.before]) for clip, frames in found]
        found = [each for each in late if each[1]] or found
        gaps = [np.abs(self._gait_clip(kind, clip).speeds[frames] - self.pace) for clip, frames in found]
        most = max(GAIT.pace[0] * self.pace, min(float(gap.min()) for gap in gaps if len(gap)))
        return _kept(found, gaps, most)

    def _fresh(self, found: Entries) -> Entries:
        """Keep the entry frames whose continuation has mostly not been played; if none is left, start over with all."""
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
        """Entry frames of a clip of a gait or of standing, and where it brakes: recorded runs end with a stop.

        A clip that is slow throughout does not brake.
        """
        if clip not in self._gait_clips:
            fps, gait, length = self.model.fps, self._type(kind).gait, len(clip)
            least, frames = min(round(GAIT.seconds * fps), length - 1), np.arange(length)
            brakes, entries = np.full(length, length), frames[: length - least]
            speeds = speeds_ahead(clip.ground, fps)
            if self.model.kind(kind) is MotionKind.GAIT and gait is not None:
                # Skip the stop at the end of recorded runs.
                going = GAIT.going * gait.speed
                slow = np.append(np.flatnonzero(speeds < going), length)
                until = slow[np.searchsorted(slow, frames)]
                if (until - frames > least).any():
                    brakes, entries = until, np.flatnonzero(until - frames > least)
                second = sliding_window_view(speeds, least)[entries]
                steady = np.abs(second - second[:, :1]).max(axis=1) <= GAIT.pace[1] * second[:, 0]
                entries = entries[steady] if steady.any() else entries
            self._gait_clips[clip] = GaitClip(entries.tolist(), brakes, speeds)
        return self._gait_clips[clip]


def few_clips(clips: tuple[ReferenceClip, ...], fps: float) -> tuple[ReferenceClip, ...]:
    """The first clips of a type, at most ENTRY.few_seconds long together but at least one; enough for first steps."""
    ends = np.cumsum([len(clip) for clip in clips])
    return clips[: max(1, int(np.searchsorted(ends, ENTRY.few_seconds * fps, side="right")))]


def drawn_evenly(sizes: Sequence[int], choice: int, number: int) -> int:
    """Draw an index with a probability in proportion to its size; successive choices draw evenly.

    Twenty choices with random draws would show only half of thirty clips.

    Args:
        choice: a whole number of at least 0.
        number: number of the draw for this choice, from 1 on.
    """
    share = (choice * GOLDEN + number * STEPS[choice // SIBLINGS % len(STEPS)]) % 1.0
    return int(np.searchsorted(np.cumsum(sizes), share * sum(sizes), side="right"))


def frames_behind(model: MotionModel, kind: str, near: Array) -> int:
    """Frames of a performance that a body has shown; 0 if its state also suits the beginning of one.

    Args:
        near: (S, 24) state of the body (last_poses).
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


def _kept(found: Entries, gaps: Sequence[Array], most: float) -> Entries:
    """Keep the entry frames whose gap is at most `most`, and the clips that have some."""
    kept = [
        (clip, [at for at, gap in zip(frames, each.tolist(), strict=True) if gap <= most])
        for (clip, frames), each in zip(found, gaps, strict=True)
    ]
    return [each for each in kept if each[1]]


def _before_events(clips: Sequence[ReferenceClip]) -> Entries:
    """Frames shortly before strikes or jumps, for each clip that has some."""
    begins = [(clip, event_begins(clip.phases)) for clip in clips]
    return [(clip, np.maximum(each - BEFORE_EVENT, 0).tolist()) for clip, each in begins if len(each)]


def _lively(clips: Sequence[ReferenceClip], least: int) -> Entries:
    """Frames with movement between the quantiles ENTRY.movement of all clips, for each clip that has some.

    In any type, a standing body is most like a standing frame, and that reference would keep it standing. A clip that
    is livelier or calmer throughout gives the frames between its own quantiles.

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
    """Frames whose movement (L,) lies between the quantiles ENTRY.movement of all movements."""
    # These quantile methods keep at least one frame even of two.
    usual = np.quantile(of_all, ENTRY.movement[0], method="lower")
    lively = np.quantile(of_all, ENTRY.movement[1], method="higher")
    return np.flatnonzero((movement >= usual) & (movement <= lively)).tolist()
