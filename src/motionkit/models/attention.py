"""Causal attention over a short window of frames: exact, and linear in time.

Queries go in blocks of 16 against the 16 + W - 1 keys they can reach, with plain matrix products: the
cost of a full mask grows with the square of the length, this one with the length.
Shape legend: P parts, B batch, T frames, D width, H heads, E width of a head, W window.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from motionkit.models.layers import PartLinear

BLOCK = 16


class LocalAttention(nn.Module):
    """Multi-head self-attention of each frame over itself and the W - 1 frames before."""

    def __init__(self, parts: int, width: int, heads: int, window: int, bias: bool) -> None:
        super().__init__()
        self.heads, self.window = heads, window
        self.qkv = PartLinear(parts, width, 3 * width)
        self.out = PartLinear(parts, width, width)
        # One learned number per head and distance in frames (0 = the frame itself).
        self.offset_bias = nn.Parameter(torch.zeros(parts, heads, window)) if bias else None

    def forward(self, x_PBTD: Tensor) -> Tensor:
        P, B, T, D = x_PBTD.shape
        H, E = self.heads, D // self.heads
        blocks = -(-T // BLOCK)
        pad = blocks * BLOCK - T
        q, k, v = self.qkv(x_PBTD).reshape(P, B, T, 3, H, E).unbind(3)
        q = F.pad(q, (0, 0, 0, 0, 0, pad)).reshape(P, B, blocks, BLOCK, H, E)
        reach = self.window - 1
        k, v = (F.pad(t, (0, 0, 0, 0, reach, pad)).unfold(2, BLOCK + reach, BLOCK) for t in (k, v))
        # unfold leaves (P, B, blocks, H, E, BLOCK + reach)
        scores = torch.matmul(q.transpose(3, 4), k) / math.sqrt(E)  # (P, B, blocks, H, BLOCK, keys)
        scores = scores.float() + self._mask(P, blocks, x_PBTD.device)
        weights = torch.softmax(scores, dim=-1).to(v.dtype)
        mixed = torch.matmul(weights, v.transpose(-1, -2))  # (P, B, blocks, H, BLOCK, E)
        mixed = mixed.transpose(3, 4).reshape(P, B, blocks * BLOCK, D)[:, :, :T]
        return self.out(mixed)

    def _mask(self, parts: int, blocks: int, device: torch.device) -> Tensor:
        """Additive mask, broadcastable to (P, B, blocks, H, BLOCK, keys): the bias inside the window, -inf outside."""
        reach = self.window - 1
        query = torch.arange(BLOCK, device=device)[:, None]
        key = torch.arange(BLOCK + reach, device=device)[None, :] - reach
        distance = query - key
        inside = (distance >= 0) & (distance < self.window)
        first = inside & (key >= 0)  # before the first frame there is nothing
        allowed = torch.stack([first] + [inside] * (blocks - 1))
        zero = torch.zeros((), device=device)
        mask = torch.where(allowed, zero, zero - torch.inf)[None, None, :, None]
        if self.offset_bias is None:
            return mask
        bias = self.offset_bias[:, :, distance.clamp(0, self.window - 1)]
        return mask + bias.reshape(parts, 1, 1, self.heads, BLOCK, BLOCK + reach)

    def step(self, x_PBD: Tensor, keys: Tensor, values: Tensor, slot: int, bias: Tensor) -> Tensor:
        """One frame against a ring of W keys and values, which it writes into.

        Args:
            x_PBD: the new frame.
            keys, values: (P, B, H, W, E) rings, changed in place.
            slot: the place in the ring of this frame.
            bias: (P, 1, H, 1, W) per ring place, -inf where nothing has been written yet.
        """
        P, B, D = x_PBD.shape
        H, E = self.heads, D // self.heads
        q, k, v = self.qkv(x_PBD).reshape(P, B, 3, H, E).unbind(2)
        keys[:, :, :, slot] = k
        values[:, :, :, slot] = v
        scores = torch.matmul(q.unsqueeze(-2), keys.transpose(-1, -2)) / math.sqrt(E) + bias
        mixed = torch.matmul(torch.softmax(scores, dim=-1), values)
        return self.out(mixed.reshape(P, B, D))

    def ring_bias(self, frame: int, device: torch.device) -> Tensor:
        """The bias (P, 1, H, 1, W) of step() at a frame counted from the start of the stream."""
        slots = torch.arange(self.window, device=device)
        distance = torch.remainder(frame - slots, self.window)
        empty = torch.where(distance > frame, -torch.inf, 0.0)
        if self.offset_bias is None:
            return empty.reshape(1, 1, 1, 1, -1)
        bias = self.offset_bias[:, :, distance] + empty
        return bias[:, None, :, None, :]
