"""The part transformer: the paper's TPTN with two parts, and its EBTN, FPTN and 5PTN with one, four and five.

Paper section 4.1. Shape legend: P parts, B batch, T frames, F features (276), C controls, D width.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from motionkit.features.control import TRAJECTORY_COUNT, ControlLayout
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT, feature_layout
from motionkit.models.attention import LocalAttention
from motionkit.models.backbones import RecurrentLayers, RecurrentState
from motionkit.models.config import ModelConfig
from motionkit.models.layers import FeedForward, PartLinear
from motionkit.models.modules import AttentionLayer, AutoRegressiveModule
from motionkit.models.parts import Partition, partition
from motionkit.models.predictor import NextFrame, Predictor
from motionkit.models.weights import embedding_mask, foot_parts, part_columns


@dataclass(frozen=True, eq=False)
class Prediction(NextFrame):
    """The Gaussian of the next frame for every input frame.

    Attributes:
        trajectory_log_sigma: (..., 24).
        shallow, deep: (P, ..., D) features of the two module levels, for the consistency loss.
    """

    trajectory_mean: Tensor
    trajectory_log_sigma: Tensor
    shallow: Tensor
    deep: Tensor


class PartTransformer(Predictor):
    """P parts with a shallow and a deep module each, fusion in between, and aggregation at the end."""

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
        # For each part, a linear map of the shallow features of all other parts.
        self.fusion = PartLinear(P, (P - 1) * D, D) if P > 1 and config.variant.fusion == "linear" else None
        crosses = P > 1 and config.variant.fusion == "cross-attention"
        self.cross = LocalAttention(P, D, config.heads, config.window, bias=False) if crosses else None
        self.aggregate = nn.Linear(P * D, 2 * FEATURE_COUNT + 2 * TRAJECTORY_COUNT)
        self.momentum = nn.Parameter(_first_momentum(config)) if config.head.head_momentum else None
        self.trajectory_columns = ControlLayout.trajectory_columns(config.controls, control_size)
        self.feet = foot_parts(config)
        self.contact_mlp = FeedForward(1, 2 * D * len(self.feet), config.head.contact_hidden, CONTACT_COUNT)
        self._initialise()

    def _initialise(self) -> None:
        """Start with small outputs, so that the leaky head begins near a decaying copy of its input."""
        with torch.no_grad():
            self.aggregate.weight.mul_(0.1)
            self.aggregate.bias.zero_()

    def layer_matrices(self) -> dict[str, int]:
        """As in Predictor, including the fusion; C is 3 for queries, keys and values, else 1."""
        found = {}
        for name, module in self.named_modules():
            within = ".layers." in name or name.partition(".")[0] in ("fusion", "cross")
            if within and isinstance(module, PartLinear):
                found[f"{name}.weight"] = 3 if name.endswith(".qkv") else 1
        return found

    def stream(self, batch: int) -> NetworkStream:
        """Return the network's state for a batch of characters, before their first frame."""
        return NetworkStream(self, batch)

    def split_parts(self, x: Tensor, contacts: Tensor) -> Tensor:
        """Return the parts' inputs (P, ..., N) from features (..., 276) and contacts (..., 4), padded with zeros."""
        whole = torch.cat([x, contacts, torch.zeros_like(x[..., :1])], dim=-1)
        return whole[..., self.part_columns].movedim(-2, 0)

    def forward(self, x_BTF: Tensor, contacts_BT4: Tensor, controls_BTC: Tensor) -> Prediction:
        """Predict frame n + 1 from frames up to n, for all n at once.

        Frames are normalised features (B, T, 276), contacts (B, T, 4) and normalised control vectors (B, T, C).
        """
        inputs = F.dropout(
            self.split_parts(x_BTF, contacts_BT4), self.config.dropout.input_dropout, self.training
        )
        shallow = self.shallow(inputs, controls_BTC)
        fused = F.dropout(self.fuse(shallow), self.config.dropout.deep_dropout, self.training)
        deep = self.deep(fused, controls_BTC)
        before = torch.cat([x_BTF[:, :1], x_BTF[:, :-1]], dim=1)
        return self.predict(x_BTF, before, controls_BTC, shallow, deep)

    def predict_last(self, x_BTF: Tensor, contacts_BT4: Tensor, controls_BTC: Tensor) -> Prediction:
        """Predict only the frame after the last one: forward() without frames that this prediction does not see."""
        sight = len(self.deep.layers) * (self.config.window - 1) + 1
        if self.cross is not None:
            sight += self.config.window - 1
        shallow = self.shallow(self.split_parts(x_BTF, contacts_BT4), controls_BTC, kept=sight)
        first = x_BTF.shape[1] - shallow.shape[2]
        deep = self.deep(self.fuse(shallow), controls_BTC[:, first:], first, kept=1)
        before = x_BTF[:, :-1] if x_BTF.shape[1] > 1 else x_BTF
        return self.predict(*(t[..., -1, :] for t in (x_BTF, before, controls_BTC, shallow, deep)))

    def fuse(self, shallow: Tensor) -> Tensor:
        """Add to shallow features (P, ..., D) a linear map of the other parts' features (paper eq. 3).

        With cross-attention, the mean of the other parts' features is the query; the part itself gives keys and values.
        """
        P = shallow.shape[0]
        if self.cross is not None:
            mean = (shallow.sum(0, keepdim=True) - shallow) / (P - 1)
            return self.cross(shallow, shallow, mean)
        if self.fusion is None:
            return shallow
        others = torch.stack([torch.cat([shallow[q] for q in range(P) if q != p], -1) for p in range(P)])
        return shallow + self.fusion(others)

    def predict(
        self, x: Tensor, before: Tensor, controls: Tensor, shallow: Tensor, deep: Tensor
    ) -> Prediction:
        """Apply aggregation layer and Foot-MLP to features of frames x (..., 276) with their controls (..., C).

        before holds the previous frames.
        """
        body = torch.cat(list(deep), dim=-1)
        out = self.aggregate(body).float()
        sizes = [FEATURE_COUNT, FEATURE_COUNT, TRAJECTORY_COUNT, TRAJECTORY_COUNT]
        mean, log_sigma, trajectory, trajectory_log_sigma = out.split(sizes, dim=-1)
        if self.config.head.head_leak:
            mean = mean + self.config.head.head_leak * x.float()
        if self.momentum is not None:
            mean = mean + self.momentum * (x - before).float()
        if self.config.head.trajectory_skip:  # zeros where no trajectory is given
            trajectory = trajectory + controls[..., self.trajectory_columns].float()
        feet = torch.cat([torch.cat([shallow[i], deep[i]], dim=-1) for i in self.feet], dim=-1)
        contact_logits = self.contact_mlp(feet[None])[0].float()
        low, high = self.config.head.log_sigma_min, self.config.head.log_sigma_max
        return Prediction(
            mean,
            log_sigma.clamp(low, high),
            contact_logits,
            trajectory,
            trajectory_log_sigma.clamp(low, high),
            shallow,
            deep,
        )


def _first_momentum(config: ModelConfig) -> Tensor:
    """The share (276,) of the last step that the mean adds before training."""
    columns = feature_layout(config.layout).columns
    velocities = torch.tensor([column.block.endswith(("velocity", "velocities")) for column in columns])
    return torch.where(velocities, config.head.velocity_momentum, 0.8)


class _ModuleRings:
    """Keys and values (L, P, B, H, W, E) of one auto-regressive module."""

    def __init__(self, module: AutoRegressiveModule, parts: int, batch: int) -> None:
        config = module.config
        shape = (config.layers, parts, batch, config.heads, config.window, config.width // config.heads)
        device = module.embed.weight.device
        self.keys = torch.zeros(shape, device=device)
        self.values = torch.zeros(shape, device=device)


class NetworkStream:
    """Runs the network one frame at a time for a batch of independent characters, with the results of forward().

    Each attention layer keeps a ring of the last W keys and values, and the shallow convolution keeps its last inputs,
    so the work per frame is constant. Absolute (sinusoidal) positions change with every frame; with them the whole
    receptive field is computed again, as in the paper.
    """

    def __init__(self, network: PartTransformer, batch: int) -> None:
        self.network, self.batch = network, batch
        # A recurrent network keeps a state instead, and has no positions.
        config = network.config
        windowed = (
            config.variant.position == "sinusoidal"
            or config.variant.backbone == "non-local"
            or network.cross is not None
        )
        self.recomputes = windowed and not config.variant.recurrent
        self.reset()

    def reset(self, warmup: int = 0) -> None:
        """Forget all frames. Of the next `warmup` recorded frames, only the prediction of the last may be used."""
        network, config = self.network, self.network.config
        self.unused = warmup - 1
        P, B, device = len(network.body.parts), self.batch, network.aggregate.weight.device
        self.frame = 0
        if self.recomputes:
            size = FEATURE_COUNT + CONTACT_COUNT + network.control_size
            self.past = torch.zeros(B, 0, size, device=device)
            return
        inputs = network.part_columns.shape[1]
        self.recent = torch.zeros(P, B, config.kernel, inputs, device=device)
        self.before = torch.zeros(B, FEATURE_COUNT, device=device)
        self.states: list[RecurrentState | None] = [None, None]
        if config.variant.recurrent:
            return
        self.rings = [_ModuleRings(m, P, B) for m in (network.shallow, network.deep)]

    @torch.inference_mode()
    def step(
        self, x_BF: Tensor, contacts_B4: Tensor, controls_BC: Tensor, latent_BZ: Tensor | None = None
    ) -> NextFrame:
        """Predict the next frame from one new frame; shapes as in PartTransformer.forward, without T."""
        if self.recomputes:
            return self._recompute(x_BF, contacts_B4, controls_BC)
        network = self.network
        inputs = network.split_parts(x_BF, contacts_B4)
        self.recent = torch.cat([self.recent[:, :, 1:], inputs[:, :, None]], dim=2)
        shallow = self._module(0, self.recent.flatten(2), controls_BC)
        deep = self._module(1, network.fuse(shallow), controls_BC)
        before = x_BF if self.frame == 0 else self.before
        self.frame, self.before = self.frame + 1, x_BF
        return network.predict(x_BF, before, controls_BC, shallow, deep)

    def _module(self, index: int, x: Tensor, controls: Tensor) -> Tensor:
        """Features (P, B, D) of the shallow (0) or the deep module (1) for one frame."""
        module: AutoRegressiveModule = (self.network.shallow, self.network.deep)[index]
        motion = module.embed_motion(x)
        controls = module.embed_controls(controls.expand(motion.shape[0], *controls.shape))
        x = torch.cat([motion, controls[..., : module.config.embedding.control_width]], dim=-1)
        if module.config.variant.recurrent:
            layers = module.layers[0]
            assert isinstance(layers, RecurrentLayers)
            made, self.states[index] = layers.run(x[:, :, None], self.states[index])
            return made[:, :, 0]
        rings = self.rings[index]
        slot = self.frame % module.config.window
        for i, layer in enumerate(module.layers):
            assert isinstance(layer, AttentionLayer)
            bias = layer.attention.ring_bias(self.frame, x.device)
            x = layer.step(x, controls, rings.keys[i], rings.values[i], slot, bias)
        return x if module.final_norm is None else module.final_norm(x)

    def _recompute(self, x: Tensor, contacts: Tensor, controls: Tensor) -> NextFrame:
        row = torch.cat([x, contacts, controls], dim=-1)[:, None]
        self.past = torch.cat([self.past, row], dim=1)[:, -self.network.config.receptive_field :]
        self.frame += 1
        if self.frame <= self.unused:  # skip a whole window whose prediction nobody reads
            return NextFrame(torch.zeros_like(x), torch.zeros_like(x), torch.zeros_like(contacts), None)
        sizes = [FEATURE_COUNT, CONTACT_COUNT, self.network.control_size]
        return self.network.predict_last(*self.past.split(sizes, dim=-1))


def parameter_count(network: Predictor) -> int:
    """Return the number of parameters, not counting those of padded or masked inputs."""
    total = sum(p.numel() for p in network.parameters())
    return (
        total - int((network.shallow.embed_mask == 0).sum())
        if isinstance(network, PartTransformer)
        else total
    )
