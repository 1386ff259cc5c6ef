"""Properties of the rotation functions, with samples near zero and near half a turn."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.motion import rotations as rot

DTYPES = [np.float32, np.float64]
TOLERANCE = {np.float32: 2e-6, np.float64: 1e-13}
# An angle read back near half a turn, or from a matrix, is worth half the digits at worst.
ANGLE_TOLERANCE = {np.float32: 2e-3, np.float64: 1e-7}
EULER_ORDERS = ["".join(order) for order in itertools.permutations("XYZ")]


def random_axes(count: int, dtype: type, seed: int = 0) -> Array:
    generator = np.random.default_rng(seed)
    axes = generator.standard_normal((count, 3), np.float64)
    return (axes / np.linalg.norm(axes, axis=-1, keepdims=True)).astype(dtype)


def random_quats(count: int, dtype: type, seed: int = 0) -> Array:
    generator = np.random.default_rng(seed)
    quats = generator.standard_normal((count, 4), np.float64)
    return (quats / np.linalg.norm(quats, axis=-1, keepdims=True)).astype(dtype)


def expmaps(dtype: type) -> Array:
    """Exponential maps of every kind of angle: none, tiny, at the switch of formulas, medium, near pi."""
    switch = rot.SMALL_ANGLE
    angles = [0.0, 1e-30, 1e-12, 1e-7, 0.5 * switch, 0.999 * switch, 1.001 * switch, 1e-3, 0.1, 1.0, 2.0, 3.0]
    angles += [math.pi - 1e-2, math.pi - 1e-4, math.pi - 1e-6]
    axes = np.concatenate([random_axes(20, dtype), np.eye(3, dtype=dtype), -np.eye(3, dtype=dtype)])
    return (np.array(angles, dtype)[:, None, None] * axes).reshape(-1, 3)


def same_rotation(a: Array, b: Array) -> Array:
    """The distance (...) between unit quaternions, regardless of sign."""
    return np.minimum(np.abs(a - b).max(-1), np.abs(a + b).max(-1))


@pytest.mark.parametrize("dtype", DTYPES)
def test_expmap_round_trip(dtype: type) -> None:
    given = expmaps(dtype)
    quats = rot.expmap_to_quat(given)
    assert np.abs(np.linalg.norm(quats, axis=-1) - 1).max() < TOLERANCE[dtype]
    back = rot.quat_to_expmap(quats)
    assert np.abs(back - given).max() < 4 * TOLERANCE[dtype]


@pytest.mark.parametrize("dtype", DTYPES)
def test_expmap_is_axis_times_full_angle(dtype: type) -> None:
    quarter = rot.expmap_to_quat(np.array([0.0, math.pi / 2, 0.0], dtype))
    turned = rot.quat_rotate(quarter, np.array([0.0, 0.0, 1.0], dtype))
    assert np.allclose(turned, np.array([1.0, 0.0, 0.0], dtype), atol=TOLERANCE[dtype])


@pytest.mark.parametrize("dtype", DTYPES)
def test_expmap_beyond_half_a_turn_is_the_same_rotation(dtype: type) -> None:
    axes = random_axes(50, dtype)
    for angle in (3.5, 2 * math.pi - 1e-3, 2 * math.pi, 7.0):
        long_way = rot.expmap_to_quat(angle * axes)
        short_way = rot.expmap_to_quat((angle - 2 * math.pi) * axes)
        assert same_rotation(long_way, short_way).max() < 4 * TOLERANCE[dtype]
        assert np.linalg.norm(rot.quat_to_expmap(long_way), axis=-1).max() <= math.pi + TOLERANCE[dtype]


@pytest.mark.parametrize("dtype", DTYPES)
def test_sign_of_a_quaternion_does_not_matter(dtype: type) -> None:
    quats = random_quats(100, dtype)
    assert np.array_equal(rot.quat_to_expmap(quats), rot.quat_to_expmap(-quats))
    assert np.allclose(rot.quat_to_matrix(quats), rot.quat_to_matrix(-quats))


@pytest.mark.parametrize("dtype", DTYPES)
def test_matrix_round_trip_near_half_turns(dtype: type) -> None:
    half_turns = np.concatenate(
        [
            np.zeros((206, 1), dtype),
            np.concatenate([random_axes(200, dtype), *[np.eye(3, dtype=dtype)] * 2]),
        ],
        -1,
    )
    quats = np.concatenate([random_quats(500, dtype), half_turns, rot.expmap_to_quat(expmaps(dtype))])
    matrices = rot.quat_to_matrix(quats)
    unit = np.broadcast_to(np.eye(3, dtype=dtype), matrices.shape)
    assert np.abs(matrices @ matrices.swapaxes(-1, -2) - unit).max() < 4 * TOLERANCE[dtype]
    assert np.abs(np.linalg.det(matrices) - 1).max() < 4 * TOLERANCE[dtype]
    back = rot.matrix_to_quat(matrices)
    assert same_rotation(back, quats).max() < 4 * TOLERANCE[dtype]
    assert (back[..., 0] >= 0).all()


@pytest.mark.parametrize("dtype", DTYPES)
def test_product_and_rotate_agree_with_matrices(dtype: type) -> None:
    a, b = random_quats(200, dtype, 1), random_quats(200, dtype, 2)
    vectors = 10 * random_axes(200, dtype, 3)
    product = rot.quat_to_matrix(rot.quat_multiply(a, b))
    assert np.abs(product - rot.quat_to_matrix(a) @ rot.quat_to_matrix(b)).max() < 4 * TOLERANCE[dtype]
    turned = (rot.quat_to_matrix(a) @ vectors[..., None]).squeeze(-1)
    assert np.abs(rot.quat_rotate(a, vectors) - turned).max() < 40 * TOLERANCE[dtype]
    there_and_back = rot.quat_multiply(a, rot.quat_inverse(a))
    assert same_rotation(there_and_back, rot.quat_identity((200,), dtype)).max() < 4 * TOLERANCE[dtype]


def test_leading_dimensions_broadcast() -> None:
    quats = random_quats(6, np.float32).reshape(2, 3, 4)
    vector = np.array([1.0, 2.0, 3.0], np.float32)
    assert rot.quat_rotate(quats, vector).shape == (2, 3, 3)
    assert rot.quat_rotate(quats[:1, :1], np.broadcast_to(vector, (5, 7, 3))).shape == (5, 7, 3)
    assert rot.quat_to_matrix(quats).shape == (2, 3, 3, 3)
    assert rot.quat_to_euler(quats, "ZYX").shape == (2, 3, 3)
    assert rot.quat_multiply(quats, quats[0]).shape == (2, 3, 4)
    assert rot.quat_to_expmap(quats[:0]).shape == (0, 3, 3)


@pytest.mark.parametrize("order", EULER_ORDERS)
@pytest.mark.parametrize("dtype", DTYPES)
def test_euler_round_trip(order: str, dtype: type) -> None:
    quats = np.concatenate([random_quats(300, dtype), rot.expmap_to_quat(expmaps(dtype))])
    angles = rot.quat_to_euler(quats, order)
    assert np.abs(angles[..., 1]).max() <= math.pi / 2 + TOLERANCE[dtype]
    assert same_rotation(rot.euler_to_quat(angles, order), quats).max() < ANGLE_TOLERANCE[dtype]


@pytest.mark.parametrize("order", EULER_ORDERS)
def test_euler_order_is_outermost_first(order: str) -> None:
    angles = np.array([0.3, -0.7, 1.1], np.float64)
    matrix = np.eye(3, dtype=np.float64)
    for axis, angle in zip(order, angles.tolist(), strict=True):
        i = "XYZ".index(axis)
        j, k = (i + 1) % 3, (i + 2) % 3
        one = np.eye(3, dtype=np.float64)
        one[j, j] = one[k, k] = math.cos(angle)
        one[k, j], one[j, k] = math.sin(angle), -math.sin(angle)
        matrix = matrix @ one
    assert np.allclose(rot.quat_to_matrix(rot.euler_to_quat(angles, order)), matrix, atol=1e-12)


@pytest.mark.parametrize("order", EULER_ORDERS)
def test_euler_at_the_pole(order: str) -> None:
    for sign, first, last in itertools.product((1, -1), (-2.0, 0.0, 1.0), (-1.0, 0.0, 2.0)):
        angles = np.array([first, sign * math.pi / 2, last], np.float64)
        quat = rot.euler_to_quat(angles, order)
        back = rot.quat_to_euler(quat, order)
        assert same_rotation(rot.euler_to_quat(back, order), quat) < 1e-6


@pytest.mark.parametrize("order", EULER_ORDERS)
def test_euler_near_the_pole(order: str) -> None:
    """Errors of the first and the last angle make up for each other, in float32 too."""
    generator = np.random.default_rng(0)
    for away in (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2):
        angles = generator.uniform(-math.pi, math.pi, (500, 3))
        angles[:, 1] = generator.choice([-1.0, 1.0], 500) * (0.5 * math.pi - away)
        quats = rot.euler_to_quat(angles, order).astype(np.float32)
        back = rot.euler_to_quat(rot.quat_to_euler(quats, order).astype(np.float64), order)
        assert same_rotation(back, rot.quat_normalize(quats.astype(np.float64))).max() < 1e-5, away


def test_euler_of_one_and_two_channels() -> None:
    angle = np.array([[0.4], [-2.0]], np.float64)
    expected = rot.expmap_to_quat(np.concatenate([angle, np.zeros((2, 2), np.float64)], -1))
    assert same_rotation(rot.euler_to_quat(angle, "X"), expected).max() < 1e-12
    assert same_rotation(rot.euler_to_quat(angle[:, :0], ""), rot.quat_identity((2,), np.float64)).max() == 0


@pytest.mark.parametrize("dtype", DTYPES)
def test_slerp_moves_evenly_the_shorter_way(dtype: type) -> None:
    a, b = random_quats(200, dtype, 1), random_quats(200, dtype, 2)
    whole = rot.quat_angle(a, b)
    for share in (0.0, 0.25, 0.5, 1.0):
        fraction = np.full((200,), share, dtype)
        between = rot.quat_slerp(a, b, fraction)
        assert np.abs(rot.quat_angle(a, between) - share * whole).max() < ANGLE_TOLERANCE[dtype]
        assert same_rotation(between, rot.quat_slerp(a, -b, fraction)).max() < 4 * TOLERANCE[dtype]
    nearly = rot.quat_multiply(a, rot.expmap_to_quat(1e-6 * random_axes(200, dtype)))
    half = rot.quat_slerp(a, nearly, np.full((200,), 0.5, dtype))
    assert np.isfinite(half).all() and same_rotation(half, a).max() < 4 * TOLERANCE[dtype] + 1e-6


@pytest.mark.parametrize("dtype", DTYPES)
def test_quat_between_directions(dtype: type) -> None:
    source = np.concatenate([random_axes(100, dtype, 1), *[np.eye(3, dtype=dtype)] * 3])
    target = np.concatenate(
        [
            random_axes(100, dtype, 2),
            np.eye(3, dtype=dtype),
            -np.eye(3, dtype=dtype),
            np.roll(np.eye(3, dtype=dtype), 1, axis=0),
        ]
    )
    quats = rot.quat_between(3 * source, 5 * target)
    assert np.abs(rot.quat_rotate(quats, source) - target).max() < ANGLE_TOLERANCE[dtype]
    assert np.abs(np.linalg.norm(quats, axis=-1) - 1).max() < TOLERANCE[dtype]


@pytest.mark.parametrize("dtype", DTYPES)
def test_sixd_round_trip_and_repair(dtype: type) -> None:
    quats = np.concatenate([random_quats(200, dtype), rot.expmap_to_quat(expmaps(dtype))])
    sixd = rot.quat_to_sixd(quats)
    assert same_rotation(rot.sixd_to_quat(sixd), quats).max() < 8 * TOLERANCE[dtype]
    sheared = sixd.copy()
    sheared[..., 3:] += 0.3 * sixd[..., :3]
    assert same_rotation(rot.sixd_to_quat(2 * sheared), quats).max() < 8 * TOLERANCE[dtype]


def test_quat_continuous_keeps_rotations_and_closes_gaps() -> None:
    seconds = np.linspace(0, 8 * math.pi, 400, dtype=np.float64)
    quats = rot.quat_from_yaw(seconds)[:, None].repeat(3, axis=1)
    flipped = quats * np.where(np.random.default_rng(0).random((400, 3, 1), np.float32) < 0.5, -1, 1)
    smooth = rot.quat_continuous(flipped)
    assert ((smooth[1:] * smooth[:-1]).sum(-1) > 0).all()
    assert same_rotation(smooth, quats).max() == 0


def test_yaw_and_ground_turns_agree() -> None:
    yaw = np.linspace(-4, 4, 30, dtype=np.float64)
    xz = random_axes(30, np.float64)[:, :2]
    lifted = np.stack([xz[:, 0], np.zeros(30, np.float64), xz[:, 1]], axis=-1)
    turned = rot.quat_rotate(rot.quat_from_yaw(yaw), lifted)
    assert np.allclose(rot.rotate_ground(yaw, xz), turned[:, [0, 2]], atol=1e-12)


def test_wrap_angle_range() -> None:
    angles = np.array([-7.0, -math.pi, 0.0, math.pi, 3.2, 100.0], np.float64)
    wrapped = rot.wrap_angle(angles)
    assert ((wrapped >= -math.pi) & (wrapped < math.pi)).all()
    assert np.allclose(np.sin(wrapped), np.sin(angles)) and np.allclose(np.cos(wrapped), np.cos(angles))


def test_mean_rotation_lies_between() -> None:
    middle = random_quats(1, np.float64)[0]
    spread = rot.expmap_to_quat(
        np.array([[0.3, 0, 0], [-0.3, 0, 0], [0, 0.2, 0], [0, -0.2, 0]], np.float32).astype(np.float64)
    )
    quats = rot.quat_multiply(middle, spread) * np.array([[1.0], [-1.0], [1.0], [-1.0]], np.float32)
    moment = (quats[:, :, None] * quats[:, None, :]).sum(0)
    assert rot.quat_angle(rot.mean_rotation(moment), middle) < 1e-6
