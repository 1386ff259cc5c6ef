"""Backbones that replace attention in two of the paper's ablations (table 8): non-local blocks and recurrent layers.

Shape legend: P parts, B batch, T frames, D width.
"""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from motionkit.models.attention import LocalAttention
from motionkit.models.config import NON_LOCAL_EVERY, RECURRENT, RESIDUAL_KERNEL, ModelConfig
from motionkit.models.layers import PartLinear, PartNorm

RECURRENT_LAYERS = 4

RecurrentState = list[Any]  # of each part, as its layers in torch.nn return it


class NonLocalLayer(nn.Module):
    """A bottleneck residual block with a causal convolution; in some layers a non-local operation follows.

    It follows He et al. 2016 and Wang et al. 2018, in one dimension. The operation is the embedded Gaussian: a softmax
    over the frame and the W - 1 frames before it.
    """

    def __init__(self, parts: int, config: ModelConfig, non_local: bool) -> None:
        super().__init__()
        D, inner = config.width, config.ffn // 2
        self.reduce = PartLinear(parts, D, inner)
        self.convolve = PartLinear(parts, RESIDUAL_KERNEL * inner, inner)
        self.expand = PartLinear(parts, inner, D)
        self.norm = PartNorm(parts, D, affine=True)
        self.non_local = LocalAttention(parts, D, 1, config.window, bias=False) if non_local else None
        self.non_local_norm = PartNorm(parts, D, affine=True) if non_local else None

    def forward(self, x_PBTD: Tensor, controls: Tensor) -> Tensor:
        hidden = F.relu(self.reduce(x_PBTD))
        T = hidden.shape[2]
        padded = F.pad(hidden, (0, 0, RESIDUAL_KERNEL - 1, 0))
        near = torch.cat([padded[:, :, i : i + T] for i in range(RESIDUAL_KERNEL)], dim=-1)
        x = self.norm(x_PBTD + self.expand(F.relu(self.convolve(near))))
        if self.non_local is None or self.non_local_norm is None:
            return F.relu(x)
        return self.non_local_norm(self.non_local(F.relu(x), F.relu(x)))


class RecurrentLayers(nn.Module):
    """Four recurrent layers per part; their state passes from frame to frame."""

    def __init__(self, parts: int, config: ModelConfig) -> None:
        super().__init__()
        cells = getattr(nn, RECURRENT[config.variant.backbone])
        self.parts = nn.ModuleList(
            cells(config.width, config.width, RECURRENT_LAYERS, batch_first=True) for _ in range(parts)
        )

    def forward(self, x_PBTD: Tensor, controls: Tensor) -> Tensor:
        return self.run(x_PBTD, None)[0]

    def run(self, x_PBTD: Tensor, states: RecurrentState | None) -> tuple[Tensor, RecurrentState]:
        """Return features (P, B, T, D) and the states after the last frame."""
        made = [
            layers(x.to(layers.weight_hh_l0.dtype), None if states is None else states[i])
            for i, (layers, x) in enumerate(zip(self.parts, x_PBTD, strict=True))
        ]
        return torch.stack([out for out, _ in made]), [state for _, state in made]


def backbone_layers(parts: int, config: ModelConfig) -> list[nn.Module]:
    """Return the layers of one auto-regressive module whose backbone is not attention."""
    if config.variant.recurrent:
        return [RecurrentLayers(parts, config)]
    last = NON_LOCAL_EVERY - 1
    return [NonLocalLayer(parts, config, non_local=i % NON_LOCAL_EVERY == last) for i in range(config.layers)]
