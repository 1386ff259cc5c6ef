"""Trajectory distance: how closely the root's ground track follows a path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array, length
from motionkit.errors import MotionkitError
from motionkit.metrics.value import MetricSettings, MetricValue

_BRANCHES = 4  # boxes within a box around segments of a path
_COVERAGE_STEP = 1.0  # cm between samples of the path
_MOST_SAMPLES = 100_000  # samples of the path; on a path longer than a kilometre they are further apart
FAILS_BEYOND = (20, 50)  # cm from a target, from which on papers count it as missed
_PAIRS = 2**16  # points and boxes compared at once


@dataclass(frozen=True, eq=False)
class TrajectoryDistance:
    """The distance between a track and a path.

    Attributes:
        distances: (T,) distance of each point of the track to the nearest point of the path, cm.
        coverage: share of the path's length that is within the tolerance of the track.
        tolerance: cm from the track within which the path is covered.
    """

    distances: Array
    coverage: float
    tolerance: float

    @property
    def mean(self) -> float:
        """Mean nearest distance in cm per frame, the paper's trajectory distance."""
        return float(self.distances.mean())

    @property
    def max(self) -> float:
        """Largest nearest distance in cm."""
        return float(self.distances.max())

    def values(self) -> tuple[MetricValue, MetricValue, MetricValue]:
        """Mean, maximum and coverage as metric values."""
        return (
            MetricValue("path-mean", self.mean, "cm"),
            MetricValue("path-max", self.max, "cm"),
            MetricValue("path-coverage", self.coverage, "", {"tolerance_cm": self.tolerance}),
        )


def ground_track(root_positions: Array) -> Array:
    """The ground track (T, 2), x and z, of root positions (T, 3)."""
    return root_positions[..., [0, 2]]


def distance_to_path(points: Array, path: Array) -> Array:
    """Distance (T,) from points (T, 2) to the nearest point on the polyline path (N, 2).

    Raises:
        MotionkitError: either is empty or has another shape.
    """
    points, path = _checked(points, "track"), _checked(path, "path")
    if len(path) == 1:
        return np.linalg.norm(points - path, axis=-1)
    # Boxes around segments that lie together, and boxes around these: only what is in a box nearer to a point than the
    # nearest place found so far is looked at. So a way that is walked many times costs little more than one.
    order = _side_by_side(path[:-1] + path[1:])
    start, end = path[:-1][order], path[1:][order]
    levels = [(start, np.minimum(start, end), np.maximum(start, end))]
    while len(levels[-1][0]) > 1:
        places, low, high = levels[-1]
        firsts = np.arange(0, len(places), _BRANCHES)
        levels.append(
            (places[::_BRANCHES], np.minimum.reduceat(low, firsts), np.maximum.reduceat(high, firsts))
        )
    nearest = np.full(len(points), np.inf)
    waiting = [(np.arange(len(points)), np.zeros(len(points), np.int64), len(levels) - 1)]
    while waiting:  # pairs of a point and a box
        which, box, level = waiting.pop()
        if len(which) > _PAIRS:
            half = len(which) // 2
            waiting += [(which[half:], box[half:], level), (which[:half], box[:half], level)]
            continue
        places, low, high = levels[level]
        np.minimum.at(nearest, which, length(points[which] - places[box]))
        outside = np.maximum(np.maximum(low[box] - points[which], points[which] - high[box]), 0.0)
        near = length(outside) < nearest[which]
        which, box = which[near], box[near]
        if level:
            inner = (box[:, None] * _BRANCHES + np.arange(_BRANCHES)).ravel()
            there = inner < len(levels[level - 1][0])
            waiting.append((which.repeat(_BRANCHES)[there], inner[there], level - 1))
        else:
            np.minimum.at(nearest, which, _distance_to_segments(points[which], start[box], end[box]))
    return nearest


def _side_by_side(places: Array) -> Array:
    """An order (N,) of places (N, 2) in which neighbours lie together: halves, quarters and so on of the ground."""
    order = np.arange(len(places))
    size = 1 << len(places).bit_length()
    while size > 1:
        parts, firsts = np.arange(len(places)) // size, np.arange(0, len(places), size)
        mine = places[order]
        wide = np.maximum.reduceat(mine, firsts) - np.minimum.reduceat(mine, firsts)
        along = np.where((wide[:, 0] > wide[:, 1])[parts], mine[:, 0], mine[:, 1])
        order = order[np.lexsort((along, parts))]
        size //= 2
    return order


def _distance_to_segments(points: Array, start: Array, end: Array) -> Array:
    """Distance (T,) from points (T, 2) to a segment each, from start to end (T, 2)."""
    along, offset = end - start, points - start
    share = np.clip((offset * along).sum(-1) / np.maximum((along * along).sum(-1), 1e-12), 0.0, 1.0)
    return length(offset - share[:, None] * along)


def trajectory_distance(
    track: Array, path: Array, tolerance: float = MetricSettings.path_tolerance
) -> TrajectoryDistance:
    """Distance between a ground track (T, 2) and a path (N, 2), both x, z in cm.

    Distances are to the segments of the path, so its sampling does not matter. Coverage is the share of the path
    within `tolerance` cm of the track. A body that stands still on the path has distance zero and almost no coverage.

    Raises:
        MotionkitError: either is empty, or the tolerance is not positive.
    """
    if not tolerance > 0:
        raise MotionkitError(f"the path tolerance must be above 0 cm, found {tolerance:g}")
    distances = distance_to_path(track, path)
    covered = distance_to_path(_sampled(_checked(path, "path")), track) <= tolerance
    return TrajectoryDistance(distances, float(covered.astype(np.float64).mean()), tolerance)


def location_errors(track: Array, target: Array) -> tuple[MetricValue, ...]:
    """Errors of where the root (T, 2) is beside where it was to be (T, 2) in the same frame, both x, z in cm.

    "location-mean" is their mean distance, "location-20" and "-50" the share of frames further away than 20 and 50 cm,
    "trajectory-20" and "-50" are 1 if any frame is: over many pairs, their means are the shares of failed trajectories
    (Karunratanakul et al. 2023; Xie et al. 2024).

    Raises:
        MotionkitError: the lengths differ.
    """
    track, target = _checked(track, "track"), _checked(target, "path")
    if len(track) != len(target):
        raise MotionkitError(f"expected tracks of one length, found {len(track)} and {len(target)} frames")
    away = np.linalg.norm(track - target, axis=-1)
    shares = {limit: float((away > limit).mean()) for limit in FAILS_BEYOND}
    return (
        MetricValue("location-mean", float(away.mean()), "cm"),
        *(MetricValue(f"location-{limit}", share, "") for limit, share in shares.items()),
        *(MetricValue(f"trajectory-{limit}", float(share > 0.0), "") for limit, share in shares.items()),
    )


def _sampled(path: Array) -> Array:
    """Points (M, 2) evenly along a path (N, 2), ends included, _COVERAGE_STEP apart but at most _MOST_SAMPLES."""
    lengths = np.linalg.norm(np.diff(path, axis=0), axis=-1)
    arc = np.concatenate([[0.0], lengths.cumsum()])
    total = float(arc[-1])
    if total == 0.0:
        return path[:1]
    count = min(max(2, round(total / _COVERAGE_STEP) + 1), _MOST_SAMPLES)
    samples = np.linspace(0.0, total, count)
    return np.stack([np.interp(samples, arc, column) for column in path.T], axis=-1)


def _checked(points: Array, what: str) -> Array:
    if points.ndim != 2 or points.shape[1] != 2 or len(points) == 0:
        raise MotionkitError(f"expected a {what} of shape (N, 2) with N > 0, found {tuple(points.shape)}")
    return points.astype(np.float64)
