from __future__ import annotations

import math

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.features.control import (
    TRAJECTORY_COUNT,
    TRAJECTORY_OFFSETS,
    ControlLayout,
    Controls,
    blend_types,
    control_vector,
    future_trajectory,
    phase_signal,
    straight_trajectory,
)
from motionkit.features.layout import FEATURE_COUNT
from motionkit.features.normalize import Scaling
from motionkit.features.reference import REFERENCE_COUNT, ReferenceMap


def circle(frames: int, radius: float = 200.0, rate: float = 0.8) -> Array:
    """Ground track (T, 3) along a circle to the left at `rate` radians per second, facing along it."""
    angle = rate * np.arange(frames, dtype=np.float64) / 60.0
    x, z = radius * (1 - np.cos(angle)), radius * np.sin(angle)
    return np.stack([x, z, angle], axis=-1)


def test_control_vector_parts_stand_side_by_side() -> None:
    layout = ControlLayout(("walking", "running", "idle"))
    assert layout.skeleton == slice(0, 69)
    assert layout.type == slice(69, 72)
    assert layout.trajectory == slice(72, 96)
    assert layout.flag == 96
    assert layout.phase == slice(97, 99)
    assert layout.reference == slice(99, 99 + REFERENCE_COUNT)
    assert layout.reference_gain == 99 + REFERENCE_COUNT
    assert layout.size == 100 + REFERENCE_COUNT


def test_phase_is_a_turn_and_silent_without_one() -> None:
    signal = phase_signal(np.array([0.0, 0.25, 0.5, -1.0], np.float32))
    assert np.allclose(
        signal, np.array([[0.0, 1.0], [1.0, 0.0], [0.0, -1.0], [0.0, 0.0]], np.float32), atol=1e-6
    )


def test_control_vector_hides_what_is_not_given() -> None:
    layout = ControlLayout(("walking", "running"))
    scaling = Scaling(np.zeros(TRAJECTORY_COUNT, np.float32), np.full((TRAJECTORY_COUNT,), 2.0, np.float32))
    plain = ReferenceMap(
        np.ones(REFERENCE_COUNT), np.zeros((FEATURE_COUNT, REFERENCE_COUNT)), np.zeros(REFERENCE_COUNT)
    )
    asked = Controls(
        np.array([[1.0, 0.0]] * 2, np.float32),
        np.full((2, TRAJECTORY_COUNT), 6.0, np.float32),
        np.array([0.0, 1.0], np.float32),
        np.array([-1.0, 0.25], np.float32),
        np.full((2, REFERENCE_COUNT), 3.0, np.float32),
        np.array([1.0, 0.0], np.float32),
        np.ones(2, np.float32),
    )
    skeleton, x = np.zeros(69, np.float32), np.zeros((2, FEATURE_COUNT), np.float32)
    vectors = control_vector(layout, skeleton, asked, x, scaling, plain)
    assert vectors[:, layout.flag].tolist() == [0.0, 1.0]
    assert np.array_equal(vectors[0, layout.trajectory], np.zeros(TRAJECTORY_COUNT, np.float32))
    assert np.allclose(vectors[1, layout.trajectory], np.full((TRAJECTORY_COUNT,), 3.0, np.float32))
    assert np.allclose(vectors[1, layout.phase], np.array([1.0, 0.0], np.float32), atol=1e-6)
    assert vectors[:, layout.reference_gain].tolist() == [1.0, 0.0]
    assert np.array_equal(vectors[0, layout.reference], np.full((REFERENCE_COUNT,), 3.0, np.float32))
    assert not vectors[1, layout.reference].any()


def test_straight_ahead() -> None:
    track = np.zeros((200, 3), np.float32)
    track[:, 1] = 2.0 * np.arange(200)
    future = future_trajectory(track, np.array([0, 50]))
    assert future.shape == (2, TRAJECTORY_COUNT)
    positions, directions = future[0].reshape(2, 6, 2)
    assert np.allclose(positions[:, 1], 2.0 * np.array(TRAJECTORY_OFFSETS).astype(np.float32))
    assert np.allclose(positions[:, 0], np.zeros(6, np.float32))
    assert np.allclose(directions, np.broadcast_to(np.array([0.0, 1.0], np.float32), (6, 2)))
    assert np.allclose(future[0], future[1])


def test_a_straight_trajectory_is_that_of_a_straight_track() -> None:
    frames = np.arange(100)
    ground = np.stack([0.5 * frames, 2.0 * frames, 0.0 * frames], axis=1)
    straight = straight_trajectory((30.0, 120.0), 60.0)
    assert np.allclose(straight, future_trajectory(ground, np.array([10]))[0], atol=1e-3)


def test_circle_looks_the_same_from_every_frame() -> None:
    track = circle(300)
    future = future_trajectory(track, np.arange(200))
    assert np.allclose(future, np.broadcast_to(future[:1], future.shape), atol=1e-9)
    angle = 0.8 * np.array(TRAJECTORY_OFFSETS, np.float64) / 60.0
    positions, directions = future[0].reshape(2, 6, 2)
    assert np.allclose(positions[:, 0], 200.0 * (1 - np.cos(angle)))
    assert np.allclose(positions[:, 1], 200.0 * np.sin(angle))
    assert np.allclose(directions, np.stack([np.sin(angle), np.cos(angle)], axis=-1))


def test_beyond_the_end_the_root_goes_on_as_it_went() -> None:
    track = np.zeros((31, 3), np.float32)
    track[:, 1] = 3.0 * np.arange(31)
    future = future_trajectory(track, np.array([30])).reshape(2, 6, 2)[0]
    assert np.allclose(future[:, 1], 3.0 * np.array(TRAJECTORY_OFFSETS).astype(np.float32), atol=1e-4)


def test_one_frame_has_a_trajectory() -> None:
    future = future_trajectory(np.array([[5.0, 6.0, 0.3]], np.float32), np.array([0]))
    assert np.allclose(future[0, :12], np.zeros(12, np.float32))


def test_mirror_signs_are_those_of_the_mirrored_track() -> None:
    track = circle(200)
    mirrored = track * np.array([-1.0, 1.0, -1.0], np.float32)
    frames = np.arange(100)
    expected = future_trajectory(track, frames) * np.tile(np.array([-1.0, 1.0], np.float32), 12)
    assert np.allclose(future_trajectory(mirrored, frames), expected)


def test_types_blend_over_40_frames_centred_on_the_change() -> None:
    types = np.array([0] * 100 + [2] * 100)
    weights = blend_types(types, 3)
    assert weights.shape == (200, 3)
    assert np.allclose(weights.sum(-1), np.ones(200, np.float32))
    moving = np.flatnonzero((weights[:, 2] > 0) & (weights[:, 2] < 1))
    assert len(moving) == 39, "40 steps lie between 39 mixed frames"
    assert np.allclose(np.diff(weights[moving, 2]), np.full((38,), 1 / 40), atol=1e-6)
    assert float(weights[100, 2]) == pytest.approx(0.5)
    assert np.array_equal(weights[:, 1], np.zeros(200, np.float32))


def test_changes_closer_than_a_blend_still_sum_to_one() -> None:
    types = np.array([0] * 10 + [1] * 7 + [2] * 5 + [0] * 30)
    weights = blend_types(types, 3)
    assert np.allclose(weights.sum(-1), np.ones(len(types), np.float32), atol=1e-6)
    assert (weights >= 0).all() and (weights <= 1).all()
    assert float(weights[:, 1].max()) == pytest.approx(7 / 40, abs=1e-6)


def test_one_type_stays_one_hot() -> None:
    weights = blend_types(np.full((50,), 1), 2)
    assert np.array_equal(weights, np.broadcast_to(np.array([0.0, 1.0], np.float32), (50, 2)))


def test_half_turn_is_seen_as_one() -> None:
    track = np.zeros((100, 3), np.float32)
    track[60:, 2] = math.pi
    directions = future_trajectory(track, np.array([0]))[0, 12:].reshape(6, 2)
    assert np.allclose(directions[:5], np.broadcast_to(np.array([0.0, 1.0], np.float32), (5, 2)))
    assert np.allclose(directions[5], np.array([0.0, -1.0], np.float32), atol=1e-6)
