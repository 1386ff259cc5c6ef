"""The differentiable rotations: the same numbers as numpy's, and finite gradients everywhere."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from motionkit.models import torch_rotations as ours
from motionkit.motion import rotations as reference

DTYPES = [torch.float32, torch.float64]


def expmaps(dtype: torch.dtype) -> Tensor:
    """Random ones, tiny ones, and some near half a turn and beyond it."""
    draw = torch.Generator().manual_seed(0)
    axes = torch.nn.functional.normalize(torch.randn(60, 3, generator=draw, dtype=torch.float64), dim=-1)
    angles = torch.cat(
        [
            torch.rand(30, generator=draw) * 3.0,
            torch.logspace(-9, -3, 15),
            torch.pi + torch.linspace(-1e-4, 1.0, 15),
        ]
    )
    return torch.cat([axes * angles[:, None], torch.zeros(1, 3)]).to(dtype)


def quats(dtype: torch.dtype) -> Tensor:
    """Unit quaternions, half turns about the axes among them."""
    turns = torch.from_numpy(reference.expmap_to_quat(expmaps(dtype).numpy()))
    return torch.cat([turns, torch.eye(4, dtype=dtype), -torch.eye(4, dtype=dtype)])


def sixd(dtype: torch.dtype) -> Tensor:
    """Two columns each of the matrices of quats."""
    return torch.from_numpy(reference.quat_to_sixd(quats(dtype).numpy()))


def same(found: Tensor, expected: np.ndarray) -> None:
    """Compare with matrices (..., 3, 3) or vectors (..., 3) of numpy."""
    first = np.moveaxis(expected, (-2, -1), (0, 1)) if expected.ndim > 2 else expected.T
    assert found.dtype == torch.from_numpy(expected).dtype
    np.testing.assert_allclose(found.numpy(), first, atol=1e-6 if found.dtype == torch.float32 else 1e-12)


@pytest.mark.parametrize("dtype", DTYPES)
def test_matrices_are_those_of_numpy(dtype: torch.dtype) -> None:
    matrix, yaw = reference.quat_to_matrix, torch.linspace(-7.0, 7.0, 50, dtype=dtype)
    same(ours.yaw_to_matrix(yaw), matrix(reference.quat_from_yaw(yaw.numpy())))
    same(ours.sixd_to_matrix(sixd(dtype)), matrix(reference.sixd_to_quat(sixd(dtype).numpy())))
    given = expmaps(dtype)
    same(ours.expmap_to_matrix(given.T), matrix(reference.expmap_to_quat(given.numpy())))


@pytest.mark.parametrize("dtype", DTYPES)
def test_products_are_those_of_numpy(dtype: torch.dtype) -> None:
    a, b = (reference.quat_to_matrix(each.numpy()) for each in (quats(dtype), quats(dtype).flip(0)))
    vectors = np.random.default_rng(0).standard_normal((len(a), 3)).astype(a.dtype)
    first, second = (torch.from_numpy(np.moveaxis(each, 0, -1).copy()) for each in (a, b))
    same(ours.multiply(first, second), a @ b)
    same(ours.rotate(first, torch.from_numpy(vectors.T.copy())), (a @ vectors[..., None])[..., 0])


def gradient(function: Callable[[Tensor], Tensor], value: Tensor) -> Tensor:
    """That of the weighted sum of what a function makes of a value."""
    value = value.clone().requires_grad_(True)
    made = function(value)
    (made * torch.arange(1.0, made.numel() + 1.0, dtype=made.dtype).reshape(made.shape)).sum().backward()
    assert value.grad is not None
    return value.grad


@pytest.mark.parametrize("dtype", DTYPES)
def test_gradients_are_finite_everywhere(dtype: torch.dtype) -> None:
    assert gradient(ours.expmap_to_matrix, expmaps(dtype).T).isfinite().all()
    assert gradient(ours.sixd_to_matrix, sixd(dtype)).isfinite().all()


def test_gradient_of_expmap_agrees_with_finite_differences() -> None:
    given = expmaps(torch.float64)[::7].T.clone().requires_grad_(True)
    assert torch.autograd.gradcheck(ours.expmap_to_matrix, (given,), eps=1e-6, atol=1e-5)
