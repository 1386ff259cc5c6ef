"""Causal attention over a short window of frames: exact, and linear in time.

Plain matrix products multiply blocks of 16 queries with the 16 + W - 1 keys that they can see. So the cost is linear in
the length; with a full mask it would be quadratic.
Shape legend: P parts, B batch, T frames, D width, H heads, E width of a head, W window.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from motionkit.models.attention_kernel import attend, can_attend
from motionkit.models.layers import PartLinear

BLOCK = 16


class LocalAttention(nn.Module):
    """Multi-head self-attention of each frame over itself and the W - 1 frames before, added to a residual.

    in_torch computes in torch where the C kernel could.
    """

    in_torch = False

    def __init__(self, parts: int, width: int, heads: int, window: int, bias: bool) -> None:
        super().__init__()
        assert window - 1 <= BLOCK
        self.heads, self.window = heads, window
        self.qkv = PartLinear(parts, width, 3 * width)
        self.out = PartLinear(parts, width, width, bias=False)
        # One learned number per head and distance in frames (0 = the frame itself).
        self.offset_bias = nn.Parameter(torch.zeros(parts, heads, window)) if bias else None

    def forward(self, x_PBTD: Tensor, residual: Tensor, query: Tensor | None = None) -> Tensor:
        """Attend from frames x, or from other features `query` (P, B, T, D), to frames x, and add to the residual."""
        if query is None and not self.in_torch and can_attend(x_PBTD, self.heads, self.window):
            none = x_PBTD.new_zeros(x_PBTD.shape[0], self.heads, self.window, dtype=torch.float32)
            return self._by_kernel(x_PBTD, residual, none if self.offset_bias is None else self.offset_bias)
        P, B, T, D = x_PBTD.shape
        H, E = self.heads, D // self.heads
        blocks = -(-T // BLOCK)
        made = self.qkv(x_PBTD)
        if query is not None:
            made = torch.cat([self.qkv(query)[..., :D], made[..., D:]], dim=-1)
        qkv = made.reshape(P, B, T, 3, H, E).permute(3, 0, 1, 4, 2, 5)
        qkv = F.pad(qkv, (0, 0, 0, blocks * BLOCK - T)).reshape(3, P, B, H, blocks, BLOCK, E)
        q, k, v = qkv.unbind(0)
        k, v = self._with_reach(k), self._with_reach(v)  # (P, B, H, blocks, reach + BLOCK, E)
        scores = torch.matmul(q, k.transpose(-1, -2))
        mask = self._mask(P, blocks, x_PBTD.device)
        weights = torch.softmax(torch.add(mask, scores, alpha=1.0 / math.sqrt(E)), dim=-1).to(v.dtype)
        mixed = torch.matmul(weights, v).reshape(P, B, H, blocks * BLOCK, E)[:, :, :, :T]
        return self.out(mixed.transpose(2, 3).reshape(P, B, T, D), residual)

    def _by_kernel(self, x_PBTD: Tensor, residual: Tensor, offset_bias: Tensor) -> Tensor:
        """Compute forward() with the C kernel, which needs the heads of a channel side by side."""
        P, B, T, D = x_PBTD.shape
        H, E = self.heads, D // self.heads
        assert self.qkv.bias is not None
        heads_last = self.qkv.weight.reshape(P, D, 3, H, E).transpose(-1, -2).reshape(P, D, 3 * D)
        qkv = torch.bmm(x_PBTD.reshape(P, B * T, D), heads_last).reshape(P, B, T, 3, E, H)
        bias = self.qkv.bias.reshape(P, 3, H, E).transpose(-1, -2)
        mixed = attend(qkv, bias, offset_bias.transpose(-1, -2)).reshape(P, B * T, D)
        out = self.out.weight.reshape(P, H, E, D).transpose(1, 2).reshape(P, D, D)
        return torch.baddbmm(residual.reshape(P, B * T, D), mixed, out).reshape(P, B, T, D)

    def _with_reach(self, x: Tensor) -> Tensor:
        """Prepend to each block (..., blocks, BLOCK, E) the last W - 1 rows of the block before."""
        tails = x[..., :-1, BLOCK - self.window + 1 :, :]
        tails = F.pad(tails, (0, 0, 0, 0, 1, 0))
        return torch.cat([tails, x], dim=-2)

    def _mask(self, parts: int, blocks: int, device: torch.device) -> Tensor:
        """Return a mask to add to scores (P, B, H, blocks, BLOCK, keys): the bias in the window, -inf outside."""
        reach = self.window - 1
        query = torch.arange(BLOCK, device=device)[:, None]
        key = torch.arange(BLOCK + reach, device=device)[None, :] - reach
        distance = query - key
        inside = (distance >= 0) & (distance < self.window)
        # There are no frames before the first.
        allowed = torch.stack([inside & (key >= 0)] + [inside] * (blocks - 1))
        zero = torch.zeros((), device=device)
        mask = torch.where(allowed, zero, zero - torch.inf)
        if self.offset_bias is None:
            return mask
        bias = self.offset_bias[:, :, distance.clamp(0, self.window - 1)]
        return mask + bias.reshape(parts, 1, self.heads, 1, BLOCK, BLOCK + reach)

    def step(
        self, x_PBD: Tensor, residual: Tensor, keys: Tensor, values: Tensor, slot: int, bias: Tensor
    ) -> Tensor:
        """Attend from one new frame to a ring of W keys and values, (P, B, H, W, E), and write the frame into a slot.

        The result is added to a residual (P, B, D). bias (P, 1, H, 1, W) is of each ring slot; -inf for empty ones.
        """
        P, B, D = x_PBD.shape
        H, E = self.heads, D // self.heads
        q, k, v = self.qkv(x_PBD).reshape(P, B, 3, H, E).unbind(2)
        keys[:, :, :, slot] = k
        values[:, :, :, slot] = v
        scores = torch.matmul(q.unsqueeze(-2), keys.transpose(-1, -2)) / math.sqrt(E) + bias
        mixed = torch.matmul(torch.softmax(scores, dim=-1), values)
        return self.out(mixed.reshape(P, B, D), residual)

    def ring_bias(self, frame: int, device: torch.device) -> Tensor:
        """Return the bias (P, 1, H, 1, W) of step() at a frame number since the start of the stream."""
        slots = torch.arange(self.window, device=device)
        distance = torch.remainder(frame - slots, self.window)
        empty = torch.where(distance > frame, -torch.inf, 0.0)
        if self.offset_bias is None:
            return empty.reshape(1, 1, 1, 1, -1)
        bias = self.offset_bias[:, :, distance] + empty
        return bias[:, None, :, None, :]
