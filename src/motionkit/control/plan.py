"""The plan of a character, made once before its first frame: motion types in time or along a path, and keys.

plan_types, plan_keys and plan_path make a Plan from a user's request. Controls, start poses and stances read it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from motionkit.arrays import Array
from motionkit.control.character_start import StartState
from motionkit.control.keys import Key, check_length
from motionkit.control.path import SPACING, Path2D
from motionkit.control.path_place import Route, plan_route
from motionkit.control.script import TypePart
from motionkit.features.control import TYPE_BLEND_FRAMES, blend_types
from motionkit.features.reference import PAUSE
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind


@dataclass(frozen=True)
class Segment:
    """One motion type in a plan.

    Attributes:
        type: its name.
        seconds: its duration; on a path, at the speeds of the plan.
        first: its first row in the plan's track.
        count: number of its rows.
        stops: whether the body stops here after another type and then follows recordings of standing.
    """

    type: str
    seconds: float
    first: int
    count: int
    stops: bool = False


@dataclass(frozen=True)
class StandingSpan:
    """A span of frames, from first to end (exclusive) or to the end of the plan, in which the body stands."""

    type: str
    first: int
    end: int | None


@dataclass(frozen=True, eq=False)
class Plan:
    """What one character does.

    Attributes:
        segments: motion types one after another.
        track: (T,) type id of every frame, or of every point of a path.
        type_count: number of motion types of the model.
        seconds: duration of the plan.
        start_state: what the frames before the motion show; None if unknown.
        keys: keys to meet.
        route: the path to follow; None for types in time.
        blend: length in frames of a change of type.
    """

    segments: tuple[Segment, ...]
    track: Array
    type_count: int
    seconds: float
    start_state: StartState | None = None
    keys: tuple[Key, ...] = ()
    route: Route | None = None
    blend: int = TYPE_BLEND_FRAMES

    @property
    def parts(self) -> tuple[TypePart, ...]:
        """The types and their durations."""
        return tuple(TypePart(segment.type, segment.seconds) for segment in self.segments)

    @cached_property
    def weights(self) -> Array:
        """Type weights (T, N) of every frame, blended at each change of type; for plans in time."""
        return blend_types(self.track, self.type_count, self.blend)

    @property
    def standing_spans(self) -> list[StandingSpan]:
        """Where the body stands after other types."""
        out = []
        for number, segment in enumerate(self.segments):
            if segment.stops:
                others = (each.first for each in self.segments[number:] if each.type != segment.type)
                out.append(StandingSpan(segment.type, segment.first, next(others, None)))
        return out


def plan_types(model: MotionModel, parts: Sequence[TypePart], start_state: StartState | None = None) -> Plan:
    """Plan motion types one after another; performances are whole, less the frames of the first already shown.

    Raises:
        ControlError: for an unknown type.
    """
    segments: list[Segment] = []
    ids = [model.type_id(part.type) for part in parts]
    first, before = 0, None
    for part in whole_performances(model, parts, 0 if start_state is None else start_state.behind):
        frames = max(1, round(part.seconds * model.fps))
        stops = before not in (None, part.type) and _stops(model, part.type)
        segments.append(Segment(part.type, part.seconds, first, frames, stops))
        first, before = first + frames, part.type
    track = np.repeat(ids, [segment.count for segment in segments])
    seconds = sum(segment.seconds for segment in segments)
    return Plan(tuple(segments), track, len(model.types), seconds, start_state)


def plan_keys(plan: Plan, keys: tuple[Key, ...]) -> Plan:
    """Add keys to a plan; raises ControlError for a key after its end."""
    check_length(keys, plan.seconds)
    return replace(plan, keys=keys)


def plan_path(model: MotionModel, path: Path2D, stands: bool = False) -> Plan:
    """Plan a path, for a body that stands before or not: the type and the speed at each of its points.

    Raises:
        ControlError: for an unknown type.
    """
    route = plan_route(model, path, stands)
    edges = np.searchsorted(path.part, np.arange(len(path.parts) + 1)).tolist()
    seconds = SPACING / route.speeds
    segments = [
        Segment(part.type, float(seconds[first:end].sum()) + part.stop, first, end - first)
        for part, first, end in zip(path.parts, edges, edges[1:], strict=False)
    ]
    takes = float(seconds.sum()) + sum(part.stop for part in path.parts)
    return Plan(tuple(segments), route.track, len(model.types), takes, route=route)


def whole_performances(model: MotionModel, parts: Sequence[TypePart], behind: int = 0) -> list[TypePart]:
    """Shorten parts to whole performances; the next part gets the time that is left.

    Otherwise the type could change while the body is upside down, and the body would have to flip over. The last part
    keeps its time, and so does a part shorter than a performance. A performance right after another begins after a
    pause; if only the time of this pause is missing, the part gets it.

    Args:
        behind: frames of the first part's performance that have been shown.
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
            whole = (
                round((first + again * int((seconds - first + frame / 2) / again)) * model.fps) / model.fps
            )
            seconds, left = whole, seconds - whole
        out.append(TypePart(part.type, seconds))
    return out


def _stops(model: MotionModel, kind: str) -> bool:
    """Whether a type is standing and has recordings to follow."""
    idle = model.kind(kind) is MotionKind.STANCE
    return idle and model.uses_references and bool(model.types[kind].reference_clips)
