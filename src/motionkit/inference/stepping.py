"""How a network is run frame by frame here: packed where it can be, else by torch."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from motionkit.arrays import Floats
from motionkit.errors import ModelError
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.inference.step import NetworkStep
from motionkit.inference.step_kernel import StepKernel, kernel_library
from motionkit.inference.step_weights import StepWeights, pack, why_not_packable
from motionkit.models.weights import NetworkWeights


class TorchStep:
    """NetworkStep for networks that cannot be packed: a NetworkStream for each character.

    Raises ModelError where torch is not installed.
    """

    def __init__(self, network: NetworkWeights, batch: int) -> None:
        try:
            from motionkit.models.network import PartTransformer
            from motionkit.models.stream import NetworkStream
        except ModuleNotFoundError:
            reason = why_not_packable(network.config)
            raise ModelError(
                f"this model runs in torch only ({reason}): pip install 'motionkit[train]'"
            ) from None
        self.weights = network
        self.network = PartTransformer.from_weights(network)
        self.streams = [NetworkStream(self.network, 1) for _ in range(batch)]
        self.mean, self.log_sigma = (np.zeros((batch, FEATURE_COUNT), np.float32) for _ in range(2))
        self.contact_logits = np.zeros((batch, CONTACT_COUNT), np.float32)

    def alone(self) -> TorchStep:
        """A step of the same network for one character."""
        return TorchStep(self.weights, 1)

    def reset(self, coming: int = 0) -> None:
        """Forget all frames of all characters; coming is for NetworkStep alone."""
        for stream in self.streams:
            stream.reset()

    def adopt(self, row: int, other: object) -> None:
        """Put the only character of another step in place of one of these."""
        assert isinstance(other, TorchStep)
        fresh = type(self.streams[row])(self.network, 1)
        self.streams[row], other.streams = other.streams[0], [fresh]

    def step(self, x: Floats, contacts: Floats, controls: Floats) -> None:
        """Take in a frame and predict the next: x (B, 276) normalised, contacts (B, 4), controls (B, C)."""
        import torch

        for i, stream in enumerate(self.streams):
            made = stream.step(*(torch.tensor(values[i : i + 1]) for values in (x, contacts, controls)))
            self.mean[i], self.log_sigma[i] = made.mean[0].numpy(), made.log_sigma[0].numpy()
            self.contact_logits[i] = made.contact_logits[0].numpy()


def stepper(network: NetworkWeights, batch: int) -> NetworkStep | TorchStep:
    """The fastest way to run a network frame by frame on this machine."""
    if why_not_packable(network.config) is not None:
        return TorchStep(network, batch)
    return NetworkStep(*_packed(network, batch))


# What networks were packed into, for as long as they live.
_PACKED: WeakKeyDictionary[NetworkWeights, tuple[StepWeights, StepKernel | None]] = WeakKeyDictionary()


def _packed(network: NetworkWeights, batch: int) -> tuple[StepWeights, int, StepKernel | None]:
    """A network's packed weights, made once for all characters."""
    known = _PACKED.get(network)
    if known is None:
        weights = pack(network)
        known = weights, StepKernel(weights, small=True) if kernel_library() else None
        _PACKED[network] = known
    return known[0], batch, known[1]
