"""The route of a character along a path, planned before its first frame, and its place on it.

steering_kernel.c does both, for Python and for web pages.
"""

from __future__ import annotations

from ctypes import Array as CArray
from ctypes import Structure, addressof, byref, c_double, c_float, c_int32, c_void_p
from dataclasses import astuple, dataclass

import numpy as np

from motionkit.arrays import Array
from motionkit.control.path import SPACING, Path2D
from motionkit.control.speeds import PROFILE, ProfileSettings, lateral_limit
from motionkit.control.steering import Steering, or_nan, usual_gaits
from motionkit.control.steering_kernel import Part, doubles, steering_library
from motionkit.features.control import TRAJECTORY_COUNT, TRAJECTORY_OFFSETS, TYPE_BLEND_FRAMES
from motionkit.models.model import MotionModel


@dataclass(frozen=True)
class SearchSettings:
    """Limits of the search for the place on a path; all numbers are chosen.

    The range is short, so that a character does not cut off a loop where its path crosses itself.
    """

    behind: float = 30.0  # cm searched behind the last place
    ahead: float = 60.0  # cm searched ahead of it
    arrived: float = 8.0  # cm before a stop at which the character has reached it
    back: float = -0.9  # cosine between two directions where a path turns back on itself
    no_further: float = 1.0  # cm left, along the path, to a place beyond such a turn
    beside: float = 15.0  # cm; largest distance of the body from this place
    nearer: float = 5.0  # cm by which the way back must be nearer than the way out, before the turn


SEARCH = SearchSettings()


class _Path(Structure):
    _fields_ = (
        ("fps", c_double), ("profile", doubles(ProfileSettings)), ("search", doubles(SearchSettings)),
        *((name, c_double) for name in ("arc", "least")), ("ahead", c_double * len(TRAJECTORY_OFFSETS)),
        *((name, c_void_p) for name in "parts points tangents part speeds track weights".split()),
        *((name, c_int32) for name in "count part_count type_count blend stand".split()),
        *((name, c_int32) for name in "stands stop stood present goes_on finished".split()),
        ("trajectory", c_float * TRAJECTORY_COUNT),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Route:
    """How a character follows a path.

    Attributes:
        path: the path.
        speeds: (N,) cm/s at each of its points. They change by at most PROFILE.acceleration at stops and turns.
        track: (N,) type id at each point: a run becomes a walk where the path is slower than any recorded run.
        parts, words: the structs of its parts, and of a character at its beginning.
    """

    path: Path2D
    speeds: Array
    track: Array
    parts: CArray[Part]
    words: _Path

    @property
    def facings(self) -> Array:
        """For each part, the angle in radians from the heading of the body to its direction of travel."""
        return np.array([part.facing for part in self.parts])


def path_words(model: MotionModel) -> _Path:
    """The struct of a character of a model on a path that is not known yet."""
    stand = usual_gaits(model).stand
    return _Path(
        model.fps, astuple(PROFILE), astuple(SEARCH), type_count=len(model.types),
        blend=TYPE_BLEND_FRAMES, stand=-1 if stand is None else model.type_id(stand),
    )  # fmt: skip


def plan_route(model: MotionModel, path: Path2D, stands: bool = False) -> Route:
    """Plan speeds and types along a path; stands: the body stands before. Raises ControlError for an unknown type."""
    parts = (Part * len(path.parts))(
        *(
            Part(
                or_nan(part.speed), lateral_limit(model, part.type), part.stop, type=model.type_id(part.type)
            )
            for part in path.parts
        )
    )
    words, count = path_words(model), len(path.points)
    speeds, track = np.zeros(count), np.zeros(count, np.int32)
    words.count, words.part_count, words.parts = count, len(parts), addressof(parts)
    words.stands = stands
    for name in ("points", "tangents", "part"):
        setattr(words, name, getattr(path, name).ctypes.data)
    words.speeds, words.track = speeds.ctypes.data, track.ctypes.data
    steering = Steering(model)
    steering_library().plan_path(byref(steering.words), byref(words))
    return Route(path, speeds, track, parts, words)


class PathPlace:
    """The place of a character on its route: its arc length, and the stop at which it stands."""

    def __init__(self, route: Route) -> None:
        """Begin at the beginning of the path."""
        self.route = route
        self.words = _Path.from_buffer_copy(route.words)
        self.weights = self.type_weights(0.0)
        self.words.weights = self.weights.ctypes.data

    @property
    def arc(self) -> float:
        """Arc length in cm."""
        return float(self.words.arc)

    @property
    def finished(self) -> bool:
        """Whether the character has reached the end and no stop is left."""
        return bool(self.words.finished)

    @property
    def share(self) -> float:
        """The share of the path that is done."""
        return min(1.0, self.arc / max(self.route.path.length - SPACING, SPACING))

    def move(self, ground: Array) -> float:
        """Find the place of a body at ground (3,), its trajectory and type weights; returns the share of standing.

        It rises and falls over half a blend at a stop.
        """
        return float(steering_library().follow(byref(self.words), *ground.tolist()))

    def type_weights(self, arc: float) -> Array:
        """Type weights (N,) at an arc length: the mean over half a blend behind and half a blend ahead."""
        weights = np.zeros(self.words.type_count, np.float32)
        steering_library().path_weights(byref(self.words), arc, 0.0, weights.ctypes.data)
        return weights
