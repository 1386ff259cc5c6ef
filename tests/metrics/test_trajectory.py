from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.metrics import trajectory as module
from motionkit.metrics.trajectory import distance_to_path, ground_track, location_errors, trajectory_distance


def line(points: int, length: float = 500.0, sideways: float = 0.0) -> Array:
    z = np.linspace(0.0, length, points, dtype=np.float64)
    return np.stack([np.full_like(z, sideways), z], axis=-1)


def circle(radius: float, share: float = 1.0, points: int = 400) -> Array:
    angle = np.linspace(0.0, 2 * math.pi * share, points, dtype=np.float64)
    return radius * np.stack([np.sin(angle), np.cos(angle)], axis=-1)


def test_a_path_moved_sideways_is_that_far_away() -> None:
    result = trajectory_distance(line(100, sideways=7.0), line(100))
    assert (result.mean, result.max, result.coverage) == pytest.approx((7.0, 7.0, 1.0))
    assert [value.id for value in result.values()] == ["path-mean", "path-max", "path-coverage"]


@pytest.mark.parametrize(
    ("away", "values"),
    [
        ([0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0]),
        ([20.0, 10.0, 0.0, 10.0], [10.0, 0.0, 0.0, 0.0, 0.0]),
        ([0.0, 30.0, 50.0, 0.0], [20.0, 0.5, 0.0, 1.0, 0.0]),
        ([0.0, 0.0, 0.0, 60.0], [15.0, 0.25, 0.25, 1.0, 1.0]),
    ],
)
def test_places_are_missed_by_frames_and_trajectories_by_any_frame(away: list, values: list) -> None:
    wanted = line(4)
    found = location_errors(wanted + np.stack([away, np.zeros(4)], axis=-1), wanted)
    assert [each.id for each in found] == [
        "location-mean", "location-20", "location-50", "trajectory-20", "trajectory-50",
    ]  # fmt: skip
    assert [each.value for each in found] == pytest.approx(values)
    with pytest.raises(MotionkitError, match="one length"):
        location_errors(wanted, wanted[1:])


def test_distance_is_to_segments_so_sampling_does_not_matter() -> None:
    track = line(97, sideways=3.0)
    for points in (2, 5, 1000):
        assert trajectory_distance(track, line(points)).mean == pytest.approx(3.0)


def test_beyond_the_end_the_distance_is_to_the_end_point() -> None:
    beyond = np.array([[3.0, 504.0], [0.0, -2.0], [1.0, 20.0]], np.float32)
    assert distance_to_path(beyond, line(2)).tolist() == pytest.approx([5.0, 2.0, 1.0])


def test_concentric_circles() -> None:
    result = trajectory_distance(circle(205.0), circle(200.0, points=4000))
    assert (result.mean, result.max) == pytest.approx((5.0, 5.0), abs=1e-3)


@pytest.mark.parametrize("share", [0.25, 0.5, 0.8])
def test_half_a_circle_covers_half_of_it(share: float) -> None:
    result = trajectory_distance(circle(200.0, share), circle(200.0), tolerance=1.0)
    assert result.mean == pytest.approx(0.0, abs=0.02)
    assert result.coverage == pytest.approx(share, abs=0.01)


def test_standing_still_on_the_path_covers_hardly_any_of_it() -> None:
    result = trajectory_distance(np.zeros((300, 2), np.float32), line(2), tolerance=10.0)
    assert result.mean == 0.0 and result.coverage == pytest.approx(10.0 / 500.0, abs=0.005)


def test_coverage_does_not_depend_on_the_spacing_of_frames() -> None:
    assert trajectory_distance(line(3), line(50), tolerance=0.5).coverage == 1.0


def test_a_path_that_is_one_point() -> None:
    for path in (np.zeros((1, 2), np.float32), np.zeros((5, 2), np.float32)):
        result = trajectory_distance(np.array([[3.0, 4.0]], np.float32), path)
        assert (result.mean, result.coverage) == (5.0, 1.0)


@pytest.mark.parametrize("points", [2, 4, 5, 6, 17, 65, 66, 1000])
def test_long_paths_equal_the_plain_search(points: int) -> None:
    draw = np.random.default_rng(points)
    path = draw.standard_normal((points, 2), np.float64).cumsum(0)
    track = draw.standard_normal((300, 2), np.float64).cumsum(0)
    expected = np.full((300,), math.inf, np.float64)
    for a, b in itertools.pairwise(path):
        share = np.clip(((track - a) @ (b - a)) / ((b - a) @ (b - a)), 0.0, 1.0)
        expected = np.minimum(expected, np.linalg.norm(track - a - share[:, None] * (b - a), axis=-1))
    assert distance_to_path(track, path) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("points", [2, 3, 4, 5, 6, 16, 17, 18, 65, 130])
def test_every_segment_of_a_path_is_looked_at(points: int) -> None:
    """Its middle is on it, and far from all else."""
    path = np.random.default_rng(points).uniform(-1e4, 1e4, (points, 2))
    assert distance_to_path(0.5 * (path[1:] + path[:-1]), path) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("radius", [0.1, 200.0])
def test_laps_over_the_same_ground_cost_what_a_long_way_does(
    monkeypatch: pytest.MonkeyPatch, radius: float
) -> None:
    looked_at = 0
    plain = module.length

    def length(vectors: Array) -> Array:
        nonlocal looked_at
        looked_at += len(vectors)
        return plain(vectors)

    monkeypatch.setattr(module, "length", length)
    counts = []
    for laps in (10, 40):
        looked_at, away = 0, np.random.default_rng(laps).normal(1.0, 0.05, (2, laps, 1, 1))
        track, path = (circle(radius, points=100) * away).reshape(2, -1, 2)
        distance_to_path(track, path)
        counts.append(looked_at)
    assert counts[1] < 8 * counts[0]


def test_turning_and_moving_both_changes_nothing() -> None:
    track, path = circle(150.0, 0.7), line(30)
    c, s = math.cos(1.0), math.sin(1.0)
    turn = np.array([[c, s], [-s, c]], np.float64)
    first = trajectory_distance(track, path)
    second = trajectory_distance(track @ turn + 40.0, path @ turn + 40.0)
    assert (second.mean, second.max) == pytest.approx((first.mean, first.max))
    assert second.coverage == pytest.approx(first.coverage, abs=0.005)


def test_the_ground_track_leaves_the_height_out() -> None:
    assert ground_track(np.array([[1.0, 92.0, 3.0]], np.float32)).tolist() == [[1.0, 3.0]]


def test_refusals() -> None:
    with pytest.raises(MotionkitError, match="expected a path of shape"):
        trajectory_distance(line(3), np.zeros((0, 2), np.float32))
    with pytest.raises(MotionkitError, match="expected a track of shape"):
        trajectory_distance(np.zeros((4, 3), np.float32), line(3))
    for tolerance in (0.0, -1.0, math.nan):
        with pytest.raises(MotionkitError, match="tolerance"):
            trajectory_distance(line(3), line(3), tolerance)


def test_a_path_that_leaps_ten_kilometres_asks_for_no_memory() -> None:
    path = np.zeros((60, 2), np.float64)
    path[1::2] = 1e6
    assert len(module._sampled(path)) <= 100_000
    result = trajectory_distance(path, path)
    assert result.mean == 0.0 and result.coverage == 1.0
