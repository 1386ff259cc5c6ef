"""One frame in numpy against the mathematics of whole motions."""

from __future__ import annotations

import numpy as np
import pytest

from motionkit.arrays import Array, normalized
from motionkit.features.decode import decode_rotations, root_height
from motionkit.features.layout import LAYOUTS
from motionkit.inference import pose
from motionkit.motion import rotations as whole
from motionkit.motion.kinematics import forward_kinematics
from motionkit.motion.skeleton import PARENTS, canonical_skeleton


def random_quats(count: int, seed: int = 0) -> Array:
    draw = np.random.default_rng(seed)
    return whole.quat_normalize(draw.standard_normal((count, 4), np.float32))


def close(ours: np.ndarray, theirs: Array, tolerance: float = 2e-6) -> None:
    assert ours.dtype == np.float32
    assert np.abs(ours - theirs).max() < tolerance


def test_products_and_matrices() -> None:
    p, q = random_quats(200), random_quats(200, 1)
    close(pose.quat_product(p, q), whole.quat_multiply(p, q))
    close(pose.quat_to_matrix(p), whole.quat_to_matrix(p))
    close(pose.matrix_to_quat(whole.quat_to_matrix(p)), whole.matrix_to_quat(whole.quat_to_matrix(p)))
    back = np.array([pose.sixd_to_quat(row) for row in whole.quat_to_sixd(p).tolist()], np.float32)
    close(np.abs((back * p).sum(-1)), np.ones(200, np.float32))


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-5, 1e-3, 1.0, np.pi, 6.0])
def test_exponential_maps_of_any_size(size: float) -> None:
    axes = normalized(np.random.default_rng(2).standard_normal((20, 3), np.float32))
    close(pose.expmap_to_quat(size * axes), whole.expmap_to_quat(size * axes))


def test_half_turns_have_a_quaternion() -> None:
    turns = np.array([[0.0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [0, 0.6, 0.8, 0]], np.float32)
    back = np.array([pose.sixd_to_quat(row) for row in whole.quat_to_sixd(turns).tolist()])
    assert np.abs(np.abs((back * turns).sum(-1)) - 1.0).max() < 1e-6


@pytest.mark.parametrize("layout", LAYOUTS)
def test_decoding_a_frame(layout: str) -> None:
    draw = np.random.default_rng(3)
    features, reference_rotations = draw.standard_normal((50, 276), np.float32), random_quats(23)
    ground = draw.standard_normal((50, 3), np.float32) * 3.0
    decoder = pose.PoseDecoder(layout, reference_rotations)
    turns, places = decoder.decode(features, ground)
    expected = decode_rotations(features, reference_rotations, layout)
    root = whole.quat_multiply(whole.quat_from_yaw(ground[:, 2]), expected[:, 0])
    close(turns[:, 1:], expected[:, 1:])
    assert (np.abs((turns[:, 0] * root).sum(-1)) - 1.0).max() < 1e-5
    assert np.array_equal(places[:, 1], root_height(features, layout))
    assert np.array_equal(places[:, ::2], ground[:, :2])


def test_forward_kinematics_of_bodies_of_different_size() -> None:
    turns = random_quats(3 * 23).reshape(3, 23, 4)
    offsets = np.stack([size * canonical_skeleton().offsets for size in (1.0, 0.7, 1.4)])
    root = np.array([[0.0, 95.0, 0.0], [10.0, 60.0, -5.0], [-300.0, 130.0, 800.0]], np.float32)
    body = pose.BodyKinematics(offsets)
    world = body.forward(turns, root)
    rotations, positions = forward_kinematics(turns, root, offsets, PARENTS)
    close(world[..., :3, 3], positions, 1e-3)
    close(world[..., :3, :3], whole.quat_to_matrix(rotations), 1e-5)
