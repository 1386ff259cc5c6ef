"""Chooses how a network runs frame by frame: packed, by step_kernel.c, where possible, else by torch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np

from motionkit.arrays import Floats
from motionkit.errors import ModelError
from motionkit.features.control import TRAJECTORY_COUNT
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.inference.step import NetworkStep
from motionkit.inference.step_kernel import StepKernel
from motionkit.inference.step_weights import pack, why_not_packable
from motionkit.models.architectures import network_class
from motionkit.models.weights import NetworkWeights

if TYPE_CHECKING:
    from motionkit.models.predictor import Predictor


class TorchStep:
    """The counterpart of NetworkStep for networks that cannot be packed: one torch stream per character.

    Raises ModelError if torch is not installed.
    """

    def __init__(
        self, network: NetworkWeights, batch: int, random: Sequence[np.random.Generator] = ()
    ) -> None:
        """Take in random one generator per character; networks with a latent_size draw from it."""
        try:
            self.network: Predictor = network_class(network.config.architecture).from_weights(network)
        except ModelError:
            reason = why_not_packable(network.config)
            raise ModelError(
                f"this model runs in torch only ({reason}): pip install 'motionkit[train]'"
            ) from None
        self.weights, self.random = network, random
        self.streams = [self.network.stream(1) for _ in range(batch)]
        self.mean, self.log_sigma = (np.zeros((batch, FEATURE_COUNT), np.float32) for _ in range(2))
        self.contact_logits = np.zeros((batch, CONTACT_COUNT), np.float32)
        self.trajectory = np.zeros((batch, TRAJECTORY_COUNT), np.float32)

    def alone(self) -> TorchStep:
        """A step of the same network for one character."""
        return TorchStep(self.weights, 1)

    def reset(self, coming: int = 0) -> None:
        """Forget all frames. Of the next `coming` recorded frames, only the prediction of the last is used."""
        for stream in self.streams:
            stream.reset(coming)

    def adopt(self, row: int, other: object) -> None:
        """Replace one character by the only character of another step."""
        assert isinstance(other, TorchStep)
        self.streams[row], other.streams = other.streams[0], [self.network.stream(1)]

    def step(self, x: Floats, contacts: Floats, controls: Floats) -> None:
        """Predict the next frame from x (B, 276) normalised, contacts (B, 4) and controls (B, C)."""
        import torch

        for i, stream in enumerate(self.streams):
            row = [torch.tensor(values[i : i + 1]) for values in (x, contacts, controls)]
            if self.network.latent_size:
                row.append(torch.from_numpy(self._latent(i)))
            with torch.inference_mode():
                made = stream.step(*row)
            self.mean[i], self.log_sigma[i] = made.mean[0].numpy(), made.log_sigma[0].numpy()
            self.contact_logits[i] = made.contact_logits[0].numpy()
            if made.trajectory_mean is not None:
                self.trajectory[i] = made.trajectory_mean[0].numpy()

    def _latent(self, row: int) -> Floats:
        """Normal numbers (1, Z) for one character; zeros, their mean, without a generator."""
        size = (1, self.network.latent_size)
        if row >= len(self.random):
            return np.zeros(size, np.float32)
        return self.random[row].standard_normal(size, dtype=np.float32)


def stepper(
    network: NetworkWeights, batch: int, random: Sequence[np.random.Generator] = ()
) -> NetworkStep | TorchStep:
    """Return the step that runs a network frame by frame; random is as in TorchStep."""
    if why_not_packable(network.config) is not None:
        return TorchStep(network, batch, random)
    if network not in _PACKED:
        _PACKED[network] = StepKernel(pack(network), small=True)
    return NetworkStep(_PACKED[network], batch)


# Kernels by network, so that each network is packed once for all characters.
_PACKED: WeakKeyDictionary[NetworkWeights, StepKernel] = WeakKeyDictionary()
