from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from motionkit.models import attention
from motionkit.models.attention import BLOCK, LocalAttention


def naive_attention(layer: LocalAttention, x: Tensor, residual: Tensor) -> Tensor:
    """The same with one full T x T mask and loops over parts and heads."""
    P, _, T, D = x.shape
    H, E = layer.heads, D // layer.heads
    out = torch.zeros_like(x)
    distance = torch.arange(T)[:, None] - torch.arange(T)[None, :]
    allowed = (distance >= 0) & (distance < layer.window)
    for p in range(P):
        q, k, v = (x[p] @ layer.qkv.weight[p] + layer.qkv.bias[p]).split(D, dim=-1)
        mixed = []
        for h in range(H):
            own = slice(h * E, (h + 1) * E)
            scores = q[..., own] @ k[..., own].transpose(-1, -2) / math.sqrt(E)
            if layer.offset_bias is not None:
                scores = scores + layer.offset_bias[p, h][distance.clamp(0, layer.window - 1)]
            scores = scores.masked_fill(~allowed, -torch.inf)
            mixed.append(torch.softmax(scores, dim=-1) @ v[..., own])
        out[p] = residual[p] + torch.cat(mixed, dim=-1) @ layer.out.weight[p]
    return out


def make_layer(parts: int, width: int, heads: int, window: int, bias: bool) -> LocalAttention:
    torch.manual_seed(0)
    layer = LocalAttention(parts, width, heads, window, bias).double()
    if layer.offset_bias is not None:
        with torch.no_grad():
            layer.offset_bias.normal_()
    with torch.no_grad():
        layer.qkv.bias.normal_()
    return layer


@pytest.mark.parametrize("bias", [True, False])
@pytest.mark.parametrize("window", [1, 4, 8, 12, 17])
@pytest.mark.parametrize("frames", [1, 7, BLOCK, BLOCK + 1, 50])
def test_blocks_equal_a_full_mask(window: int, frames: int, bias: bool) -> None:
    layer = make_layer(2, 12, 3, window, bias)
    x = torch.randn(2, 2, frames, 12, dtype=torch.float64)
    residual = torch.randn_like(x)
    with torch.no_grad():
        assert torch.allclose(layer(x, residual), naive_attention(layer, x, residual), atol=1e-12)


def test_gradients_equal_those_of_a_full_mask() -> None:
    layer = make_layer(2, 8, 2, 4, True)
    x = torch.randn(2, 1, 21, 8, dtype=torch.float64, requires_grad=True)
    weights = torch.randn(2, 1, 21, 8, dtype=torch.float64)
    for p in layer.parameters():
        p.requires_grad_()
    inputs = [x, *layer.parameters()]
    fast = torch.autograd.grad((layer(x, x) * weights).sum(), inputs)
    naive = torch.autograd.grad((naive_attention(layer, x, x) * weights).sum(), inputs)
    for a, b in zip(fast, naive, strict=True):
        assert torch.allclose(a, b, atol=1e-10)


@pytest.mark.parametrize("bias", [True, False])
def test_steps_with_a_ring_equal_the_batch(bias: bool) -> None:
    layer = make_layer(2, 12, 3, 8, bias)
    x = torch.randn(2, 2, 40, 12, dtype=torch.float64)
    with torch.no_grad():
        whole = layer(x, x)
        # What a ring held before must not show.
        keys, values = (torch.full((2, 2, 3, 8, 4), 7.0, dtype=torch.float64) for _ in range(2))
        for t in range(40):
            ring_bias = layer.ring_bias(t, x.device)
            out = layer.step(x[:, :, t], x[:, :, t], keys, values, t % 8, ring_bias)
            assert torch.allclose(out, whole[:, :, t], atol=1e-12), t


# ---- the C kernel ----


def values_and_gradients(layer: LocalAttention, x: Tensor, autocast: bool = False) -> list[Tensor]:
    """The output for x, also as residual, and the gradients of x and of the layer's parameters."""
    x = x.clone().requires_grad_()
    weights = torch.randn(x.shape, generator=torch.Generator().manual_seed(1))
    with torch.autocast("cpu", torch.bfloat16, enabled=autocast):
        out = layer(x, x)
    gradients = torch.autograd.grad((out.float() * weights).sum(), [x, *layer.parameters()])
    return [out.detach().float(), *gradients]


def by_blocks(monkeypatch: pytest.MonkeyPatch, layer: LocalAttention, x: Tensor) -> list[Tensor]:
    with monkeypatch.context() as patched:
        patched.setattr(attention, "can_attend", lambda *_: False)
        return values_and_gradients(layer, x)


@pytest.mark.parametrize(
    ("frames", "width", "window"), [(1, 8, 8), (5, 40, 8), (40, 88, 17), (30, 128, 1), (96, 128, 8)]
)
def test_kernel_equals_blocks(monkeypatch: pytest.MonkeyPatch, frames: int, width: int, window: int) -> None:
    layer = make_layer(3, width, 8, window, True).float()
    x = torch.randn(3, 2, frames, width)
    for one, other in zip(values_and_gradients(layer, x), by_blocks(monkeypatch, layer, x), strict=True):
        assert torch.allclose(one, other, atol=2e-6 * float(other.abs().max() + 1))


def test_kernel_in_bfloat16_is_close(monkeypatch: pytest.MonkeyPatch) -> None:
    layer = make_layer(2, 128, 8, 8, True).float()
    x = torch.randn(2, 4, 40, 128)
    for one, other in zip(
        values_and_gradients(layer, x, True), by_blocks(monkeypatch, layer, x), strict=True
    ):
        assert float((one - other).norm()) < 0.02 * float(other.norm()) + 1e-6


def test_threads_change_no_number_of_the_kernel() -> None:
    layer, x = make_layer(2, 64, 8, 8, True).float(), torch.randn(2, 5, 20, 64)
    threads, found = torch.get_num_threads(), []
    for count in (1, 3):
        torch.set_num_threads(count)
        with torch.no_grad():
            found.append(layer(x, x))
    torch.set_num_threads(threads)
    assert torch.equal(*found)


def test_without_the_kernel_blocks_do_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(attention, "can_attend", lambda *_: False)
    layer, x = make_layer(2, 16, 8, 8, True).float(), torch.randn(2, 1, 9, 16)
    with torch.no_grad():
        assert torch.allclose(layer(x, x), naive_attention(layer, x, x), atol=1e-5)
