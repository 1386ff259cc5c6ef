"""Causal attention over a short window of frames: exact, and linear in time.

Plain matrix products multiply blocks of 16 queries with the 16 + W - 1 keys that they can see. So the cost is linear in
the length; with a full mask it would be quadratic.
Shape legend: P parts, B batch, T frames, D width, H heads, E width of a head, W window.
"""

from __future__ import annotations

import functools
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
        if T % BLOCK:
            qkv = F.pad(qkv, (0, 0, 0, blocks * BLOCK - T))
        qkv = qkv.reshape(3, P, B, H, blocks, BLOCK, E)
        k, v = self._with_reach(qkv[1:])  # (P, B, H, blocks, reach + BLOCK, E)
        scores = torch.matmul(qkv[0], k.transpose(-1, -2))
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
        distance, first, later = _block_window(self.window, device)
        mask = torch.cat([first, later.expand(blocks - 1, -1, -1)])
        if self.offset_bias is None:
            return mask
        return mask + self.offset_bias[:, :, distance].reshape(parts, 1, self.heads, 1, *distance.shape)

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
        scores = torch.matmul(q.unsqueeze(-2), keys.transpose(-1, -2))
        scores = torch.add(bias, scores, alpha=1.0 / math.sqrt(E))
        mixed = torch.matmul(torch.softmax(scores, dim=-1), values)
        return self.out(mixed.reshape(P, B, D), residual)

    def ring_bias(self, frame: int, device: torch.device) -> Tensor:
        """Return the bias (P, 1, H, 1, W) of step() at a frame number since the start of the stream."""
        distances, empty = _ring_window(self.window, device)
        row = frame if frame < self.window else self.window + frame % self.window
        if self.offset_bias is None:
            return empty[row].reshape(1, 1, 1, 1, -1)
        bias = self.offset_bias[:, :, distances[row]]
        bias = bias + empty[row] if frame < self.window else bias
        return bias[:, None, :, None, :]


# Constants are kept, because a GPU spends as long on each small kernel as on a large one. All of them are kept, because
# a CUDA graph goes on reading those that it was captured with.


@functools.cache
@torch.inference_mode(False)
def _block_window(window: int, device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    """Return what the queries of a block see of its keys.

    Returns:
        The distance in frames (BLOCK, keys), within 0 to W - 1; and 0 in the window, -inf outside (1, BLOCK, keys), for
        the first block, which has no frames before it, and for later ones.
    """
    key = torch.arange(BLOCK + window - 1, device=device)[None, :] - (window - 1)
    distance = torch.arange(BLOCK, device=device)[:, None] - key
    outside = (distance < 0) | (distance >= window)
    zero = torch.zeros(distance.shape, device=device)
    first, later = (zero.masked_fill(hidden, -torch.inf)[None] for hidden in (outside | (key < 0), outside))
    return distance.clamp(0, window - 1), first, later


@functools.cache
@torch.inference_mode(False)
def _ring_window(window: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return for the first 2 W frames how many frames ago each slot of a ring was written, and what empty ones add.

    Both are (2 W, W); an empty slot adds -inf to its score, another 0.
    """
    frame = torch.arange(2 * window, device=device)[:, None]
    distance = torch.remainder(frame - torch.arange(window, device=device), window)
    empty = torch.zeros(distance.shape, device=device).masked_fill(distance > frame, -torch.inf)
    return distance, empty
