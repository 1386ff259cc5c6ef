"""Pose embeddings and reference poses."""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Array
from motionkit.features.layout import feature_layout
from motionkit.features.reference import (
    EMBEDDING_COUNT,
    REFERENCE_COUNT,
    REFERENCE_OFFSETS,
    fit_pose_embedding,
    reference_signal,
)

LAYOUT = feature_layout()
POSITIONS = LAYOUT.blocks["joint_positions"]


def poses(frames: int = 400, rank: int = 5) -> Array:
    """Features (T, 276) whose joint positions vary along a few directions, everything else at random."""
    generator = np.random.default_rng(3)
    features = generator.standard_normal((frames, 276), np.float32)
    size = POSITIONS.stop - POSITIONS.start
    directions = generator.standard_normal((rank, size), np.float32)
    shares = generator.standard_normal((frames, rank), np.float32)
    features[:, POSITIONS] = 10.0 * shares @ directions + np.linspace(0, 100, size, dtype=np.float32)
    return features


def test_an_embedding_keeps_what_differs() -> None:
    features = poses()
    pose_embedding = fit_pose_embedding(features, np.ones(len(features), np.float32), LAYOUT)
    shown = pose_embedding.of(features)
    assert shown.shape == (400, EMBEDDING_COUNT)
    # Five directions and their mirror images: at most ten, so sixteen suffice.
    tell = np.concatenate([shown, np.ones((400, 1), np.float32)], axis=1)
    found = tell @ np.linalg.lstsq(tell, features[:, POSITIONS], rcond=None)[0]
    assert np.allclose(found, features[:, POSITIONS], atol=0.05)


def test_only_joint_positions_count() -> None:
    features = poses()
    pose_embedding = fit_pose_embedding(features, np.ones(len(features), np.float32), LAYOUT)
    other = np.random.default_rng(4).standard_normal(features.shape, np.float32)
    other[:, POSITIONS] = features[:, POSITIONS]
    assert np.array_equal(pose_embedding.of(other), pose_embedding.of(features))


def test_mirroring_changes_signs_only() -> None:
    features = poses()
    pose_embedding = fit_pose_embedding(features, np.ones(len(features), np.float32), LAYOUT)
    columns, signs = LAYOUT.mirror_map()
    plain, mirrored = pose_embedding.of(features), pose_embedding.of(features[:, columns] * signs)
    varies = np.abs(plain).max(axis=0) > 1e-2
    assert int(varies.sum()) >= 5
    assert np.allclose(np.abs(plain)[:, varies], np.abs(mirrored)[:, varies], atol=2e-3)
    assert ((plain[:, varies] * mirrored[:, varies]).sum(axis=0) < 0).any(), "some are odd"


def test_weights_say_which_frames_count() -> None:
    features = poses()
    weights = np.zeros(400, np.float32)
    weights[:100] = 1.0
    a = fit_pose_embedding(features, weights, LAYOUT)
    b = fit_pose_embedding(features[:100], np.ones(100, np.float32), LAYOUT)
    assert np.allclose(a.of(features), b.of(features), atol=1e-3)


def test_a_reference_looks_ahead_and_holds_the_last_pose() -> None:
    reference_clips = np.broadcast_to(np.arange(50.0, dtype=np.float32)[:, None], (50, EMBEDDING_COUNT))
    reference = reference_signal(reference_clips, np.array([0, 40]))
    assert reference.shape == (2, REFERENCE_COUNT)
    ahead = reference.reshape(2, len(REFERENCE_OFFSETS), EMBEDDING_COUNT)[..., 0]
    assert ahead.tolist() == [[5.0, 15.0, 30.0], [45.0, 49.0, 49.0]]
