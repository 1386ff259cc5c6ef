"""The modules of the part transformer: attention layers behind an embedding of frames and controls.

Shape legend: P parts, B batch, T frames, C controls, D width.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from motionkit.models.attention import LocalAttention
from motionkit.models.backbones import backbone_layers
from motionkit.models.config import ModelConfig
from motionkit.models.layers import FeedForward, PartLinear, PartNorm, sinusoidal_positions, spatial_dropout


class AttentionLayer(nn.Module):
    """Attention and a feed-forward network, each with its residual."""

    def __init__(self, parts: int, config: ModelConfig) -> None:
        super().__init__()
        self.pre = config.variant.norm == "pre"
        D = config.width
        self.attention_norm = PartNorm(parts, D, affine=not self.pre)
        self.attention = LocalAttention(
            parts, D, config.heads, config.window, bias=config.variant.position == "bias"
        )
        self.ffn_norm = PartNorm(parts, D, affine=not self.pre)
        self.ffn = FeedForward(parts, D, config.ffn, D, bias=False)
        self.control = (
            PartLinear(parts, config.embedding.control_embedding, D, bias=False)
            if config.embedding.layer_controls
            else None
        )

    def forward(self, x_PBTD: Tensor, controls: Tensor) -> Tensor:
        return self._residuals(x_PBTD, controls, self.attention)

    def step(
        self, x_PBD: Tensor, controls: Tensor, keys: Tensor, values: Tensor, slot: int, bias: Tensor
    ) -> Tensor:
        """Process one frame; see LocalAttention.step."""

        def attention(x: Tensor, residual: Tensor) -> Tensor:
            return self.attention.step(x, residual, keys, values, slot, bias)

        return self._residuals(x_PBD, controls, attention)

    def _residuals(
        self, x: Tensor, controls: Tensor, attention: Callable[[Tensor, Tensor], Tensor]
    ) -> Tensor:
        if self.control is not None:
            x = self.control(controls, x)
        if self.pre:
            x = attention(self.attention_norm(x), x)
            return self.ffn(self.ffn_norm(x), x)
        x = self.attention_norm(attention(x, x))
        return self.ffn_norm(self.ffn(x, x))


class AutoRegressiveModule(nn.Module):
    """The shallow or the deep module of all parts: embedding, controls, attention layers."""

    def __init__(self, parts: int, inputs: int, control_size: int, config: ModelConfig, kernel: int) -> None:
        super().__init__()
        self.config, self.kernel = config, kernel
        motion_width = config.width - config.embedding.control_width
        self.embed = PartLinear(parts, kernel * inputs, motion_width)
        self.embed_controls = PartLinear(parts, control_size, config.embedding.control_embedding)
        attends = config.variant.backbone == "attention"
        self.layers = nn.ModuleList(
            [AttentionLayer(parts, config) for _ in range(config.layers)]
            if attends
            else backbone_layers(parts, config)
        )
        self.final_norm = (
            PartNorm(parts, config.width, affine=False) if config.variant.norm == "pre" else None
        )
        self.embed_mask: Tensor
        self.register_buffer("embed_mask", torch.ones(1), persistent=False)

    def embed_motion(self, x: Tensor) -> Tensor:
        """Embed kernel frames side by side (P, ..., kernel x inputs), oldest first."""
        flat = x.reshape(x.shape[0], -1, x.shape[-1])
        assert self.embed.bias is not None
        out = torch.baddbmm(self.embed.bias, flat, self.embed.weight * self.embed_mask)
        return out.reshape(*x.shape[:-1], -1)

    def forward(
        self, x_PBTD: Tensor, controls_BTC: Tensor, first: int = 0, kept: int | None = None
    ) -> Tensor:
        """Process frames (P, B, T, ...) from a first position on, with controls (B, T, C); return the last `kept` ones.

        Attention drops frames that none of these sees.
        """
        if self.kernel > 1:
            padded = F.pad(x_PBTD, (0, 0, self.kernel - 1, 0))
            T = x_PBTD.shape[2]
            x_PBTD = torch.cat([padded[:, :, i : i + T] for i in range(self.kernel)], dim=-1)
        motion = self.embed_motion(x_PBTD)
        controls = self.embed_controls.shared(controls_BTC)
        if self.config.variant.position == "sinusoidal" and not self.config.variant.recurrent:
            positions = sinusoidal_positions(first + motion.shape[2], motion.shape[3], motion.device)
            motion = motion + positions[first:]
        motion = spatial_dropout(motion, self.config.dropout.spatial_dropout, self.training)
        x = torch.cat([motion, controls[..., : self.config.embedding.control_width]], dim=-1)
        for number, layer in enumerate(self.layers, 1):
            x = layer(x, controls)
            if kept is not None and self.config.variant.backbone == "attention":
                seen = kept + (len(self.layers) - number) * (self.config.window - 1)
                x, controls = x[:, :, -seen:], controls[:, :, -seen:]
        return x if self.final_norm is None else self.final_norm(x)
