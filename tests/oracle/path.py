"""What steering_kernel.c does with paths, in numpy: even points, speeds and types, and a character's place."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from motionkit.arrays import Array, normalized
from motionkit.control.path import SPACING, Path2D, PathPart
from motionkit.control.path_place import SEARCH
from motionkit.control.speeds import PROFILE, lateral_limit
from motionkit.control.steering import WALK_SPEED, usual_gaits
from motionkit.features.control import TRAJECTORY_OFFSETS, TYPE_BLEND_FRAMES
from motionkit.models.model import MotionModel
from motionkit.motion.rotations import rotate_ground
from oracle.steering import steered_type

BLEND_SAMPLES = 16


def even_path(parts: Sequence[PathPart]) -> Path2D:
    """Join parts end to end: points SPACING apart with their directions and parts."""
    corners = np.concatenate([part.points for part in parts])
    arc = np.concatenate([[0.0], np.linalg.norm(np.diff(corners, axis=0), axis=-1).cumsum()])
    ends = arc[np.cumsum([len(part.points) for part in parts]) - 1]
    wanted = np.arange(max(3, int(arc[-1] / SPACING) + 1)) * SPACING
    right = np.clip(np.searchsorted(arc, np.minimum(wanted, arc[-1])), 1, len(arc) - 1)
    size = np.maximum(arc[right] - arc[right - 1], 1e-9)
    share = np.clip((wanted - arc[right - 1]) / size, 0.0, 1.0)[:, None]
    points = corners[right - 1] * (1 - share) + corners[right] * share
    ahead = np.concatenate([points[1:], points[-1:]]) - np.concatenate([points[:1], points[:-1]])
    part = np.minimum(np.searchsorted(ends, wanted), len(parts) - 1)
    return Path2D(points, normalized(ahead), part, tuple(parts))


def part_speed(model: MotionModel, part: PathPart) -> float:
    """The usual speed of a part's type, or the wished one within its recorded range."""
    gait, span = model.types[part.type].gait, model.speed_range(part.type)
    if part.speed is None:
        return max(PROFILE.usual if gait is None else gait.speed, PROFILE.slowest)
    return float(np.clip(max(part.speed, PROFILE.slowest), *(span or (0.0, math.inf))))


class PathInNumpy:
    """A character on a path, as motionkit.control.path_place plans and follows it."""

    def __init__(self, model: MotionModel, path: Path2D) -> None:
        self.model, self.path = model, path
        ends = np.searchsorted(path.part, np.arange(len(path.parts)), side="right") * SPACING
        self.length = (len(path.points) - 1) * SPACING
        self.stops = [
            (min(end, self.length), p.stop) for end, p in zip(ends, path.parts, strict=True) if p.stop
        ]
        self.speeds = self.speed_profile()
        self.track = self.shown_types()
        self.stood: int | None = None
        self.arc = self.least = 0.0

    def speed_profile(self) -> Array:
        """Speed (N,) at each point; its square changes evenly at constant acceleration."""
        path = self.path
        speeds = np.array([part_speed(self.model, part) for part in path.parts])[path.part]
        beside, most = int(PROFILE.beside_turn), len(path.points) - 1
        first = np.maximum(np.arange(most + 1) - beside, 0)
        last = np.minimum(np.arange(most + 1) + beside, most)
        turns = np.arccos(np.clip((path.tangents[first] * path.tangents[last]).sum(axis=-1), -1.0, 1.0))
        lateral = np.array([lateral_limit(self.model, part.type) for part in path.parts])[path.part]
        speeds = np.minimum(speeds, np.sqrt(lateral * (last - first) * SPACING / np.maximum(turns, 1e-6)))
        for place, _ in self.stops:
            speeds[self.nearest(place)] = PROFILE.creep
        slope = 2.0 * PROFILE.acceleration * SPACING * np.arange(len(speeds))
        squares = np.minimum.accumulate(speeds * speeds - slope) + slope
        return np.sqrt(np.minimum.accumulate((squares + slope)[::-1])[::-1] - slope)

    def shown_types(self) -> Array:
        """The type (N,) at each point: a run becomes a walk where the path is slower than any recorded run."""
        model, path = self.model, self.path
        shown = np.array([model.type_id(part.type) for part in path.parts])[path.part]
        walk = steered_type(model, (0.0, WALK_SPEED), 0.0)
        slower = model.speed_range(walk)
        for number, part in enumerate(path.parts):
            gait, span = model.types[part.type].gait, model.speed_range(part.type)
            if gait and span and slower and gait.runs and slower[0] < span[0]:
                slow = self.speeds < PROFILE.too_slow * span[0]
                shown[(path.part == number) & slow] = model.type_id(walk)
        return shown

    def nearest(self, arc: Array | float) -> Array:
        """Index (...) of the point nearest to arc lengths (...)."""
        return np.clip(np.round(arc / SPACING), 0, len(self.path.points) - 1).astype(np.int64)

    def at(self, arc: Array) -> tuple[Array, Array]:
        """Points and unit directions (..., 2) at arc lengths (...); straight on beyond the end."""
        points, tangents = self.path.points, self.path.tangents
        index = np.clip(np.floor(arc / SPACING), 0, len(points) - 2).astype(np.int64)
        share = np.clip(arc / SPACING - index, 0.0, 1.0)[..., None]
        beyond = np.maximum(arc - self.length, 0.0)[..., None]
        place = points[index] * (1 - share) + points[index + 1] * share
        way = tangents[index] * (1 - share) + tangents[index + 1] * share
        return place + beyond * tangents[-1], normalized(way)

    def follow(self, ground: Array) -> tuple[float, Array, Array]:
        """The share of standing, the trajectory (24,) and the type weights (N,) of a body at ground (3,)."""
        self.move(ground[:2])
        standing = self.standing()
        ahead = self.ahead(TRAJECTORY_OFFSETS, self.arc)
        points, tangents = self.at(ahead)
        gaits = [self.model.types[part.type].gait for part in self.path.parts]
        facings = np.array([0.0 if gait is None else gait.facing for gait in gaits])
        positions = rotate_ground(-ground[2], points - ground[:2])
        directions = rotate_ground(-ground[2] - facings[self.path.part[self.nearest(ahead)]], tangents)
        trajectory = np.concatenate([positions.reshape(-1), directions.reshape(-1)])
        return standing, trajectory, self.type_weights(self.arc, standing)

    def move(self, point: Array) -> None:
        """Find the place of a body that is at a point (2,), on the way out or on the way back."""
        arc = self.nearest_arc(point)
        self.arc, beyond = arc, self.ahead(TRAJECTORY_OFFSETS[:1], arc)
        (there,), (way_back,) = self.at(beyond)
        way = self.path.tangents[self.nearest(arc)]
        if float(way_back @ way) < SEARCH.back and float((there - point) @ way) < SEARCH.no_further:
            if float(np.linalg.norm(there - point)) < SEARCH.beside:
                self.least = self.arc = float(beyond[0])

    def nearest_arc(self, point: Array) -> float:
        """The arc length nearest to a point (2,), near the last one."""
        points, tangents = self.path.points, self.path.tangents
        first = max(0, int(max(self.arc - SEARCH.behind, self.least) / SPACING))
        last = min(len(points), int((self.arc + SEARCH.ahead) / SPACING) + 2)
        away = np.linalg.norm(points[first:last] - point, axis=-1)
        nearest = first + int(away.argmin())
        ways = tangents[first:last] @ tangents[self.nearest(self.arc)]
        if float(ways[nearest - first]) < SEARCH.back:
            there = np.flatnonzero((ways > 0.0) & (away < away.min() + SEARCH.nearer))
            nearest = first + int(there[away[there].argmin()]) if len(there) else nearest
        beyond = float(((point - points[-1]) * tangents[-1]).sum())
        return nearest * SPACING + (max(0.0, beyond) if nearest == len(points) - 1 else 0.0)

    def standing(self) -> float:
        """Share of standing; it rises and falls over half a blend at a stop."""
        if not self.stops:
            return 0.0
        place, seconds = self.stops[0]
        if self.stood is None and self.arc < place - SEARCH.arrived:
            return 0.0
        self.stood = (self.stood or 0) + 1
        left, half = round(seconds * self.model.fps) - self.stood, TYPE_BLEND_FRAMES // 2
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
                arc = min(arc + self.speeds[self.nearest(arc)] * step / self.model.fps, max(end, start))
                frame += step
            out.append(arc)
        return np.array(out)

    def type_weights(self, arc: float, standing: float = 0.0) -> Array:
        """Type weights (N,) at an arc length: the mean over half a blend behind and half a blend ahead."""
        reach = self.speeds[self.nearest(arc)] * (TYPE_BLEND_FRAMES // 2) / self.model.fps
        kinds = self.track[self.nearest(np.linspace(arc - reach, arc + reach, BLEND_SAMPLES))]
        weights = np.eye(len(self.model.types))[kinds].mean(axis=0)
        stand = usual_gaits(self.model).stand
        if stand is not None:
            weights *= 1.0 - standing
            weights[self.model.type_id(stand)] += standing
        return weights
