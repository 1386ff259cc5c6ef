"""The part transformer: TPTN with two parts, and the paper's EBTN, FPTN and 5PTN with one, four and five.

Paper section 4.1. Shape legend: P parts, B batch, T frames, F features (276), C controls, D width.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from motionkit.features.control import TRAJECTORY_COUNT
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.models.attention import LocalAttention
from motionkit.models.backbones import backbone_layers
from motionkit.models.config import ModelConfig
from motionkit.models.layers import FeedForward, PartLinear, PartNorm, sinusoidal_positions, spatial_dropout
from motionkit.models.parts import Partition, partition
from motionkit.models.predictor import Predictor
from motionkit.models.weights import embedding_mask, foot_parts, part_columns

if TYPE_CHECKING:
    from motionkit.models.stream import NetworkStream


@dataclass(frozen=True, eq=False)
class Prediction:
    """The Gaussian of the next frame for every input frame, in normalised units.

    Attributes:
        mean, log_sigma: (..., 276) features.
        trajectory_mean, trajectory_log_sigma: (..., 24) trajectory.
        contact_logits: (..., 4) foot contacts.
        shallow, deep: (P, ..., D) features of the two module levels, for the consistency loss.
    """

    mean: Tensor
    log_sigma: Tensor
    trajectory_mean: Tensor
    trajectory_log_sigma: Tensor
    contact_logits: Tensor
    shallow: Tensor
    deep: Tensor


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
        """Process frames (P, B, T, ...) with their controls (B, T, C).

        Args:
            first: position of the first frame, for sinusoidal positions.
            kept: how many of the last frames are wanted; attention then drops frames that none of them sees.
        """
        if self.kernel > 1:
            padded = F.pad(x_PBTD, (0, 0, self.kernel - 1, 0))
            T = x_PBTD.shape[2]
            x_PBTD = torch.cat([padded[:, :, i : i + T] for i in range(self.kernel)], dim=-1)
        motion = self.embed_motion(x_PBTD)
        controls = self.embed_controls.shared(controls_BTC)
        if self.config.variant.position == "sinusoidal" and self.config.variant.backbone != "lstm":
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


class PartTransformer(Predictor):
    """P parts with a shallow and a deep module each; they are fused in between and aggregated at the end."""

    config: ModelConfig
    config_class = ModelConfig

    def __init__(self, config: ModelConfig, control_size: int) -> None:
        super().__init__(config, control_size)
        self.body: Partition = partition(config.variant.partition)
        P, D = len(self.body.parts), config.width
        gather, _ = part_columns(config)
        self.part_columns: Tensor
        self.register_buffer("part_columns", torch.from_numpy(gather), persistent=False)
        self.shallow = AutoRegressiveModule(P, gather.shape[1], control_size, config, config.kernel)
        self.shallow.embed_mask = torch.from_numpy(embedding_mask(config))
        self.deep = AutoRegressiveModule(P, D, control_size, config, 1)
        # Each part gets one linear map of all the other parts' shallow features.
        self.fusion = PartLinear(P, (P - 1) * D, D) if P > 1 and config.variant.fusion == "linear" else None
        crosses = P > 1 and config.variant.fusion == "cross-attention"
        self.cross = LocalAttention(P, D, config.heads, config.window, bias=False) if crosses else None
        self.aggregate = nn.Linear(P * D, 2 * FEATURE_COUNT + 2 * TRAJECTORY_COUNT)
        self.momentum = nn.Parameter(torch.full((FEATURE_COUNT,), 0.8)) if config.head.head_momentum else None
        self.feet = foot_parts(config)
        self.contact_mlp = FeedForward(1, 2 * D * len(self.feet), config.head.contact_hidden, CONTACT_COUNT)
        self._initialise()

    def _initialise(self) -> None:
        """Make outputs small at first, so that the leaky head starts near a decaying copy of its input."""
        with torch.no_grad():
            self.aggregate.weight.mul_(0.1)
            self.aggregate.bias.zero_()

    def layer_matrices(self) -> dict[str, int]:
        """As in Predictor, with the fusion; C is 3 for queries, keys and values, else 1."""
        found = {}
        for name, module in self.named_modules():
            within = ".layers." in name or name.partition(".")[0] in ("fusion", "cross")
            if within and isinstance(module, PartLinear):
                found[f"{name}.weight"] = 3 if name.endswith(".qkv") else 1
        return found

    def stream(self, batch: int) -> NetworkStream:
        """Return the network's state for a batch of characters, before their first frame."""
        from motionkit.models.stream import NetworkStream

        return NetworkStream(self, batch)

    def split_parts(self, x: Tensor, contacts: Tensor) -> Tensor:
        """Return the parts' inputs (P, ..., N) from features (..., 276) and contacts (..., 4), padded with zeros."""
        whole = torch.cat([x, contacts, torch.zeros_like(x[..., :1])], dim=-1)
        return whole[..., self.part_columns].movedim(-2, 0)

    def forward(self, x_BTF: Tensor, contacts_BT4: Tensor, controls_BTC: Tensor) -> Prediction:
        """Predict frame n + 1 from frames up to n, for all n at once.

        Args:
            x_BTF: (B, T, 276) normalised features.
            contacts_BT4: (B, T, 4) foot contacts.
            controls_BTC: (B, T, C) normalised control vectors.
        """
        inputs = F.dropout(
            self.split_parts(x_BTF, contacts_BT4), self.config.dropout.input_dropout, self.training
        )
        shallow = self.shallow(inputs, controls_BTC)
        fused = F.dropout(self.fuse(shallow), self.config.dropout.deep_dropout, self.training)
        deep = self.deep(fused, controls_BTC)
        before = torch.cat([x_BTF[:, :1], x_BTF[:, :-1]], dim=1)
        return self.predict(x_BTF, before, shallow, deep)

    def predict_last(self, x_BTF: Tensor, contacts_BT4: Tensor, controls_BTC: Tensor) -> Prediction:
        """Predict the frame after the last one alone: forward() without what its last prediction does not see."""
        sight = len(self.deep.layers) * (self.config.window - 1) + 1
        if self.cross is not None:
            sight += self.config.window - 1
        shallow = self.shallow(self.split_parts(x_BTF, contacts_BT4), controls_BTC, kept=sight)
        first = x_BTF.shape[1] - shallow.shape[2]
        deep = self.deep(self.fuse(shallow), controls_BTC[:, first:], first, kept=1)
        rows = [t[..., -1, :] for t in (x_BTF, x_BTF[:, :-1] if x_BTF.shape[1] > 1 else x_BTF, shallow, deep)]
        return self.predict(*rows)

    def fuse(self, shallow: Tensor) -> Tensor:
        """Add to shallow features (P, ..., D) a linear map of the other parts' features (paper eq. 3).

        With cross-attention the others' features (their mean) are the queries, the part's own are keys and values.
        """
        P = shallow.shape[0]
        if self.cross is not None:
            mean = (shallow.sum(0, keepdim=True) - shallow) / (P - 1)
            return self.cross(shallow, shallow, mean)
        if self.fusion is None:
            return shallow
        others = torch.stack([torch.cat([shallow[q] for q in range(P) if q != p], -1) for p in range(P)])
        return shallow + self.fusion(others)

    def predict(self, x: Tensor, before: Tensor, shallow: Tensor, deep: Tensor) -> Prediction:
        """Apply aggregation layer and Foot-MLP; x (..., 276) are the input frames, before those before them."""
        body = torch.cat(list(deep), dim=-1)
        out = self.aggregate(body).float()
        sizes = [FEATURE_COUNT, FEATURE_COUNT, TRAJECTORY_COUNT, TRAJECTORY_COUNT]
        mean, log_sigma, trajectory, trajectory_log_sigma = out.split(sizes, dim=-1)
        if self.config.head.head_leak:
            mean = mean + self.config.head.head_leak * x.float()
        if self.momentum is not None:
            mean = mean + self.momentum * (x - before).float()
        feet = torch.cat([torch.cat([shallow[i], deep[i]], dim=-1) for i in self.feet], dim=-1)
        contact_logits = self.contact_mlp(feet[None])[0].float()
        low, high = self.config.head.log_sigma_min, self.config.head.log_sigma_max
        return Prediction(
            mean,
            log_sigma.clamp(low, high),
            trajectory,
            trajectory_log_sigma.clamp(low, high),
            contact_logits,
            shallow,
            deep,
        )


def parameter_count(network: Predictor) -> int:
    """Return the number of parameters, without those of padded or masked inputs."""
    total = sum(p.numel() for p in network.parameters())
    return (
        total - int((network.shallow.embed_mask == 0).sum())
        if isinstance(network, PartTransformer)
        else total
    )
