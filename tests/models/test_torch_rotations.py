"""The differentiable rotations: the same numbers as numpy's, and finite gradients everywhere."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from motionkit.features import decode
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
    return torch.cat(
        [ours.expmap_to_quat(expmaps(dtype)), torch.eye(4, dtype=dtype), -torch.eye(4, dtype=dtype)]
    )


def sixd(dtype: torch.dtype) -> Tensor:
    """Two columns each of the matrices of quats."""
    return torch.from_numpy(reference.quat_to_sixd(quats(dtype).numpy()))


def matrices(dtype: torch.dtype) -> Tensor:
    """The matrices of quats."""
    return torch.from_numpy(reference.quat_to_matrix(quats(dtype).numpy()))


PAIRS: dict[str, Callable[[torch.dtype], tuple[Tensor, ...]]] = {
    "quat_multiply": lambda dtype: (quats(dtype), quats(dtype).flip(0)),
    "quat_rotate": lambda dtype: (quats(dtype), torch.randn(len(quats(dtype)), 3, dtype=dtype)),
    "quat_from_yaw": lambda dtype: (torch.linspace(-7.0, 7.0, 50, dtype=dtype),),
    "expmap_to_quat": lambda dtype: (expmaps(dtype),),
    "matrix_to_quat": lambda dtype: (matrices(dtype),),
    "sixd_to_quat": lambda dtype: (sixd(dtype),),
}


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("name", PAIRS)
def test_the_same_as_numpy(name: str, dtype: torch.dtype) -> None:
    given = PAIRS[name](dtype)
    expected = getattr(reference, name)(*(values.numpy() for values in given))
    found = getattr(ours, name)(*given)
    assert found.dtype == dtype
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-6 if dtype == torch.float32 else 1e-12)


@pytest.mark.parametrize("layout", ["sixd-root-1", "expmap-root-1"])
def test_decoded_rotations_are_the_same(layout: str) -> None:
    draw = torch.Generator().manual_seed(1)
    features, reference_rotations = torch.randn(7, 3, 276, generator=draw), torch.randn(23, 4, generator=draw)
    reference_rotations = torch.nn.functional.normalize(reference_rotations, dim=-1)
    expected = decode.decode_rotations(features.numpy(), reference_rotations.numpy(), layout)
    np.testing.assert_allclose(
        ours.decode_rotations(features, reference_rotations, layout).numpy(), expected, atol=1e-5
    )


def gradient(function: Callable[[Tensor], Tensor], value: Tensor) -> Tensor:
    """That of the sum of squares of what a function makes of a value."""
    value = value.clone().requires_grad_(True)
    function(value).square().sum().backward()
    assert value.grad is not None
    return value.grad


@pytest.mark.parametrize("dtype", DTYPES)
def test_gradients_are_finite_everywhere(dtype: torch.dtype) -> None:
    weights = torch.arange(1.0, 5.0, dtype=dtype)
    assert gradient(lambda v: ours.expmap_to_quat(v) * weights, expmaps(dtype)).isfinite().all()
    assert gradient(lambda v: ours.matrix_to_quat(v) * weights, matrices(dtype)).isfinite().all()
    assert gradient(lambda v: ours.sixd_to_quat(v) * weights, sixd(dtype)).isfinite().all()


def test_gradient_of_expmap_agrees_with_finite_differences() -> None:
    given = expmaps(torch.float64)[::7].clone().requires_grad_(True)
    assert torch.autograd.gradcheck(ours.expmap_to_quat, (given,), eps=1e-6, atol=1e-5)
