"""The network one frame at a time in torch, equal to the batch forward, and the choice of how to step.

NetworkStream is what training uses, what networks use that cannot be packed, and what the packed step of
models/step.py is tested against.

Each attention layer keeps a ring of the last W keys and values, the shallow convolution its last
inputs. Absolute (sinusoidal) positions change with every frame, so that option recomputes the whole
receptive field instead, as the paper does.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.models.network import AttentionLayer, AutoRegressiveModule, PartTransformer, Prediction
from motionkit.models.step import NetworkStep
from motionkit.models.step_kernel import StepKernel, kernel_library
from motionkit.models.step_weights import Floats, pack, why_not_packable


class _ModuleRings:
    """Keys and values (L, P, B, H, W, E) of one auto-regressive module."""

    def __init__(self, module: AutoRegressiveModule, parts: int, batch: int) -> None:
        config = module.config
        shape = (config.layers, parts, batch, config.heads, config.window, config.width // config.heads)
        device = module.embed.weight.device
        self.keys = torch.zeros(shape, device=device)
        self.values = torch.zeros(shape, device=device)


class NetworkStream:
    """A batch of independent characters, fed frame by frame."""

    def __init__(self, network: PartTransformer, batch: int) -> None:
        self.network, self.batch = network, batch
        self.recomputes = network.config.position == "sinusoidal"
        self.reset()

    def reset(self) -> None:
        """Forget all frames."""
        network, config = self.network, self.network.config
        P, B, device = len(network.body.parts), self.batch, network.aggregate.weight.device
        self.frame = 0
        if self.recomputes:
            size = FEATURE_COUNT + CONTACT_COUNT + network.control_size
            self.past = torch.zeros(B, 0, size, device=device)
            return
        inputs = network.part_columns.shape[1]
        self.recent = torch.zeros(P, B, config.kernel, inputs, device=device)
        self.rings = [_ModuleRings(m, P, B) for m in (network.shallow, network.deep)]

    @torch.inference_mode()
    def step(self, x_BF: Tensor, contacts_B4: Tensor, controls_BC: Tensor) -> Prediction:
        """Take in one frame and predict the next; shapes as PartTransformer.forward without T."""
        if self.recomputes:
            return self._recompute(x_BF, contacts_B4, controls_BC)
        network = self.network
        inputs = network.split_parts(x_BF, contacts_B4)
        self.recent = torch.cat([self.recent[:, :, 1:], inputs[:, :, None]], dim=2)
        shallow = self._module(network.shallow, self.rings[0], self.recent.flatten(2), controls_BC)
        deep = self._module(network.deep, self.rings[1], network.fuse(shallow), controls_BC)
        self.frame += 1
        return network.predict(x_BF, shallow, deep)

    def _module(
        self, module: AutoRegressiveModule, rings: _ModuleRings, x: Tensor, controls: Tensor
    ) -> Tensor:
        motion = module.embed_motion(x)
        controls = module.embed_controls(controls.expand(motion.shape[0], *controls.shape))
        x = torch.cat([motion, controls], dim=-1)
        slot = self.frame % module.config.window
        for i, layer in enumerate(module.layers):
            assert isinstance(layer, AttentionLayer)
            bias = layer.attention.ring_bias(self.frame, x.device)
            x = layer.step(x, controls, rings.keys[i], rings.values[i], slot, bias)
        return x if module.final_norm is None else module.final_norm(x)

    def _recompute(self, x: Tensor, contacts: Tensor, controls: Tensor) -> Prediction:
        row = torch.cat([x, contacts, controls], dim=-1)[:, None]
        self.past = torch.cat([self.past, row], dim=1)[:, -self.network.config.receptive_field :]
        self.frame += 1
        sizes = [FEATURE_COUNT, CONTACT_COUNT, self.network.control_size]
        prediction = self.network(*self.past.split(sizes, dim=-1))
        return Prediction(
            prediction.mean[:, -1],
            prediction.log_sigma[:, -1],
            prediction.trajectory_mean[:, -1],
            prediction.trajectory_log_sigma[:, -1],
            prediction.contact_logits[:, -1],
            prediction.shallow[:, :, -1],
            prediction.deep[:, :, -1],
        )

    def prime(self, x_BTF: Tensor, contacts_BT4: Tensor, controls_BTC: Tensor) -> None:
        """Take in frames whose predictions are not needed."""
        for t in range(x_BTF.shape[1]):
            self.step(x_BTF[:, t], contacts_BT4[:, t], controls_BTC[:, t])


class TorchStep:
    """NetworkStep for networks that cannot be packed: a NetworkStream for each character."""

    def __init__(self, network: PartTransformer, batch: int) -> None:
        self.network = network
        self.streams = [NetworkStream(network, 1) for _ in range(batch)]
        self.mean, self.log_sigma = (np.zeros((batch, FEATURE_COUNT), np.float32) for _ in range(2))
        self.contact_logits = np.zeros((batch, CONTACT_COUNT), np.float32)

    def alone(self) -> TorchStep:
        """A step of the same network for one character."""
        return TorchStep(self.network, 1)

    def reset(self) -> None:
        """Forget all frames of all characters."""
        for stream in self.streams:
            stream.reset()

    def adopt(self, row: int, other: object) -> None:
        """Put the only character of another step in place of one of these."""
        assert isinstance(other, TorchStep)
        self.streams[row], other.streams = other.streams[0], [NetworkStream(self.network, 1)]

    def step(self, x: Floats, contacts: Floats, controls: Floats) -> None:
        """Take in a frame and predict the next: x (B, 276) normalised, contacts (B, 4), controls (B, C)."""
        for i, stream in enumerate(self.streams):
            made = stream.step(*(torch.tensor(values[i : i + 1]) for values in (x, contacts, controls)))
            self.mean[i], self.log_sigma[i] = made.mean[0].numpy(), made.log_sigma[0].numpy()
            self.contact_logits[i] = made.contact_logits[0].numpy()


def stepper(network: PartTransformer, batch: int) -> NetworkStep | TorchStep:
    """The fastest way to run a network frame by frame on this machine."""
    if why_not_packable(network.config) is not None:
        return TorchStep(network, batch)
    weights = pack(network)
    return NetworkStep(weights, batch, StepKernel(weights, small=True) if kernel_library() else None)
