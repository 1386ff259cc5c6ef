from __future__ import annotations

import math

import pytest
import torch

from motionkit.features.control import (
    TRAJECTORY_COUNT,
    TRAJECTORY_OFFSETS,
    ControlLayout,
    blend_types,
    control_vector,
    future_trajectory,
    phase_signal,
    trajectory_mirror,
)
from motionkit.features.guide import GUIDE_COUNT
from motionkit.features.normalize import Scaling


def circle(frames: int, radius: float = 200.0, rate: float = 0.8) -> torch.Tensor:
    """Ground track (T, 3) round a circle to the left at rate radians per second, facing along it."""
    angle = rate * torch.arange(frames, dtype=torch.float64) / 60.0
    x, z = radius * (1 - torch.cos(angle)), radius * torch.sin(angle)
    return torch.stack([x, z, angle], dim=-1)


def test_control_vector_parts_stand_side_by_side() -> None:
    layout = ControlLayout(("walking", "running", "idle"))
    assert layout.skeleton == slice(0, 69)
    assert layout.type == slice(69, 72)
    assert layout.trajectory == slice(72, 96)
    assert layout.flag == 96
    assert layout.phase == slice(97, 99)
    assert layout.guide == slice(99, 99 + GUIDE_COUNT)
    assert layout.guided == 99 + GUIDE_COUNT
    assert layout.size == 100 + GUIDE_COUNT


def test_phase_is_a_turn_and_silent_without_one() -> None:
    signal = phase_signal(torch.tensor([0.0, 0.25, 0.5, -1.0]))
    assert torch.allclose(signal, torch.tensor([[0.0, 1.0], [1.0, 0.0], [0.0, -1.0], [0.0, 0.0]]), atol=1e-6)


def test_control_vector_hides_a_trajectory_or_guide_that_is_not_given() -> None:
    layout = ControlLayout(("walking", "running"))
    scaling = Scaling(torch.zeros(TRAJECTORY_COUNT), torch.full((TRAJECTORY_COUNT,), 2.0))
    weights, trajectory = torch.tensor([[1.0, 0.0]] * 2), torch.full((2, TRAJECTORY_COUNT), 6.0)
    given, progress = torch.tensor([0.0, 1.0]), torch.tensor([-1.0, 0.25])
    guide, guided = torch.full((2, GUIDE_COUNT), 3.0), torch.tensor([1.0, 0.0])
    vectors = control_vector(
        layout, torch.zeros(69), weights, trajectory, given, progress, guide, guided, scaling
    )
    assert vectors[:, layout.flag].tolist() == [0.0, 1.0]
    assert torch.equal(vectors[0, layout.trajectory], torch.zeros(TRAJECTORY_COUNT))
    assert torch.allclose(vectors[1, layout.trajectory], torch.full((TRAJECTORY_COUNT,), 3.0))
    assert torch.allclose(vectors[1, layout.phase], torch.tensor([1.0, 0.0]), atol=1e-6)
    assert vectors[:, layout.guided].tolist() == [1.0, 0.0]
    assert torch.equal(vectors[0, layout.guide], torch.full((GUIDE_COUNT,), 3.0))
    assert not vectors[1, layout.guide].any()


def test_straight_ahead() -> None:
    track = torch.zeros(200, 3)
    track[:, 1] = 2.0 * torch.arange(200)
    future = future_trajectory(track, torch.tensor([0, 50]))
    assert future.shape == (2, TRAJECTORY_COUNT)
    positions, directions = future[0].reshape(2, 6, 2)
    assert torch.allclose(positions[:, 1], 2.0 * torch.tensor(TRAJECTORY_OFFSETS).float())
    assert torch.allclose(positions[:, 0], torch.zeros(6))
    assert torch.allclose(directions, torch.tensor([0.0, 1.0]).expand(6, 2))
    assert torch.allclose(future[0], future[1])


def test_circle_looks_the_same_from_every_frame() -> None:
    track = circle(300)
    future = future_trajectory(track, torch.arange(200))
    assert torch.allclose(future, future[:1].expand_as(future), atol=1e-9)
    angle = 0.8 * torch.tensor(TRAJECTORY_OFFSETS, dtype=torch.float64) / 60.0
    positions, directions = future[0].reshape(2, 6, 2)
    assert torch.allclose(positions[:, 0], 200.0 * (1 - torch.cos(angle)))
    assert torch.allclose(positions[:, 1], 200.0 * torch.sin(angle))
    assert torch.allclose(directions, torch.stack([torch.sin(angle), torch.cos(angle)], dim=-1))


def test_beyond_the_end_the_root_goes_on_as_it_went() -> None:
    track = torch.zeros(31, 3)
    track[:, 1] = 3.0 * torch.arange(31)
    future = future_trajectory(track, torch.tensor([30])).reshape(2, 6, 2)[0]
    assert torch.allclose(future[:, 1], 3.0 * torch.tensor(TRAJECTORY_OFFSETS).float(), atol=1e-4)


def test_one_frame_has_a_trajectory() -> None:
    future = future_trajectory(torch.tensor([[5.0, 6.0, 0.3]]), torch.tensor([0]))
    assert torch.allclose(future[0, :12], torch.zeros(12))


def test_mirror_signs_are_those_of_the_mirrored_track() -> None:
    track = circle(200)
    mirrored = track * torch.tensor([-1.0, 1.0, -1.0])
    frames = torch.arange(100)
    expected = future_trajectory(track, frames) * trajectory_mirror()
    assert torch.allclose(future_trajectory(mirrored, frames), expected)


def test_types_blend_over_40_frames_centred_on_the_change() -> None:
    types = torch.tensor([0] * 100 + [2] * 100)
    weights = blend_types(types, 3)
    assert weights.shape == (200, 3)
    assert torch.allclose(weights.sum(-1), torch.ones(200))
    moving = torch.nonzero((weights[:, 2] > 0) & (weights[:, 2] < 1)).flatten()
    assert len(moving) == 39, "40 steps lie between 39 mixed frames"
    assert torch.allclose(torch.diff(weights[moving, 2]), torch.full((38,), 1 / 40), atol=1e-6)
    assert float(weights[100, 2]) == pytest.approx(0.5)
    assert torch.equal(weights[:, 1], torch.zeros(200))


def test_changes_closer_than_a_blend_still_sum_to_one() -> None:
    types = torch.tensor([0] * 10 + [1] * 7 + [2] * 5 + [0] * 30)
    weights = blend_types(types, 3)
    assert torch.allclose(weights.sum(-1), torch.ones(len(types)), atol=1e-6)
    assert (weights >= 0).all() and (weights <= 1).all()
    assert float(weights[:, 1].max()) == pytest.approx(7 / 40, abs=1e-6)


def test_one_type_stays_one_hot() -> None:
    weights = blend_types(torch.full((50,), 1), 2)
    assert torch.equal(weights, torch.tensor([0.0, 1.0]).expand(50, 2))


def test_half_turn_is_seen_as_one() -> None:
    track = torch.zeros(100, 3)
    track[60:, 2] = math.pi
    directions = future_trajectory(track, torch.tensor([0]))[0, 12:].reshape(6, 2)
    assert torch.allclose(directions[:5], torch.tensor([0.0, 1.0]).expand(5, 2))
    assert torch.allclose(directions[5], torch.tensor([0.0, -1.0]), atol=1e-6)
