from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.data.dataset import Dataset
from motionkit.models.model import MotionModel
from motionkit.motion.bvh import read_bvh
from motionkit.training import scores
from motionkit.training.scores import rollout_types, score_rollouts


def features_of(dataset: Dataset, kind: str) -> Array:
    wanted = dataset.types.index(kind)
    clip = next(c for c in dataset.select("train") if int(dataset.clip_types(c)[0]) == wanted)
    return dataset.read(clip).features[dataset.clip_types(clip) == wanted]


def test_real_motion_scores_as_real(dataset: Dataset) -> None:
    real = features_of(dataset, "walking")
    score = scores._score("walking", real, real, dataset.layout)
    assert score.joint_speed == pytest.approx(1.0)
    assert score.pose_distance < 0.05
    assert score.slide == pytest.approx(1.0, abs=0.1)
    assert 70.0 < score.height[0] <= score.height[1] < 110.0


def test_frozen_motion_scores_as_frozen(dataset: Dataset) -> None:
    real = features_of(dataset, "walking")
    frozen = real[:1].repeat(50, axis=0)
    for block in ("joint_angular_velocities", "joint_velocities"):
        frozen[:, dataset.layout.blocks[block]] = 0.0
    score = scores._score("walking", frozen, real, dataset.layout)
    assert score.joint_speed == 0.0 and score.slide == 0.0
    assert score.pose_distance < 1.0, "the pose itself is a real one"


def test_a_foreign_pose_is_far(dataset: Dataset) -> None:
    real, other = features_of(dataset, "idle"), features_of(dataset, "cartwheel")
    near = scores._score("idle", real, real, dataset.layout).pose_distance
    far = scores._score("idle", other[60:110], real, dataset.layout).pose_distance
    assert far > near + 10.0


def test_every_type_is_rolled_out_from_its_own_start_poses(tiny_model: MotionModel) -> None:
    rollout = rollout_types(tiny_model, 5)
    assert rollout.features.shape == (6, 5, 276)
    again = rollout_types(tiny_model, 5)
    assert np.array_equal(rollout.features, again.features)


def test_samples_are_written_side_by_side(tiny_model: MotionModel, dataset: Dataset, tmp_path: Path) -> None:
    found = score_rollouts(tiny_model, dataset, 8, tmp_path / "samples")
    assert [s.type for s in found] == list(tiny_model.types)
    for kind in tiny_model.types:
        assert len(read_bvh(tmp_path / "samples" / f"{kind}-predicted.bvh").values) == 8
        assert len(read_bvh(tmp_path / "samples" / f"{kind}-true.bvh").values) > 8
