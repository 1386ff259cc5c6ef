"""Where a character is on a path that it follows: its arc length, and the stop it stands at."""

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
    """Where the place on a path is sought; all numbers are chosen. A path that crosses itself is not cut short."""

    behind: float = 30.0  # cm behind the last place
    ahead: float = 60.0  # cm ahead of it
    arrived: float = 8.0  # cm before a stop at which it has been reached
    back: float = -0.9  # cosine between two directions where a path turns back on itself
    no_further: float = 1.0  # cm that a body still has to go to a place beyond such a turn
    beside: float = 15.0  # cm that this place may lie beside it
    nearer: float = 5.0  # cm by which the way back has to be nearer than the way there before the turn


SEARCH = SearchSettings()


class PathPlace:
    """The arc length of a character on a path, and the stops that are still to come."""

    def __init__(self, route: Route, fps: float) -> None:
        """Begin at the beginning of the path."""
        self.route, self.path, self.fps = route, route.path, fps
        self.stops = list(route.path.stops)  # those to come
        self.stood: int | None = None  # frames since the stop was reached
        self.arc = self.least = 0.0  # cm; what lies before the least is behind, and no longer sought

    @property
    def finished(self) -> bool:
        """Whether the end has been reached, and no stop is to come."""
        return self.at_end and not self.stops

    @property
    def at_end(self) -> bool:
        """Whether the end of the path has been reached."""
        return self.arc >= self.path.length - SPACING

    @property
    def share(self) -> float:
        """The share of the path that lies behind."""
        return min(1.0, self.arc / max(self.path.length - SPACING, SPACING))

    def move(self, point: Array) -> None:
        """Find the place of a body that is at a point (2,)."""
        arc = self._nearest(point)
        # Where a path turns back on itself, the way there is as near as the way back: a body that has no further to go
        # to a place beyond the turn is on the way back, and stays there.
        self.arc, beyond = arc, self.ahead(TRAJECTORY_OFFSETS[:1], arc)
        (there,), (way_back,) = self.path.at(beyond)
        way = self.path.tangents[self.path.nearest(arc)]
        if float(way_back @ way) < SEARCH.back and float((there - point) @ way) < SEARCH.no_further:
            if float(np.linalg.norm(there - point)) < SEARCH.beside:
                self.least = self.arc = float(beyond[0])

    def standing(self) -> float:
        """Share of standing still in this frame's type: it comes and goes over half a blend around a stop."""
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
        """Arc lengths frames (sorted, from 1) ahead of an arc at the wanted speeds, part by part."""
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
        # The way back is no better than the way there for being nearer by a little.
        ways = self.path.tangents[first:last] @ self.path.tangents[self.path.nearest(self.arc)]
        if float(ways[nearest - first]) < SEARCH.back:
            there = np.flatnonzero((ways > 0.0) & (away < away.min() + SEARCH.nearer))
            nearest = first + int(there[away[there].argmin()]) if len(there) else nearest
        # Past the last point the way on is counted along its direction, so that the end can be reached.
        beyond = float(((point - self.path.points[-1]) * self.path.tangents[-1]).sum())
        arc = nearest * SPACING
        return arc + max(0.0, beyond) if nearest == len(self.path.points) - 1 else arc
