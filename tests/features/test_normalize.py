from __future__ import annotations

import numpy as np
import pytest

from motionkit.features.layout import feature_layout
from motionkit.features.normalize import (
    BLOCK_FLOOR,
    DIRECTION_FLOOR,
    TRAJECTORY_FLOOR,
    RunningMoments,
    Scaling,
    feature_scaling,
    trajectory_scaling,
)


def test_moments_in_pieces_are_those_of_the_whole() -> None:
    rows = np.random.default_rng(0).normal(3.0, 2.0, (500, 7)).astype(np.float32)
    moments = RunningMoments(7)
    for piece in np.array_split(rows, 6):
        moments.add(piece)
    mean, std = moments.mean_std()
    assert np.allclose(mean, rows.mean(0), atol=1e-5)
    assert np.allclose(std, rows.std(0), atol=1e-5)


def test_large_values_do_not_lose_their_deviation() -> None:
    rows = 1e4 + np.random.default_rng(0).normal(0.0, 0.5, (400, 1))
    moments = RunningMoments(1)
    moments.add(rows)
    assert float(moments.mean_std()[1][0]) == pytest.approx(float(rows.std()), rel=1e-4)


def test_no_column_is_divided_by_less_than_its_share_of_the_block() -> None:
    layout = feature_layout()
    rows = np.random.default_rng(1).normal(0.0, 1.0, (2000, 276))
    block = layout.blocks["joint_velocities"]
    rows[:, block.start] = 4.0  # constant
    rows[:, block.start + 1] *= 20.0
    moments = RunningMoments(276)
    moments.add(rows)
    scaling = feature_scaling(moments, layout)
    raw = moments.mean_std()[1][block]
    assert float(scaling.std[block.start]) == pytest.approx(
        BLOCK_FLOOR * float(np.sqrt(np.square(raw).mean())), rel=1e-5
    )
    assert float(scaling.std[block.start + 1]) == pytest.approx(float(raw[1]))
    assert (scaling.std > 0).all()


def test_a_block_that_never_moves_can_still_be_divided_by() -> None:
    moments = RunningMoments(276)
    moments.add(np.ones((10, 276)))
    scaling = feature_scaling(moments, feature_layout())
    assert np.isfinite(scaling.normalize(np.ones(276, np.float32))).all()


def test_trajectory_floors() -> None:
    moments = RunningMoments(24)
    moments.add(np.zeros((10, 24)))
    std = trajectory_scaling(moments).std
    assert np.array_equal(std[:12], np.full((12,), TRAJECTORY_FLOOR))
    assert np.allclose(std[12:], np.full((12,), DIRECTION_FLOOR))


def test_normalize_and_back() -> None:
    scaling = Scaling(np.array([1.0, -2.0], np.float32), np.array([3.0, 0.5], np.float32))
    x = np.array([[4.0, -2.5]], np.float32)
    assert np.array_equal(scaling.normalize(x), np.array([[1.0, -1.0]], np.float32))
    assert np.array_equal(scaling.denormalize(scaling.normalize(x)), x)
