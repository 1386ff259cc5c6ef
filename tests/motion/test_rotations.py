"""Properties of the rotation maths, with samples near no rotation and near half a turn."""

from __future__ import annotations

import itertools
import math

import pytest
import torch
from torch import Tensor

from motionkit.motion import rotations as rot

DTYPES = [torch.float32, torch.float64]
TOLERANCE = {torch.float32: 2e-6, torch.float64: 1e-13}
# An angle read back near half a turn, or from a matrix, is worth half the digits at worst.
ANGLE_TOLERANCE = {torch.float32: 2e-3, torch.float64: 1e-7}
EULER_ORDERS = ["".join(order) for order in itertools.permutations("XYZ")]


def random_axes(count: int, dtype: torch.dtype, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    axes = torch.randn(count, 3, generator=generator, dtype=torch.float64)
    return (axes / axes.norm(dim=-1, keepdim=True)).to(dtype)


def random_quats(count: int, dtype: torch.dtype, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    quats = torch.randn(count, 4, generator=generator, dtype=torch.float64)
    return (quats / quats.norm(dim=-1, keepdim=True)).to(dtype)


def expmaps(dtype: torch.dtype) -> Tensor:
    """Exponential maps of every kind of angle: none, tiny, at the switch of formulas, medium, near pi."""
    switch = rot.SMALL_ANGLE
    angles = [0.0, 1e-30, 1e-12, 1e-7, 0.5 * switch, 0.999 * switch, 1.001 * switch, 1e-3, 0.1, 1.0, 2.0, 3.0]
    angles += [math.pi - 1e-2, math.pi - 1e-4, math.pi - 1e-6]
    axes = torch.cat([random_axes(20, dtype), torch.eye(3, dtype=dtype), -torch.eye(3, dtype=dtype)])
    return (torch.tensor(angles, dtype=dtype)[:, None, None] * axes).reshape(-1, 3)


def same_rotation(a: Tensor, b: Tensor) -> Tensor:
    """How far two unit quaternions are apart, whichever their signs (...)."""
    return torch.minimum((a - b).abs().amax(-1), (a + b).abs().amax(-1))


@pytest.mark.parametrize("dtype", DTYPES)
def test_expmap_round_trip(dtype: torch.dtype) -> None:
    given = expmaps(dtype)
    quats = rot.expmap_to_quat(given)
    assert (quats.norm(dim=-1) - 1).abs().max() < TOLERANCE[dtype]
    back = rot.quat_to_expmap(quats)
    assert (back - given).abs().max() < 4 * TOLERANCE[dtype]


@pytest.mark.parametrize("dtype", DTYPES)
def test_expmap_is_axis_times_full_angle(dtype: torch.dtype) -> None:
    quarter = rot.expmap_to_quat(torch.tensor([0.0, math.pi / 2, 0.0], dtype=dtype))
    turned = rot.quat_rotate(quarter, torch.tensor([0.0, 0.0, 1.0], dtype=dtype))
    assert torch.allclose(turned, torch.tensor([1.0, 0.0, 0.0], dtype=dtype), atol=TOLERANCE[dtype])


@pytest.mark.parametrize("dtype", DTYPES)
def test_expmap_beyond_half_a_turn_is_the_same_rotation(dtype: torch.dtype) -> None:
    axes = random_axes(50, dtype)
    for angle in (3.5, 2 * math.pi - 1e-3, 2 * math.pi, 7.0):
        long_way = rot.expmap_to_quat(angle * axes)
        short_way = rot.expmap_to_quat((angle - 2 * math.pi) * axes)
        assert same_rotation(long_way, short_way).max() < 4 * TOLERANCE[dtype]
        assert rot.quat_to_expmap(long_way).norm(dim=-1).max() <= math.pi + TOLERANCE[dtype]


@pytest.mark.parametrize("dtype", DTYPES)
def test_sign_of_a_quaternion_does_not_matter(dtype: torch.dtype) -> None:
    quats = random_quats(100, dtype)
    assert torch.equal(rot.quat_to_expmap(quats), rot.quat_to_expmap(-quats))
    assert torch.allclose(rot.quat_to_matrix(quats), rot.quat_to_matrix(-quats))


@pytest.mark.parametrize("dtype", DTYPES)
def test_gradients_are_finite_everywhere(dtype: torch.dtype) -> None:
    def through(function, value: Tensor) -> Tensor:
        value = value.clone().requires_grad_(True)
        function(value).square().sum().backward()
        assert value.grad is not None
        return value.grad

    given = torch.cat([expmaps(dtype), torch.zeros(1, 3, dtype=dtype)])
    weights = torch.arange(1.0, 5.0, dtype=dtype)
    assert torch.isfinite(through(lambda v: rot.expmap_to_quat(v) * weights, given)).all()
    assert torch.isfinite(
        through(lambda v: rot.quat_to_expmap(rot.quat_normalize(rot.expmap_to_quat(v))), given)
    ).all()
    quats = torch.cat([rot.expmap_to_quat(given), torch.eye(4, dtype=dtype), -torch.eye(4, dtype=dtype)])
    assert torch.isfinite(through(rot.quat_to_expmap, quats)).all()
    assert torch.isfinite(through(rot.quat_to_matrix, quats)).all()
    assert torch.isfinite(through(rot.matrix_to_quat, rot.quat_to_matrix(quats))).all()
    assert torch.isfinite(through(rot.sixd_to_quat, rot.quat_to_sixd(quats))).all()
    # Two equal rotations: the angle between them is the loss's best case, not a fault.
    assert torch.isfinite(through(lambda v: rot.quat_angle(v, quats), quats)).all()


def test_gradient_of_expmap_agrees_with_finite_differences() -> None:
    given = expmaps(torch.float64)[::7].clone().requires_grad_(True)
    assert torch.autograd.gradcheck(rot.expmap_to_quat, (given,), eps=1e-6, atol=1e-5)
    small = torch.tensor([[0.0, 0.0, 0.0], [1e-6, 0.0, 0.0]], dtype=torch.float64, requires_grad=True)
    round_trip = torch.autograd.functional.jacobian(
        lambda v: rot.quat_to_expmap(rot.expmap_to_quat(v)), small
    )
    assert torch.allclose(round_trip.reshape(6, 6), torch.eye(6, dtype=torch.float64), atol=1e-6)


@pytest.mark.parametrize("dtype", DTYPES)
def test_matrix_round_trip_near_half_turns(dtype: torch.dtype) -> None:
    half_turns = torch.cat(
        [
            torch.zeros(206, 1, dtype=dtype),
            torch.cat([random_axes(200, dtype), *[torch.eye(3, dtype=dtype)] * 2]),
        ],
        -1,
    )
    quats = torch.cat([random_quats(500, dtype), half_turns, rot.expmap_to_quat(expmaps(dtype))])
    matrices = rot.quat_to_matrix(quats)
    unit = torch.eye(3, dtype=dtype).expand_as(matrices)
    assert (matrices @ matrices.transpose(-1, -2) - unit).abs().max() < 4 * TOLERANCE[dtype]
    assert (torch.linalg.det(matrices) - 1).abs().max() < 4 * TOLERANCE[dtype]
    back = rot.matrix_to_quat(matrices)
    assert same_rotation(back, quats).max() < 4 * TOLERANCE[dtype]
    assert (back[..., 0] >= 0).all()


@pytest.mark.parametrize("dtype", DTYPES)
def test_product_and_rotate_agree_with_matrices(dtype: torch.dtype) -> None:
    a, b = random_quats(200, dtype, 1), random_quats(200, dtype, 2)
    vectors = 10 * random_axes(200, dtype, 3)
    product = rot.quat_to_matrix(rot.quat_multiply(a, b))
    assert (product - rot.quat_to_matrix(a) @ rot.quat_to_matrix(b)).abs().max() < 4 * TOLERANCE[dtype]
    turned = (rot.quat_to_matrix(a) @ vectors[..., None]).squeeze(-1)
    assert (rot.quat_rotate(a, vectors) - turned).abs().max() < 40 * TOLERANCE[dtype]
    there_and_back = rot.quat_multiply(a, rot.quat_inverse(a))
    assert same_rotation(there_and_back, rot.quat_identity((200,), dtype)).max() < 4 * TOLERANCE[dtype]


def test_leading_dimensions_broadcast() -> None:
    quats = random_quats(6, torch.float32).reshape(2, 3, 4)
    vector = torch.tensor([1.0, 2.0, 3.0])
    assert rot.quat_rotate(quats, vector).shape == (2, 3, 3)
    assert rot.quat_rotate(quats[:1, :1], vector.expand(5, 7, 3)).shape == (5, 7, 3)
    assert rot.quat_to_matrix(quats).shape == (2, 3, 3, 3)
    assert rot.quat_to_euler(quats, "ZYX").shape == (2, 3, 3)
    assert rot.quat_multiply(quats, quats[0]).shape == (2, 3, 4)
    assert rot.quat_to_expmap(quats[:0]).shape == (0, 3, 3)


@pytest.mark.parametrize("order", EULER_ORDERS)
@pytest.mark.parametrize("dtype", DTYPES)
def test_euler_round_trip(order: str, dtype: torch.dtype) -> None:
    quats = torch.cat([random_quats(300, dtype), rot.expmap_to_quat(expmaps(dtype))])
    angles = rot.quat_to_euler(quats, order)
    assert angles[..., 1].abs().max() <= math.pi / 2 + TOLERANCE[dtype]
    assert same_rotation(rot.euler_to_quat(angles, order), quats).max() < ANGLE_TOLERANCE[dtype]


@pytest.mark.parametrize("order", EULER_ORDERS)
def test_euler_order_is_outermost_first(order: str) -> None:
    angles = torch.tensor([0.3, -0.7, 1.1], dtype=torch.float64)
    matrix = torch.eye(3, dtype=torch.float64)
    for axis, angle in zip(order, angles.tolist(), strict=True):
        i = "XYZ".index(axis)
        j, k = (i + 1) % 3, (i + 2) % 3
        one = torch.eye(3, dtype=torch.float64)
        one[j, j] = one[k, k] = math.cos(angle)
        one[k, j], one[j, k] = math.sin(angle), -math.sin(angle)
        matrix = matrix @ one
    assert torch.allclose(rot.quat_to_matrix(rot.euler_to_quat(angles, order)), matrix, atol=1e-12)


@pytest.mark.parametrize("order", EULER_ORDERS)
def test_euler_at_the_pole(order: str) -> None:
    for sign, first, last in itertools.product((1, -1), (-2.0, 0.0, 1.0), (-1.0, 0.0, 2.0)):
        angles = torch.tensor([first, sign * math.pi / 2, last], dtype=torch.float64)
        quat = rot.euler_to_quat(angles, order)
        back = rot.quat_to_euler(quat, order)
        assert same_rotation(rot.euler_to_quat(back, order), quat) < 1e-6


def test_euler_of_one_and_two_channels() -> None:
    angle = torch.tensor([[0.4], [-2.0]], dtype=torch.float64)
    expected = rot.expmap_to_quat(torch.cat([angle, torch.zeros(2, 2, dtype=torch.float64)], -1))
    assert same_rotation(rot.euler_to_quat(angle, "X"), expected).max() < 1e-12
    assert (
        same_rotation(rot.euler_to_quat(angle[:, :0], ""), rot.quat_identity((2,), torch.float64)).max() == 0
    )


@pytest.mark.parametrize("dtype", DTYPES)
def test_slerp_moves_evenly_the_shorter_way(dtype: torch.dtype) -> None:
    a, b = random_quats(200, dtype, 1), random_quats(200, dtype, 2)
    whole = rot.quat_angle(a, b)
    for share in (0.0, 0.25, 0.5, 1.0):
        fraction = torch.full((200,), share, dtype=dtype)
        between = rot.quat_slerp(a, b, fraction)
        assert (rot.quat_angle(a, between) - share * whole).abs().max() < ANGLE_TOLERANCE[dtype]
        assert same_rotation(between, rot.quat_slerp(a, -b, fraction)).max() < 4 * TOLERANCE[dtype]
    nearly = rot.quat_multiply(a, rot.expmap_to_quat(1e-6 * random_axes(200, dtype)))
    half = rot.quat_slerp(a, nearly, torch.full((200,), 0.5, dtype=dtype))
    assert torch.isfinite(half).all() and same_rotation(half, a).max() < 4 * TOLERANCE[dtype] + 1e-6


@pytest.mark.parametrize("dtype", DTYPES)
def test_quat_between_directions(dtype: torch.dtype) -> None:
    source = torch.cat([random_axes(100, dtype, 1), *[torch.eye(3, dtype=dtype)] * 3])
    target = torch.cat(
        [
            random_axes(100, dtype, 2),
            torch.eye(3, dtype=dtype),
            -torch.eye(3, dtype=dtype),
            torch.eye(3, dtype=dtype).roll(1, 0),
        ]
    )
    quats = rot.quat_between(3 * source, 5 * target)
    assert (rot.quat_rotate(quats, source) - target).abs().max() < ANGLE_TOLERANCE[dtype]
    assert (quats.norm(dim=-1) - 1).abs().max() < TOLERANCE[dtype]


@pytest.mark.parametrize("dtype", DTYPES)
def test_sixd_round_trip_and_repair(dtype: torch.dtype) -> None:
    quats = torch.cat([random_quats(200, dtype), rot.expmap_to_quat(expmaps(dtype))])
    sixd = rot.quat_to_sixd(quats)
    assert same_rotation(rot.sixd_to_quat(sixd), quats).max() < 8 * TOLERANCE[dtype]
    sheared = sixd.clone()
    sheared[..., 3:] += 0.3 * sixd[..., :3]
    assert same_rotation(rot.sixd_to_quat(2 * sheared), quats).max() < 8 * TOLERANCE[dtype]


def test_quat_continuous_keeps_rotations_and_closes_gaps() -> None:
    seconds = torch.linspace(0, 8 * math.pi, 400, dtype=torch.float64)
    quats = rot.quat_from_yaw(seconds)[:, None].repeat(1, 3, 1)
    flipped = quats * torch.where(
        torch.rand(400, 3, 1, generator=torch.Generator().manual_seed(0)) < 0.5, -1, 1
    )
    smooth = rot.quat_continuous(flipped)
    assert ((smooth[1:] * smooth[:-1]).sum(-1) > 0).all()
    assert same_rotation(smooth, quats).max() == 0


def test_unwrap_expmap_follows_a_turn_through_pi() -> None:
    angles = torch.linspace(0.2, 2 * math.pi - 0.5, 200, dtype=torch.float64)
    axis = random_axes(1, torch.float64)
    wrapped = rot.quat_to_expmap(rot.expmap_to_quat(angles[:, None] * axis))
    assert (wrapped[1:] - wrapped[:-1]).norm(dim=-1).max() > 6.0
    unwrapped = rot.unwrap_expmap(wrapped)
    assert (unwrapped[1:] - unwrapped[:-1]).norm(dim=-1).max() < 0.05
    assert same_rotation(rot.expmap_to_quat(unwrapped), rot.expmap_to_quat(wrapped)).max() < 1e-9


def test_yaw_and_ground_turns_agree() -> None:
    yaw = torch.linspace(-4, 4, 30, dtype=torch.float64)
    xz = random_axes(30, torch.float64)[:, :2]
    lifted = torch.stack([xz[:, 0], torch.zeros(30, dtype=torch.float64), xz[:, 1]], dim=-1)
    turned = rot.quat_rotate(rot.quat_from_yaw(yaw), lifted)
    assert torch.allclose(rot.rotate_ground(yaw, xz), turned[:, [0, 2]], atol=1e-12)


def test_wrap_angle_range() -> None:
    angles = torch.tensor([-7.0, -math.pi, 0.0, math.pi, 3.2, 100.0], dtype=torch.float64)
    wrapped = rot.wrap_angle(angles)
    assert ((wrapped >= -math.pi) & (wrapped < math.pi)).all()
    assert torch.allclose(torch.sin(wrapped), torch.sin(angles)) and torch.allclose(
        torch.cos(wrapped), torch.cos(angles)
    )


def test_mean_rotation_lies_between() -> None:
    middle = random_quats(1, torch.float64)[0]
    spread = rot.expmap_to_quat(torch.tensor([[0.3, 0, 0], [-0.3, 0, 0], [0, 0.2, 0], [0, -0.2, 0]]).double())
    quats = rot.quat_multiply(middle, spread) * torch.tensor([[1.0], [-1.0], [1.0], [-1.0]])
    moment = (quats[:, :, None] * quats[:, None, :]).sum(0)
    assert rot.quat_angle(rot.mean_rotation(moment), middle) < 1e-6
