"""Plays recordings of a type in outline: where the guides of a character come from (features/guide.py)."""

from __future__ import annotations

import random
from dataclasses import dataclass

import torch
from torch import Tensor

from motionkit.features.control import TRAJECTORY_COUNT, future_trajectory
from motionkit.features.guide import GUIDE_COUNT, guide_signal
from motionkit.models.checkpoint import MotionModel, Outline

# Places a recording may be entered at, of which the one most like the present pose is taken.
CANDIDATES = 24
EVENT_CANDIDATES = 4
# A recording is entered where so many seconds of it are left; a strike so many frames before it begins.
LEAST_SECONDS = 1.5
BEFORE_EVENT = 15
# Poses are compared now and so many frames before.
STEP = 5


@dataclass(frozen=True, eq=False)
class Signals:
    """What a player asks of one character for T frames.

    Attributes:
        guide, guided: (T, 48), and (T,) 1 where it counts.
        trajectory, given: (T, 24) of a recorded performance, and (T,) 1 where it counts.
        progress: (T,) through a performance, negative for none.
    """

    guide: Tensor
    guided: Tensor
    trajectory: Tensor
    given: Tensor
    progress: Tensor

    @staticmethod
    def joined(parts: list[Signals]) -> Signals:
        """One after another."""
        return Signals(**{name: torch.cat([getattr(p, name) for p in parts]) for name in vars(parts[0])})


class OutlinePlayer:
    """Plays one recording of a type after another for one character; the same choice plays the same.

    A type that is one performance is played from its beginning and repeated. Of others a recording is
    entered in the middle: a few places are drawn, types of strikes and jumps shortly before one of these,
    and the one most like the present pose is taken.
    """

    def __init__(self, model: MotionModel, choice: int = 0) -> None:
        self.model, self.choice = model, choice
        self.random = random.Random(choice)
        self.kind = ""
        self.outline: Outline | None = None
        self.at = 0

    def begin(self, kind: str, near: Tensor | None = None, behind: int = 0) -> None:
        """Go over to a type.

        Args:
            near: (2, 16) outlines of the pose now and STEP frames before; that of what was played by default.
            behind: frames of a performance that lie behind already.
        """
        if near is None:
            near = self._present()
        outlines = self.model.outlines.get(kind, [])
        self.kind, self.outline, self.at = kind, None, 0
        if not outlines:
            return
        if self.model.performed(kind):
            self.outline = outlines[self.choice % len(outlines)]
            self.at = behind % len(self.outline)
            return
        places = self._events(outlines) or self._anywhere(outlines)
        costs = [0.0 if near is None else float((_poses(o, at) - near).norm()) for o, at in places]
        self.outline, self.at = places[costs.index(min(costs))]

    def event_frames(self) -> int:
        """Frames from here to the end of the strike or jump that comes first, zero if none comes."""
        if self.outline is None:
            return 0
        ahead = (self.outline.phases[self.at :] >= 0.0).tolist()
        if True not in ahead:
            return 0
        first = ahead.index(True)
        return ahead.index(False, first) if False in ahead[first:] else len(ahead)

    def play(self, frames: int) -> Signals:
        """Signals of the coming frames; at the end of a recording another one is entered."""
        parts: list[Signals] = []
        while frames > 0:
            if self.outline is not None and self.at >= len(self.outline):
                self.begin(self.kind)
            count = frames if self.outline is None else min(frames, len(self.outline) - self.at)
            parts.append(self._stretch(count))
            self.at += count
            frames -= count
        return Signals.joined(parts)

    def _stretch(self, count: int) -> Signals:
        outline = self.outline
        zeros = torch.zeros(count)
        if outline is None:
            return Signals(
                torch.zeros(count, GUIDE_COUNT),
                zeros,
                torch.zeros(count, TRAJECTORY_COUNT),
                zeros,
                zeros - 1.0,
            )
        frames = torch.arange(self.at, self.at + count)
        # A cartwheel to the left is as good as one to the right; the way of the recorded one decides.
        way = (
            future_trajectory(outline.ground, frames)
            if outline.performed
            else torch.zeros(count, TRAJECTORY_COUNT)
        )
        return Signals(
            guide_signal(outline.poses, frames),
            torch.full((count,), float(self.model.guides)),
            way,
            torch.full((count,), float(outline.performed)),
            outline.phases[frames],
        )

    def _present(self) -> Tensor | None:
        return None if self.outline is None else _poses(self.outline, min(self.at, len(self.outline) - 1))

    def _events(self, outlines: list[Outline]) -> list[tuple[Outline, int]]:
        """Some places shortly before a strike or jump; none for types without."""
        found = []
        for outline in outlines:
            begins = torch.nonzero((outline.phases[1:] >= 0.0) & (outline.phases[:-1] < 0.0)).flatten() + 1
            found += [(outline, max(0, int(at) - BEFORE_EVENT)) for at in begins]
        return self.random.sample(found, min(EVENT_CANDIDATES, len(found)))

    def _anywhere(self, outlines: list[Outline]) -> list[tuple[Outline, int]]:
        least = round(LEAST_SECONDS * self.model.fps)
        rooms = [max(1, len(outline) - least) for outline in outlines]
        chosen = self.random.choices(range(len(outlines)), rooms, k=CANDIDATES)
        return [(outlines[i], self.random.randrange(rooms[i])) for i in chosen]


def _poses(outline: Outline, at: int) -> Tensor:
    return outline.poses[[at, max(0, at - STEP)]]


def last_poses(model: MotionModel, features: Tensor) -> Tensor:
    """Outlines (2, 16) of the last of some frames (T, 276) and of that STEP frames before."""
    return model.outline.of(features[[-1, max(-len(features), -1 - STEP)]])
