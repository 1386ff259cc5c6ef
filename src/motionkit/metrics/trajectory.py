"""Trajectory distance: how closely the root's ground track keeps to a path."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from motionkit.errors import MotionkitError
from motionkit.metrics.value import MetricSettings, MetricValue

_BLOCK = 64  # segments that one bounding box stands for
_COVERAGE_STEP = 1.0  # cm between the samples of the reference path
_MOST_SAMPLES = 100_000  # on paths longer than a kilometre they lie further apart
_POINTS = 10_000  # compared with a block at a time


@dataclass(frozen=True, eq=False)
class TrajectoryDistance:
    """How a track keeps to a path.

    Attributes:
        distances: (T,) cm from each point of the track to the nearest point of the path.
        coverage: share of the path's length that the track passes within the tolerance.
        tolerance: cm.
    """

    distances: Tensor
    coverage: float
    tolerance: float

    @property
    def mean(self) -> float:
        """Mean nearest distance, cm per frame: the paper's trajectory distance."""
        return float(self.distances.mean())

    @property
    def max(self) -> float:
        """Largest nearest distance in cm."""
        return float(self.distances.max())

    def values(self) -> tuple[MetricValue, MetricValue, MetricValue]:
        """Mean, largest and coverage as metric values."""
        return (
            MetricValue("path-mean", self.mean, "cm/frame"),
            MetricValue("path-max", self.max, "cm"),
            MetricValue("path-coverage", self.coverage, "", {"tolerance_cm": self.tolerance}),
        )


def ground_track(root_positions: Tensor) -> Tensor:
    """The track (T, 2) as x, z of root positions (T, 3)."""
    return root_positions[..., [0, 2]]


def distance_to_path(points: Tensor, path: Tensor) -> Tensor:
    """Distance (T,) from points (T, 2) to the nearest place on the polyline through path (N, 2).

    Raises MotionkitError if either is empty or not of that shape.
    """
    points, path = _checked(points, "track"), _checked(path, "path")
    if len(path) == 1:
        return (points - path).norm(dim=-1)
    nearest = _distance_to_points(points, path[::_BLOCK])
    for first in range(0, len(path) - 1, _BLOCK):
        block = path[first : first + _BLOCK + 1]
        # Only points that may be nearer to this block than to what was seen need its segments.
        outside = (block.amin(0) - points).clamp(min=0.0) + (points - block.amax(0)).clamp(min=0.0)
        near = torch.nonzero(outside.norm(dim=-1) < nearest).flatten()
        nearest[near] = torch.minimum(nearest[near], _distance_to_segments(points[near], block))
    return nearest


def _distance_to_points(points: Tensor, places: Tensor) -> Tensor:
    """Distance (T,) from points (T, 2) to the nearest of places (M, 2)."""
    nearest = (points - places[0]).norm(dim=-1)
    for place in places[1:]:
        nearest = torch.minimum(nearest, (points - place).norm(dim=-1))
    return nearest


def _distance_to_segments(points: Tensor, path: Tensor) -> Tensor:
    """Distance (T,) from points (T, 2) to a polyline (N, 2) of few segments, each tried for each point."""
    if len(points) > _POINTS:
        return torch.cat([_distance_to_segments(some, path) for some in points.split(_POINTS)])
    start, along = path[:-1], torch.diff(path, dim=0)
    squared = (along * along).sum(-1).clamp(min=1e-12)
    offset = points[:, None] - start
    share = ((offset * along).sum(-1) / squared).clamp(0.0, 1.0)
    return (offset - share[..., None] * along).norm(dim=-1).amin(dim=1)


def trajectory_distance(
    track: Tensor, path: Tensor, tolerance: float = MetricSettings.path_tolerance
) -> TrajectoryDistance:
    """How closely a ground track (T, 2) keeps to a path (N, 2), both x, z in cm.

    Distances are to the segments of the path, so its sampling does not matter. Coverage counts the
    stretches of the path that the track's own segments pass within the tolerance: a figure that stands
    still on the path has distance zero and hardly any coverage.

    Raises MotionkitError if either is empty or the tolerance is not positive.
    """
    if not tolerance > 0:
        raise MotionkitError(f"the path tolerance must be above 0 cm, found {tolerance:g}")
    distances = distance_to_path(track, path)
    covered = distance_to_path(_sampled(_checked(path, "path")), track) <= tolerance
    return TrajectoryDistance(distances, float(covered.double().mean()), tolerance)


def _sampled(path: Tensor) -> Tensor:
    """Points (M, 2) at even arc length along a path (N, 2), about 1 cm apart up to a kilometre, ends included."""
    lengths = torch.diff(path, dim=0).norm(dim=-1)
    arc = torch.cat([lengths.new_zeros(1), lengths.cumsum(0)])
    total = float(arc[-1])
    if total == 0.0:
        return path[:1]
    count = min(max(2, round(total / _COVERAGE_STEP) + 1), _MOST_SAMPLES)
    wanted = torch.linspace(0.0, total, count, dtype=torch.float64)
    right = torch.searchsorted(arc, wanted).clamp(1, len(arc) - 1)
    span = (arc[right] - arc[right - 1]).clamp(min=1e-12)
    weight = ((wanted - arc[right - 1]) / span)[:, None]
    return path[right - 1] * (1 - weight) + path[right] * weight


def _checked(points: Tensor, what: str) -> Tensor:
    if points.dim() != 2 or points.shape[1] != 2 or len(points) == 0:
        raise MotionkitError(f"expected a {what} of shape (N, 2) with N > 0, found {tuple(points.shape)}")
    return points.double()
