"""Plays recordings of a type in outline: where the guides of a character come from (features/guide.py)."""

from __future__ import annotations

import random
from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array, lerp
from motionkit.features.control import TRAJECTORY_COUNT, future_trajectory
from motionkit.features.guide import GUIDE_COUNT, guide_signal
from motionkit.models.checkpoint import MotionModel, Outline
from motionkit.synthesis.places import STATE_FRAMES, Places, pose_state
from motionkit.synthesis.rollout import FrameControls

# Places a recording may be entered at, of which the one most like the present pose is taken. Few at a change of
# type, for of many the most alike to one who stands is one where nothing happens; many to go on within a type.
CANDIDATES, CANDIDATES_WITHIN = 24, 200
PAUSE = 20  # frames from the end of a performance to the beginning of the next one
BLEND = 15  # frames over which one recording goes over to the next of its type
EVENT_CANDIDATES = 4
LIVELY = 0.85  # share of the places that move less than the liveliest
# A recording is entered where so many seconds of it are left; a strike so many frames before it begins.
LEAST_SECONDS = 1.5
BEFORE_EVENT = 15
# Where the way is given, every so many frames another place is gone over to that suits it clearly better.
RECONSIDERED, CLEARLY = 20, 0.4
# A recording's feet stand where it went itself. Where characters go where their feet let them (synthesis/grip.py), so
# much of the way shown is the recording's, the rest the one asked for.
OWN_WAY = 0.5


@dataclass(frozen=True, eq=False)
class Signals:
    """What a player asks of one character for T frames.

    Attributes:
        guide, guided: (T, 72), and (T,) how many times larger than it is it is shown, 0 for not.
        trajectory, given: (T, 24) the way to show, and (T,) 1 where there is one: that of a recorded performance,
            or where a way is asked for, one between it and the recording's.
        progress: (T,) through a performance, negative for none.
    """

    guide: Array
    guided: Array
    trajectory: Array
    given: Array
    progress: Array

    @staticmethod
    def joined(parts: list[Signals]) -> Signals:
        """One after another."""
        return Signals(**{name: np.concatenate([getattr(p, name) for p in parts]) for name in vars(parts[0])})

    @staticmethod
    def side_by_side(characters: list[Signals]) -> Signals:
        """Those of B characters as one: (T, B, ...), the shorter ones going on with their last frame."""
        frames = max(len(c.progress) for c in characters)
        rows = [np.minimum(np.arange(frames), len(c.progress) - 1) for c in characters]
        pairs = list(zip(characters, rows, strict=True))
        return Signals(
            **{name: np.stack([getattr(c, name)[r] for c, r in pairs], 1) for name in vars(characters[0])}
        )

    def controls(self, frame: int, type_weights: Array) -> FrameControls:
        """What they ask of B characters at a frame, with type weights (B, N)."""
        signals = (self.trajectory, self.given, self.progress, self.guide, self.guided)
        return FrameControls(type_weights, *(values[frame] for values in signals))


class OutlinePlayer:
    """Plays one recording of a type after another for one character; the same choice plays the same.

    A type that is one performance is played from its beginning and repeated. Of others a recording is
    entered in the middle: a few places are drawn, types of strikes and jumps shortly before one of these,
    and the one most like the present pose is taken. Where a character is to go some way while it dances, places
    are sought that go such a way.
    """

    def __init__(self, model: MotionModel, choice: int = 0, own_way: float = OWN_WAY) -> None:
        """own_way: how much of a way asked for gives way to the recording's."""
        self.model, self.choice, self.own_way = model, choice, own_way
        self.random = random.Random(choice)
        self.kind = ""
        self.outline: Outline | None = None
        self.at = 0
        # The recording before, its place, and that of this one.
        self.left: tuple[Outline, int, int] | None = None
        self._places: dict[str, Places] = {}
        self._since = 0  # frames since a place was sought

    def begin(self, kind: str, near: Array | None = None, behind: int = 0, way: Array | None = None) -> None:
        """Go over to a type.

        Args:
            near: (S, 24) outlines of the pose STATE_FRAMES ago; that of what was played by default.
            behind: frames of a performance that lie behind already.
            way: (24,) the trajectory that is asked for, if the place is to suit it.
        """
        if near is None:
            near = self._present()
        outlines = self.model.outlines.get(kind, [])
        count = CANDIDATES_WITHIN if kind == self.kind else CANDIDATES
        left, place = self.outline, self.at
        self.kind, self.outline, self.at, self.left, self._since = kind, None, 0, None, 0
        if not outlines:
            return
        if self.model.performed(kind):
            self.outline = outlines[self.choice % len(outlines)]
            self.at = behind % len(self.outline)
        elif way is not None and near is not None:
            number, self.at = self._sought().nearest(near, way, RECONSIDERED)
            self.outline = outlines[number]
        else:
            self.outline, self.at = self._drawn(outlines, count, near)
        # A performance is entered as it begins: its phase and its way do not wait for the guide.
        if left is not None and not self.outline.performed:
            self.left = (left, place, self.at)

    def event_frames(self) -> int:
        """Frames from here to the end of the strike or jump that comes first, zero if none comes."""
        if self.outline is None:
            return 0
        ahead = (self.outline.phases[self.at :] >= 0.0).tolist()
        if True not in ahead:
            return 0
        first = ahead.index(True)
        return ahead.index(False, first) if False in ahead[first:] else len(ahead)

    def play(self, frames: int, ways: Array | None = None) -> Signals:
        """Signals of the coming frames; at the end of a recording another one is entered.

        ways: (frames, 24) the trajectories that are asked for, if what is played is to suit them.
        """
        parts: list[Signals] = []
        played = 0
        while played < frames:
            way = None if ways is None else ways[played]
            if self.outline is not None and self.at >= len(self.outline):
                left = self.outline
                self.begin(self.kind, way=None if self._strikes() else way)
                if left.performed:
                    parts.append(
                        self._between(left, frames - played, None if ways is None else ways[played:])
                    )
                    played += len(parts[-1].progress)
                    continue
            elif way is not None and self._since >= RECONSIDERED:
                self._reconsider(way)
            count = frames - played
            if self.outline is not None:
                count = min(count, len(self.outline) - self.at)
            if ways is not None:
                count = min(count, max(1, RECONSIDERED - self._since))
            parts.append(self._stretch(count, None if ways is None else ways[played : played + count]))
            self.at += count
            self._since += count
            played += count
        return Signals.joined(parts)

    def _reconsider(self, way: Array) -> None:
        """Go over to a place that suits the way clearly better; strikes and jumps would be kept from coming."""
        self._since = 0
        outline = self.outline
        if outline is None or self._strikes():
            return
        places = self._sought()
        stay = places.first[places.outlines.index(outline)] + self.at
        number, at = places.nearest(pose_state(outline, self.at), way, RECONSIDERED, stay, CLEARLY)
        if (places.outlines[number], at) != (outline, self.at):
            self.left = (outline, self.at, at)
            self.outline, self.at = places.outlines[number], at

    def _strikes(self) -> bool:
        """Whether the type is a performance or made of strikes or jumps."""
        return any(bool((outline.phases >= 0.0).any()) for outline in self.model.outlines.get(self.kind, []))

    def _sought(self) -> Places:
        if self.kind not in self._places:
            self._places[self.kind] = Places(self.model.outlines[self.kind])
        return self._places[self.kind]

    def _stretch(self, count: int, ways: Array | None) -> Signals:
        outline = self.outline
        zeros = np.zeros(count, np.float32)
        if outline is None:
            way = np.zeros((count, TRAJECTORY_COUNT), np.float32) if ways is None else ways
            return Signals(
                np.zeros((count, GUIDE_COUNT), np.float32),
                zeros,
                way,
                zeros + float(ways is not None),
                zeros - 1.0,
            )
        frames = np.arange(self.at, self.at + count)
        guide = guide_signal(outline.poses, frames)
        if self.left is not None:
            # The poses that follow the recording that was left go over into those of this one.
            left, place, entered = self.left
            since = frames - entered
            before = guide_signal(left.poses, place + since)
            guide = lerp(before, guide, np.minimum(since / np.float32(BLEND), 1.0)[:, None])
        way, given = self._way(outline, frames, ways)
        strength = np.full(count, self._strength(), np.float32)
        return Signals(guide, strength, way, zeros + given, outline.phases[frames])

    def _way(self, outline: Outline, frames: Array, ways: Array | None) -> tuple[Array, float]:
        """The trajectories (T, 24) to show at frames of an outline, and whether they count."""
        if ways is None and not outline.performed:
            return np.zeros((len(frames), TRAJECTORY_COUNT), np.float32), 0.0
        if ways is not None and not self.own_way:
            return ways, 1.0
        # A cartwheel to the left is as good as one to the right; the way of the recorded one decides.
        own = future_trajectory(outline.ground, frames)
        return (own if ways is None else lerp(ways, own, self.own_way)), 1.0

    def _between(self, left: Outline, frames: int, ways: Array | None) -> Signals:
        """From the end of a performance to the beginning of the next one, in no more than so many frames."""
        assert self.outline is not None
        count = min(PAUSE, frames)
        share = (np.arange(1, count + 1, dtype=np.float32) / PAUSE)[:, None]
        end, start = np.array([len(left) - 1]), np.array([0])
        guide = lerp(guide_signal(left.poses, end), guide_signal(self.outline.poses, start), share)
        if ways is None:
            way = lerp(
                future_trajectory(left.ground, end), future_trajectory(self.outline.ground, start), share
            )
        else:
            way = ways[:count]
        ones = np.ones(count, np.float32)
        return Signals(guide, self._strength() * ones, way, ones, -ones)

    def _strength(self) -> float:
        """How much larger than it is the guide is shown."""
        return self.model.guidance.get(self.kind, 1.0) if self.model.guides else 0.0

    def _present(self) -> Array | None:
        return None if self.outline is None else pose_state(self.outline, min(self.at, len(self.outline) - 1))

    def _drawn(self, outlines: list[Outline], count: int, near: Array | None) -> tuple[Outline, int]:
        """Of some places drawn the one most like the pose."""
        places = self._events(outlines) or self._anywhere(outlines, count)
        if near is None:
            return places[0]
        states = np.stack([pose_state(outline, at) for outline, at in places])
        return places[int(np.square(states - near).sum(axis=(1, 2)).argmin())]

    def _events(self, outlines: list[Outline]) -> list[tuple[Outline, int]]:
        """Some places shortly before a strike or jump; none for types without."""
        found = []
        for outline in outlines:
            begins = np.flatnonzero((outline.phases[1:] >= 0.0) & (outline.phases[:-1] < 0.0)) + 1
            found += [(outline, max(0, int(at) - BEFORE_EVENT)) for at in begins]
        return self.random.sample(found, min(EVENT_CANDIDATES, len(found)))

    def _anywhere(self, outlines: list[Outline], count: int) -> list[tuple[Outline, int]]:
        """Some places that are followed by at least the usual movement, though not the liveliest.

        Who stands is most like those who stand, in any type: he would be guided to go on standing.
        """
        least = round(LEAST_SECONDS * self.model.fps)
        movements = [outline.movement[: max(1, len(outline) - least)] for outline in outlines]
        all_movements = np.concatenate(movements)
        # Of two places one has to be left.
        usual = np.quantile(all_movements, 0.5, method="lower")
        lively = np.quantile(all_movements, LIVELY, method="higher")
        found = [
            (outline, at)
            for outline, movement in zip(outlines, movements, strict=True)
            for at in np.flatnonzero((movement >= usual) & (movement <= lively)).tolist()
        ]
        return self.random.sample(found, min(count, len(found)))


def last_poses(model: MotionModel, features: Array) -> Array:
    """Outlines (S, 24) of the frames (T, 276) that are STATE_FRAMES before the last."""
    return model.outline.of(features[[max(0, len(features) - 1 - before) for before in STATE_FRAMES]])
