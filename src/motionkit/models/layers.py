"""Layers of P parts at once, by one batched product for all parts.

Shape legend: P parts, B batch, T frames, D width, H heads, E width of a head, W window.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class PartLinear(nn.Module):
    """P linear maps (P, ..., in) -> (P, ..., out), one per part.

    A map without a bias can be added to a residual in the same product, which saves a pass over memory.
    """

    def __init__(self, parts: int, inputs: int, outputs: int, bias: bool = True) -> None:
        super().__init__()
        bound = 1.0 / math.sqrt(inputs)
        self.weight = nn.Parameter(torch.empty(parts, inputs, outputs).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.zeros(parts, 1, outputs)) if bias else None

    def forward(self, x: Tensor, residual: Tensor | None = None) -> Tensor:
        shape = (*x.shape[:-1], self.weight.shape[-1])
        x = x.reshape(x.shape[0], -1, x.shape[-1])
        if residual is not None:
            assert self.bias is None
            return torch.baddbmm(residual.reshape(shape[0], -1, shape[-1]), x, self.weight).reshape(shape)
        out = torch.bmm(x, self.weight) if self.bias is None else torch.baddbmm(self.bias, x, self.weight)
        return out.reshape(shape)

    def shared(self, x: Tensor) -> Tensor:
        """Map an input (..., in) that all parts share to (P, ..., out), in one product."""
        P, N, M = self.weight.shape
        weight = self.weight.transpose(0, 1).reshape(N, P * M)
        assert self.bias is not None
        out = torch.addmm(self.bias.reshape(P * M), x.reshape(-1, N), weight)
        return out.reshape(-1, P, M).transpose(0, 1).reshape(P, *x.shape[:-1], M)


class PartNorm(nn.Module):
    """Layer normalisation. Scale and shift per part are optional, because a following linear map can absorb them."""

    def __init__(self, parts: int, width: int, affine: bool) -> None:
        super().__init__()
        self.scale = nn.Parameter(torch.ones(parts, 1, 1, width)) if affine else None
        self.shift = nn.Parameter(torch.zeros(parts, 1, 1, width)) if affine else None

    def forward(self, x: Tensor) -> Tensor:
        out = F.layer_norm(x, x.shape[-1:])
        if self.scale is None or self.shift is None:
            return out
        scale, shift = (t if x.dim() == 4 else t[:, 0] for t in (self.scale, self.shift))
        return out * scale + shift


class FeedForward(nn.Module):
    """Two linear layers with a ReLU between them, per part."""

    def __init__(self, parts: int, inputs: int, hidden: int, outputs: int, bias: bool = True) -> None:
        super().__init__()
        self.inner = PartLinear(parts, inputs, hidden)
        self.outer = PartLinear(parts, hidden, outputs, bias)

    def forward(self, x: Tensor, residual: Tensor | None = None) -> Tensor:
        return self.outer(F.relu(self.inner(x)), residual)


def spatial_dropout(x: Tensor, rate: float, training: bool) -> Tensor:
    """Drop whole channels of (P, B, T, D) over all frames (Tompson et al. 2015)."""
    if not training or rate == 0.0:
        return x
    keep = torch.rand(x.shape[0], x.shape[1], 1, x.shape[3], device=x.device) >= rate
    return x * keep.to(x.dtype) / (1.0 - rate)


def sinusoidal_positions(frames: int, width: int, device: torch.device) -> Tensor:
    """Return the positional encoding (frames, width) of Vaswani et al. 2017."""
    place = torch.arange(frames, device=device, dtype=torch.float32)[:, None]
    rate = torch.exp(torch.arange(0, width, 2, device=device) * (-math.log(10000.0) / width))
    out = torch.zeros(frames, width, device=device)
    out[:, 0::2] = torch.sin(place * rate)
    out[:, 1::2] = torch.cos(place * rate)
    return out
