"""The network one frame at a time: constant work per frame, with the results of the batched forward pass.

Each attention layer keeps a ring of the last W keys and values, and the shallow convolution keeps its last inputs.
Absolute (sinusoidal) positions change with every frame. That option recomputes the whole receptive field instead,
as the paper does.
"""

from __future__ import annotations

import torch
from torch import Tensor

from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.models.backbones import LstmLayers, LstmState
from motionkit.models.network import AttentionLayer, AutoRegressiveModule, PartTransformer, Prediction
from motionkit.models.predictor import NextFrame


class _ModuleRings:
    """Keys and values (L, P, B, H, W, E) of one auto-regressive module."""

    def __init__(self, module: AutoRegressiveModule, parts: int, batch: int) -> None:
        config = module.config
        shape = (config.layers, parts, batch, config.heads, config.window, config.width // config.heads)
        device = module.embed.weight.device
        self.keys = torch.zeros(shape, device=device)
        self.values = torch.zeros(shape, device=device)


class NetworkStream:
    """The network's state for a batch of independent characters."""

    def __init__(self, network: PartTransformer, batch: int) -> None:
        self.network, self.batch = network, batch
        # An LSTM carries its state instead, and has no positions.
        config = network.config
        windowed = (
            config.variant.position == "sinusoidal"
            or config.variant.backbone == "non-local"
            or network.cross is not None
        )
        self.recomputes = windowed and config.variant.backbone != "lstm"
        self.reset()

    def reset(self, given: int = 0) -> None:
        """Forget all frames; of the next `given` recorded ones only the last's prediction may be used."""
        network, config = self.network, self.network.config
        self.unused = given - 1
        P, B, device = len(network.body.parts), self.batch, network.aggregate.weight.device
        self.frame = 0
        if self.recomputes:
            size = FEATURE_COUNT + CONTACT_COUNT + network.control_size
            self.past = torch.zeros(B, 0, size, device=device)
            return
        inputs = network.part_columns.shape[1]
        self.recent = torch.zeros(P, B, config.kernel, inputs, device=device)
        self.before = torch.zeros(B, FEATURE_COUNT, device=device)
        self.lstm_states: list[LstmState | None] = [None, None]
        if config.variant.backbone == "lstm":
            return
        self.rings = [_ModuleRings(m, P, B) for m in (network.shallow, network.deep)]

    @torch.inference_mode()
    def step(
        self, x_BF: Tensor, contacts_B4: Tensor, controls_BC: Tensor, latent_BZ: Tensor | None = None
    ) -> Prediction | NextFrame:
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
        return network.predict(x_BF, before, shallow, deep)

    def _module(self, index: int, x: Tensor, controls: Tensor) -> Tensor:
        """Features (P, B, D) of the shallow (0) or the deep module (1) for one frame."""
        module: AutoRegressiveModule = (self.network.shallow, self.network.deep)[index]
        motion = module.embed_motion(x)
        controls = module.embed_controls(controls.expand(motion.shape[0], *controls.shape))
        x = torch.cat([motion, controls[..., : module.config.embedding.control_width]], dim=-1)
        if module.config.variant.backbone == "lstm":
            lstm = module.layers[0]
            assert isinstance(lstm, LstmLayers)
            made, self.lstm_states[index] = lstm.run(x[:, :, None], self.lstm_states[index])
            return made[:, :, 0]
        rings = self.rings[index]
        slot = self.frame % module.config.window
        for i, layer in enumerate(module.layers):
            assert isinstance(layer, AttentionLayer)
            bias = layer.attention.ring_bias(self.frame, x.device)
            x = layer.step(x, controls, rings.keys[i], rings.values[i], slot, bias)
        return x if module.final_norm is None else module.final_norm(x)

    def _recompute(self, x: Tensor, contacts: Tensor, controls: Tensor) -> Prediction | NextFrame:
        row = torch.cat([x, contacts, controls], dim=-1)[:, None]
        self.past = torch.cat([self.past, row], dim=1)[:, -self.network.config.receptive_field :]
        self.frame += 1
        if self.frame <= self.unused:  # a whole window for what nobody reads
            return NextFrame(torch.zeros_like(x), torch.zeros_like(x), torch.zeros_like(contacts))
        sizes = [FEATURE_COUNT, CONTACT_COUNT, self.network.control_size]
        return self.network.predict_last(*self.past.split(sizes, dim=-1))

    def prime(self, x_BTF: Tensor, contacts_BT4: Tensor, controls_BTC: Tensor) -> None:
        """Process frames whose predictions are not needed."""
        for t in range(x_BTF.shape[1]):
            self.step(x_BTF[:, t], contacts_BT4[:, t], controls_BTC[:, t])
