"""One frame in numpy against the mathematics of whole motions in torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from motionkit.features.decode import decode_rotations, root_height
from motionkit.features.layout import LAYOUTS
from motionkit.motion import rotations as whole
from motionkit.motion.kinematics import forward_kinematics
from motionkit.motion.skeleton import PARENTS, canonical_skeleton
from motionkit.synthesis import pose


def random_quats(count: int, seed: int = 0) -> torch.Tensor:
    draw = torch.Generator().manual_seed(seed)
    return whole.quat_normalize(torch.randn(count, 4, generator=draw))


def close(ours: np.ndarray, theirs: torch.Tensor, tolerance: float = 2e-6) -> None:
    assert ours.dtype == np.float32
    assert np.abs(ours - theirs.numpy()).max() < tolerance


def test_products_and_matrices() -> None:
    p, q = random_quats(200), random_quats(200, 1)
    close(pose.quat_product(p.numpy(), q.numpy()), whole.quat_multiply(p, q))
    close(pose.quat_to_matrix(p.numpy()), whole.quat_to_matrix(p))
    close(pose.matrix_to_quat(whole.quat_to_matrix(p).numpy()), whole.matrix_to_quat(whole.quat_to_matrix(p)))
    back = np.array([pose.sixd_to_quat(row) for row in whole.quat_to_sixd(p).tolist()], np.float32)
    close(np.abs((back * p.numpy()).sum(-1)), torch.ones(200))


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-5, 1e-3, 1.0, np.pi, 6.0])
def test_exponential_maps_of_any_size(size: float) -> None:
    axes = torch.nn.functional.normalize(
        torch.randn(20, 3, generator=torch.Generator().manual_seed(2)), dim=-1
    )
    close(pose.expmap_to_quat((size * axes).numpy()), whole.expmap_to_quat(size * axes))


def test_half_turns_have_a_quaternion() -> None:
    turns = torch.tensor([[0.0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [0, 0.6, 0.8, 0]])
    back = np.array([pose.sixd_to_quat(row) for row in whole.quat_to_sixd(turns).tolist()])
    assert np.abs(np.abs((back * turns.numpy()).sum(-1)) - 1.0).max() < 1e-6


@pytest.mark.parametrize("layout", LAYOUTS)
def test_decoding_a_frame(layout: str) -> None:
    draw = torch.Generator().manual_seed(3)
    features, references = torch.randn(50, 276, generator=draw), random_quats(23)
    ground = torch.randn(50, 3, generator=draw) * 3.0
    decoder = pose.PoseDecoder(layout, references.numpy())
    turns, places = decoder.decode(features.numpy(), ground.numpy())
    expected = decode_rotations(features, references, layout)
    root = whole.quat_multiply(whole.quat_from_yaw(ground[:, 2]), expected[:, 0])
    close(turns[:, 1:], expected[:, 1:])
    assert (np.abs((turns[:, 0] * root.numpy()).sum(-1)) - 1.0).max() < 1e-5
    assert np.array_equal(places[:, 1], root_height(features, layout).numpy())
    assert np.array_equal(places[:, ::2], ground[:, :2].numpy())


def test_forward_kinematics_of_bodies_of_different_size() -> None:
    turns = random_quats(3 * 23).reshape(3, 23, 4)
    offsets = torch.stack([size * canonical_skeleton().offsets for size in (1.0, 0.7, 1.4)])
    root = torch.tensor([[0.0, 95.0, 0.0], [10.0, 60.0, -5.0], [-300.0, 130.0, 800.0]])
    body = pose.BodyKinematics(offsets.numpy())
    world = body.forward(turns.numpy(), root.numpy())
    rotations, positions = forward_kinematics(turns, root, offsets, PARENTS)
    close(world[..., :3, 3], positions, 1e-3)
    close(world[..., :3, :3], whole.quat_to_matrix(rotations), 1e-5)
