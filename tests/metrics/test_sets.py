from __future__ import annotations

import weakref
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from motionkit.errors import MotionkitError
from motionkit.features.reference import PoseEmbedding
from motionkit.metrics.distribution import diversity, frechet_distance, multimodality, window_features
from motionkit.metrics.sets import set_metrics, set_metrics_of_files
from motionkit.motion.bvh import write_bvh
from motionkit.motion.motion import Motion

from .conftest import placed, swaying


def test_frechet_distance_of_known_gaussians() -> None:
    draw = np.random.default_rng(0)
    mixed = np.array([[2.0, 0.0, 0.0], [0.5, 1.0, 0.0], [0.0, 0.3, 0.7]])
    real = draw.standard_normal((500, 3)) @ mixed
    assert frechet_distance(real, real).value == pytest.approx(0.0, abs=1e-9)
    # Moved, it is the squared distance; larger by a factor, every deviation differs by it.
    assert frechet_distance(real + np.array([3.0, 0.0, 4.0]), real).value == pytest.approx(25.0)
    middle = real - real.mean(axis=0)
    wanted = float(np.trace(np.cov(middle, rowvar=False)))
    assert frechet_distance(3.0 * middle, middle).value == pytest.approx(4.0 * wanted)
    with pytest.raises(MotionkitError, match="found 1 and 500"):
        frechet_distance(real[:1], real)


def test_moving_few_windows_is_all_that_is_measured() -> None:
    """Windows that leave most directions out, as a few short clips do."""
    few = np.random.default_rng(1).standard_normal((5, 40))
    assert frechet_distance(few, few).value == pytest.approx(0.0, abs=1e-3)
    assert frechet_distance(few + 0.5, few).value == pytest.approx(10.0, abs=1e-3)


@pytest.mark.parametrize(
    ("frames", "starts"), [(1, [0]), (60, [0]), (69, [0]), (70, [0, 10]), (95, [0, 10, 20, 30])]
)
def test_a_motion_is_windows_of_a_second_ten_frames_apart(frames: int, starts: list[int]) -> None:
    poses = np.random.default_rng(0).standard_normal((frames, 24)).astype(np.float32)
    embedding = PoseEmbedding(np.eye(24, dtype=np.float32), np.zeros(24, np.float32))
    found = window_features(poses, embedding)
    assert len(found) == len(starts)
    for row, start in zip(found, starts, strict=True):
        window = poses[start : start + 60]
        assert row == pytest.approx(np.concatenate([window.mean(axis=0), window.std(axis=0)]), abs=1e-5)


def test_multimodality_is_the_distance_within_types_of_two_motions() -> None:
    """Of two types, 5 and 13 apart, as often as each other; a type of one motion is left out."""
    types = [[np.zeros((3, 2)), np.tile(place, (2, 1))] for place in ([3.0, 4.0], [5.0, 12.0])]
    found = multimodality([*types, [np.full((4, 2), 99.0)]])
    assert found.value == pytest.approx(9.0) and found.parameters == {"pairs": 20.0}
    with pytest.raises(MotionkitError, match="two motions of"):
        multimodality([types[0][:1]])


def test_diversity_of_two_windows_is_their_distance() -> None:
    windows = np.array([[0.0, 0.0], [3.0, 4.0]])
    assert diversity(windows).value == pytest.approx(5.0)
    with pytest.raises(MotionkitError, match="at least 2 windows"):
        diversity(windows[:1])


def test_sets_do_not_see_places_but_poses() -> None:
    truths = [swaying(seed=seed) for seed in range(3)]
    distance, spread = set_metrics(truths, [placed(each, 1.0, (50.0, 0.0, 20.0)) for each in truths])
    assert distance.motion.value == pytest.approx(0.0, abs=1e-3)
    assert distance.ground_truth is not None and distance.ground_truth.value == 0.0
    assert spread.ratio == pytest.approx(1.0, abs=1e-3)
    other, _ = set_metrics(truths, [swaying(seed=seed) for seed in range(5, 8)])
    assert other.motion.value is not None and other.motion.value > 1.0
    assert other.motion.parameters["features"] == "pose embedding of the ground truth"


def test_files_are_compared_over_their_common_frames(tmp_path: Path) -> None:
    long, short = tmp_path / "long.bvh", tmp_path / "short.bvh"
    write_bvh(long, swaying(200))
    write_bvh(short, swaying(200).cut(0, 120))
    distance, spread = set_metrics_of_files([(long, short)], frames=[120])
    assert distance.motion.value == pytest.approx(0.0, abs=1e-3) and spread.ratio == pytest.approx(
        1.0, abs=1e-3
    )
    whole, _ = set_metrics_of_files([(long, short)])
    assert whole.motion.value is not None and whole.motion.value > 0.01


def test_one_short_motion_is_too_little_for_a_distribution() -> None:
    distance, spread = set_metrics([swaying(frames=40)], [swaying(frames=40, seed=1)])
    assert distance.motion.value is None and "2 windows" in str(distance.motion.reason)
    assert spread.motion.value is None


def test_a_thousand_motions_are_never_in_memory_together() -> None:
    """Each motion is gone before the one after the next is read."""
    seen: list[weakref.ref[Motion]] = []

    def motions() -> Iterator[Motion]:
        for number in range(6):
            motion = swaying(90, seed=number)
            seen.append(weakref.ref(motion))
            yield motion
            del motion
            assert sum(one() is not None for one in seen) <= 1

    set_metrics(motions(), motions())
    assert len(seen) == 12
