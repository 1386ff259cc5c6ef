"""Layers whose parts stand side by side, so that P streams cost one batched product.

Shape legend: P parts, B batch, T frames, D width, H heads, E width of a head, W window.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class PartLinear(nn.Module):
    """P linear maps (P, ..., in) -> (P, ..., out), one per part."""

    def __init__(self, parts: int, inputs: int, outputs: int) -> None:
        super().__init__()
        bound = 1.0 / math.sqrt(inputs)
        self.weight = nn.Parameter(torch.empty(parts, inputs, outputs).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.zeros(parts, 1, outputs))

    def forward(self, x: Tensor) -> Tensor:
        flat = x.reshape(x.shape[0], -1, x.shape[-1])
        out = torch.baddbmm(self.bias, flat, self.weight)
        return out.reshape(*x.shape[:-1], self.weight.shape[-1])


class PartNorm(nn.Module):
    """Layer normalisation with scale and shift per part."""

    def __init__(self, parts: int, width: int) -> None:
        super().__init__()
        self.scale = nn.Parameter(torch.ones(parts, 1, width))
        self.shift = nn.Parameter(torch.zeros(parts, 1, width))

    def forward(self, x: Tensor) -> Tensor:
        flat = F.layer_norm(x.reshape(x.shape[0], -1, x.shape[-1]), x.shape[-1:])
        return (flat * self.scale + self.shift).reshape(x.shape)


class FeedForward(nn.Module):
    """Two linear layers with a ReLU between them, per part."""

    def __init__(self, parts: int, inputs: int, hidden: int, outputs: int) -> None:
        super().__init__()
        self.inner = PartLinear(parts, inputs, hidden)
        self.outer = PartLinear(parts, hidden, outputs)

    def forward(self, x: Tensor) -> Tensor:
        return self.outer(F.relu(self.inner(x)))


def spatial_dropout(x: Tensor, rate: float, training: bool) -> Tensor:
    """Drop whole channels of (P, B, T, D) over all frames (Tompson et al. 2015)."""
    if not training or rate == 0.0:
        return x
    keep = torch.rand(x.shape[0], x.shape[1], 1, x.shape[3], device=x.device) >= rate
    return x * keep.to(x.dtype) / (1.0 - rate)


def sinusoidal_positions(frames: int, width: int, device: torch.device) -> Tensor:
    """Positional encoding (frames, width) of Vaswani et al. 2017."""
    place = torch.arange(frames, device=device, dtype=torch.float32)[:, None]
    rate = torch.exp(torch.arange(0, width, 2, device=device) * (-math.log(10000.0) / width))
    out = torch.zeros(frames, width, device=device)
    out[:, 0::2] = torch.sin(place * rate)
    out[:, 1::2] = torch.cos(place * rate)
    return out
