"""The place of a character on its path: its arc length, and the stop at which it stands."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array
from motionkit.control.path import SPACING
from motionkit.control.plan import Route
from motionkit.features.control import TRAJECTORY_OFFSETS, TYPE_BLEND_FRAMES


@dataclass(frozen=True)
class SearchSettings:
    """Limits of the search for the place on a path; all numbers are chosen.

    The search range is short, so that a character does not cut off a loop where its path crosses itself.
    """

    behind: float = 30.0  # cm searched behind the last place
    ahead: float = 60.0  # cm searched ahead of it
    arrived: float = 8.0  # cm before a stop at which the character has reached it
    back: float = -0.9  # cosine between two directions where a path turns back on itself
    no_further: float = 1.0  # cm left, along the path, to a place beyond such a turn
    beside: float = 15.0  # cm; largest distance of the body from this place
    nearer: float = 5.0  # cm by which the way back must be nearer than the way out, before the turn


SEARCH = SearchSettings()


class PathPlace:
    """Tracks the arc length of a character on a path, and the stops ahead."""

    def __init__(self, route: Route, fps: float) -> None:
        """Begin at the beginning of the path."""
        self.route, self.path, self.fps = route, route.path, fps
        self.stops = list(route.path.stops)  # stops ahead
        self.stood: int | None = None  # frames since the character reached the present stop
        self.arc = self.least = 0.0  # cm; the search never goes back beyond `least`

    @property
    def finished(self) -> bool:
        """Whether the character has reached the end and no stop is left."""
        return self.at_end and not self.stops

    @property
    def at_end(self) -> bool:
        """Whether the character has reached the end of the path."""
        return self.arc >= self.path.length - SPACING

    @property
    def share(self) -> float:
        """The share of the path that is done."""
        return min(1.0, self.arc / max(self.path.length - SPACING, SPACING))

    def move(self, point: Array) -> None:
        """Find the place of a body that is at a point (2,)."""
        arc = self._nearest(point)
        # Where a path turns back on itself, way out and way back are equally near. A body that has no distance left to
        # a place beyond the turn is on the way back, and stays on it.
        self.arc, beyond = arc, self.ahead(TRAJECTORY_OFFSETS[:1], arc)
        (there,), (way_back,) = self.path.at(beyond)
        way = self.path.tangents[self.path.nearest(arc)]
        if float(way_back @ way) < SEARCH.back and float((there - point) @ way) < SEARCH.no_further:
            if float(np.linalg.norm(there - point)) < SEARCH.beside:
                self.least = self.arc = float(beyond[0])

    def standing(self) -> float:
        """Share of standing in the type weights of this frame; it rises and falls over half a blend at a stop."""
        if not self.stops:
            return 0.0
        place, seconds = self.stops[0]
        if self.stood is None:
            if self.arc < place - SEARCH.arrived:
                return 0.0
            self.stood = 0
        self.stood += 1
        left, half = round(seconds * self.fps) - self.stood, TYPE_BLEND_FRAMES // 2
        if left < 0:
            self.stood = None
            del self.stops[0]
            return 0.0
        return min(self.stood, left, half) / half

    def ahead(self, frames: Sequence[int], start: float) -> Array:
        """Arc lengths at some frames (sorted, from 1) ahead of an arc length, at the speeds of the path."""
        out, arc, frame = [], start, 0
        end = self.stops[0][0] if self.stops else math.inf
        for wanted in frames:
            while frame < wanted:
                step = min(5, wanted - frame)
                arc = min(arc + self.speed_at(arc) * step / self.fps, max(end, start))
                frame += step
            out.append(arc)
        return np.array(out, np.float32)

    def speed_at(self, arc: float) -> float:
        """Speed in cm/s at an arc length."""
        return float(self.route.speeds[self.path.nearest(arc)])

    def _nearest(self, point: Array) -> float:
        first = max(0, int(max(self.arc - SEARCH.behind, self.least) / SPACING))
        last = min(len(self.path.points), int((self.arc + SEARCH.ahead) / SPACING) + 2)
        away = np.linalg.norm(self.path.points[first:last] - point, axis=-1)
        nearest = first + int(away.argmin())
        # The way back must be clearly nearer than the way out.
        ways = self.path.tangents[first:last] @ self.path.tangents[self.path.nearest(self.arc)]
        if float(ways[nearest - first]) < SEARCH.back:
            there = np.flatnonzero((ways > 0.0) & (away < away.min() + SEARCH.nearer))
            nearest = first + int(there[away[there].argmin()]) if len(there) else nearest
        # Beyond the last point, arc length grows along its direction, so that the character can reach the end.
        beyond = float(((point - self.path.points[-1]) * self.path.tangents[-1]).sum())
        arc = nearest * SPACING
        return arc + max(0.0, beyond) if nearest == len(self.path.points) - 1 else arc
