"""The plan of a character, made once before its first frame: motion types in time or along a path, and keys.

plan_types, plan_keys and plan_path make a Plan from a user's request. Controls, start poses and stances read it.
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
        seconds: its duration; on a path, at the speeds of the plan.
        first: its first row in the plan's track.
        count: number of its rows.
        settles: whether the body stops here after another type and then follows recordings of standing.
    """

    type: str
    seconds: float
    first: int
    count: int
    settles: bool = False


@dataclass(frozen=True)
class Stand:
    """A span of frames, from first to end (exclusive) or to the end of the plan, in which the body stands."""

    type: str
    first: int
    end: int | None


@dataclass(frozen=True, eq=False)
class Route:
    """How a character follows a path.

    Attributes:
        path: the path.
        speeds: (N,) cm/s at each of its points.
        facings: for each part, the angle in radians from the heading of the body to its direction of travel.
        stand: type id of standing at stops; None if the model has no such type.
    """

    path: Path2D
    speeds: Array
    facings: Array
    stand: int | None


@dataclass(frozen=True, eq=False)
class Plan:
    """What one character does.

    Attributes:
        segments: motion types one after another.
        track: (T,) type id of every frame, or of every point of a path.
        type_count: number of motion types of the model.
        seconds: duration of the plan.
        shown: what the frames before the motion show; None if unknown.
        keys: keys to meet.
        route: the path to follow; None for types in time.
        blend: length in frames of a change of type.
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
        """The types and their durations."""
        return tuple(TypePart(segment.type, segment.seconds) for segment in self.segments)

    @cached_property
    def weights(self) -> Array:
        """Type weights (T, N) of every frame, blended at each change of type; for plans in time."""
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
    """Plan motion types one after another; performances are whole, less the frames of the first already shown.

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
    """Add keys to a plan; raises ControlError for a key after its end."""
    check_length(keys, plan.seconds)
    return replace(plan, keys=keys)


def plan_path(model: MotionModel, path: Path2D) -> Plan:
    """Plan a path: the type and the speed at each of its points.

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
            whole = round((first + again * int((seconds - first) / again)) * model.fps) / model.fps
            seconds, left = whole, seconds - whole
        out.append(TypePart(part.type, seconds))
    return out


def _settles(model: MotionModel, kind: str) -> bool:
    """Whether a type is standing and has recordings to follow."""
    stands = model.kind(kind) is MotionKind.STANCE
    return stands and model.uses_references and bool(model.types[kind].reference_clips)
