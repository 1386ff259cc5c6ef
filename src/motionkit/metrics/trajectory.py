"""Trajectory distance: how closely the root's ground track follows a path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.metrics.value import MetricSettings, MetricValue

_BLOCK = 64  # path segments per bounding box
_COVERAGE_STEP = 1.0  # cm between samples of the path
_MOST_SAMPLES = 100_000  # samples of the path; on a path longer than a kilometre they are further apart
FAILS_BEYOND = (20, 50)  # cm off a wanted place, from which on papers count it as missed
_POINTS = 10_000  # points compared with a block at once


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
            MetricValue("path-mean", self.mean, "cm/frame"),
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
    nearest = _distance_to_points(points, path[::_BLOCK])
    for first in range(0, len(path) - 1, _BLOCK):
        block = path[first : first + _BLOCK + 1]
        # Compare only points whose distance to the block's bounding box is less than the nearest found so far.
        outside = np.maximum(block.min(0) - points, 0.0) + np.maximum(points - block.max(0), 0.0)
        near = np.flatnonzero(np.linalg.norm(outside, axis=-1) < nearest)
        nearest[near] = np.minimum(nearest[near], _distance_to_segments(points[near], block))
    return nearest


def _distance_to_points(points: Array, places: Array) -> Array:
    """Distance (T,) from points (T, 2) to the nearest of places (M, 2)."""
    nearest = np.linalg.norm(points - places[0], axis=-1)
    for place in places[1:]:
        nearest = np.minimum(nearest, np.linalg.norm(points - place, axis=-1))
    return nearest


def _distance_to_segments(points: Array, path: Array) -> Array:
    """Distance (T,) from points (T, 2) to a short polyline (N, 2), by brute force."""
    if len(points) > _POINTS:
        some = [points[i : i + _POINTS] for i in range(0, len(points), _POINTS)]
        return np.concatenate([_distance_to_segments(each, path) for each in some])
    start, along = path[:-1], np.diff(path, axis=0)
    squared = np.maximum((along * along).sum(-1), 1e-12)
    offset = points[:, None] - start
    share = np.clip((offset * along).sum(-1) / squared, 0.0, 1.0)
    return np.linalg.norm(offset - share[..., None] * along, axis=-1).min(axis=1)


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


def location_errors(track: Array, wanted: Array) -> tuple[MetricValue, ...]:
    """Errors of where the root (T, 2) is beside where it was to be (T, 2) in the same frame, both x, z in cm.

    "location-mean" is their mean distance, "location-20" and "-50" the share of frames further away than 20 and 50 cm,
    "trajectory-20" and "-50" are 1 if any frame is: over many pairs, their means are the shares of failed trajectories
    (Karunratanakul et al. 2023; Xie et al. 2024).

    Raises:
        MotionkitError: the lengths differ.
    """
    track, wanted = _checked(track, "track"), _checked(wanted, "path")
    if len(track) != len(wanted):
        raise MotionkitError(f"expected tracks of one length, found {len(track)} and {len(wanted)} frames")
    away = np.linalg.norm(track - wanted, axis=-1)
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
    wanted = np.linspace(0.0, total, count)
    return np.stack([np.interp(wanted, arc, column) for column in path.T], axis=-1)


def _checked(points: Array, what: str) -> Array:
    if points.ndim != 2 or points.shape[1] != 2 or len(points) == 0:
        raise MotionkitError(f"expected a {what} of shape (N, 2) with N > 0, found {tuple(points.shape)}")
    return points.astype(np.float64)
