"""What a character is to do, decided once before its first frame: motion types in time or along a path, and keys.

plan_types, plan_keys and plan_path make a Plan from what a user asks for. Controls, start poses and stances read it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from motionkit.arrays import Array
from motionkit.control.keys import Key, check_length
from motionkit.control.opening import Shown
from motionkit.control.path import SPACING, Path2D
from motionkit.control.script import TypePart
from motionkit.control.speeds import shown_types, speed_profile
from motionkit.control.steering import usual_gaits
from motionkit.features.control import TYPE_BLEND_FRAMES, blend_types
from motionkit.features.reference import PAUSE
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind


@dataclass(frozen=True)
class Segment:
    """One motion type in a plan.

    Attributes:
        type: its name.
        seconds: how long it is shown; on a path at the speeds of the plan.
        first: the first of its rows in the plan's track.
        count: its rows.
        settles: whether a body that has done something else comes to a stand here, and is shown recordings then.
    """

    type: str
    seconds: float
    first: int
    count: int
    settles: bool = False


@dataclass(frozen=True)
class Stand:
    """A body stands in a type from one frame up to another (exclusive), or to the end."""

    type: str
    first: int
    end: int | None


@dataclass(frozen=True, eq=False)
class Route:
    """How a path is gone along.

    Attributes:
        path: the path.
        speeds: (N,) cm/s at each of its points.
        facings: radians from where the body faces to where it goes, for each part.
        stand: the type id of standing at stops; None where the model has no such type.
    """

    path: Path2D
    speeds: Array
    facings: Array
    stand: int | None


@dataclass(frozen=True, eq=False)
class Plan:
    """What one character is to do.

    Attributes:
        segments: motion types one after another.
        track: (T,) type id of every frame; on a path of every point.
        type_count: motion types of the model.
        seconds: how long the plan takes.
        shown: the frames before; None where they are not known.
        keys: poses to meet.
        route: the path that is followed; None where types follow one another in time.
        blend: frames that a change of type takes.
    """

    segments: tuple[Segment, ...]
    track: Array
    type_count: int
    seconds: float
    shown: Shown | None = None
    keys: tuple[Key, ...] = ()
    route: Route | None = None
    blend: int = TYPE_BLEND_FRAMES

    @property
    def parts(self) -> tuple[TypePart, ...]:
        """The types and their seconds."""
        return tuple(TypePart(segment.type, segment.seconds) for segment in self.segments)

    @cached_property
    def weights(self) -> Array:
        """Type weights (T, N) of every frame of a plan in time, blended at each change of type."""
        return blend_types(self.track, self.type_count, self.blend)

    @property
    def stands(self) -> list[Stand]:
        """Where the body stands after other types."""
        out = []
        for number, segment in enumerate(self.segments):
            if segment.settles:
                others = (each.first for each in self.segments[number:] if each.type != segment.type)
                out.append(Stand(segment.type, segment.first, next(others, None)))
        return out


def plan_types(model: MotionModel, parts: Sequence[TypePart], shown: Shown | None = None) -> Plan:
    """Plan motion types one after another; performances are shown whole, less what has been shown of the first.

    Raises:
        ControlError: for an unknown type.
    """
    segments: list[Segment] = []
    ids = [model.type_id(part.type) for part in parts]
    first, before = 0, None
    for part in whole_performances(model, parts, 0 if shown is None else shown.behind):
        frames = max(1, round(part.seconds * model.fps))
        settles = before not in (None, part.type) and _settles(model, part.type)
        segments.append(Segment(part.type, part.seconds, first, frames, settles))
        first, before = first + frames, part.type
    track = np.repeat(ids, [segment.count for segment in segments])
    seconds = sum(segment.seconds for segment in segments)
    return Plan(tuple(segments), track, len(model.types), seconds, shown)


def plan_keys(plan: Plan, keys: tuple[Key, ...]) -> Plan:
    """The plan with keys to meet; raises ControlError for one beyond its end."""
    check_length(keys, plan.seconds)
    return replace(plan, keys=keys)


def plan_path(model: MotionModel, path: Path2D) -> Plan:
    """Plan a path, with the type and the speed at each of its points.

    Raises:
        ControlError: for an unknown type.
    """
    speeds = speed_profile(model, path)
    track = shown_types(model, path, speeds)
    gaits = [model.types[part.type].gait for part in path.parts]
    facings = np.array([0.0 if gait is None else gait.facing for gait in gaits], np.float32)
    stand = usual_gaits(model).stand
    edges = np.searchsorted(path.part, np.arange(len(path.parts) + 1)).tolist()
    seconds = SPACING / speeds
    segments = [
        Segment(part.type, float(seconds[first:end].sum()) + part.stop, first, end - first)
        for part, first, end in zip(path.parts, edges, edges[1:], strict=False)
    ]
    route = Route(path, speeds, facings, None if stand is None else model.type_id(stand))
    takes = float(seconds.sum()) + sum(stop for _, stop in path.stops)
    return Plan(tuple(segments), track, len(model.types), takes, route=route)


def whole_performances(model: MotionModel, parts: Sequence[TypePart], behind: int = 0) -> list[TypePart]:
    """The parts with whole performances: what is left of their time goes to the next part.

    A body whose type changes while it is upside down has no way to go on but to flip over. The last part keeps its
    time, and so does one that is shorter than a performance. A performance after another begins after a pause, and gets
    the time of the pause besides where it would lack it.

    Args:
        behind: frames of the first part's performance that have been shown already.
    """
    out, left, ended = [], 0.0, False
    pause, frame = PAUSE / model.fps, 1.0 / model.fps
    for number, part in enumerate(parts):
        seconds, left = round(part.seconds * model.fps) / model.fps + left, 0.0
        performed = model.kind(part.type) is MotionKind.PERFORMANCE
        length = model.phase_seconds(part.type) if performed else 0.0
        first = length - (behind / model.fps if number == 0 else 0.0)
        if length and ended:
            first += pause
            seconds = first if first - pause - frame < seconds < first else seconds
        ended = bool(length) and seconds > first - frame
        if length and first > 0.0 and number + 1 < len(parts) and seconds > first:
            again = length + pause
            whole = round((first + again * int((seconds - first) / again)) * model.fps) / model.fps
            seconds, left = whole, seconds - whole
        out.append(TypePart(part.type, seconds))
    return out


def _settles(model: MotionModel, kind: str) -> bool:
    """Whether a type is one of standing that recordings are shown of."""
    stands = model.kind(kind) is MotionKind.STANCE
    return stands and model.uses_references and bool(model.types[kind].reference_clips)
