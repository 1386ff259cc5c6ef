"""What training, model files and roll-outs expect of a network, so that another architecture is one file.

Inputs are normalised features (..., 276), contacts (..., 4) and control vectors (..., C); losses() trains on a batch
of windows; stream() predicts frame by frame and keeps its own state. What is drawn is a Gaussian per feature, given
latent_size normal numbers where the network takes them.
Shape legend: B batch, T frames, C controls, Z latent numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import torch
from torch import Tensor, nn

from motionkit.models.batch import Batch, FeatureSpace
from motionkit.models.config import PredictorConfig
from motionkit.models.weights import NetworkWeights


class Drawn(Protocol):
    """What a stream predicts: the Gaussian of the next frame, in normalised units."""

    @property
    def mean(self) -> Tensor:
        """(B, 276) features."""
        ...

    @property
    def log_sigma(self) -> Tensor:
        """(B, 276)."""
        ...

    @property
    def contact_logits(self) -> Tensor:
        """(B, 4) foot contacts."""
        ...

    @property
    def trajectory_mean(self) -> Tensor | None:
        """(B, 24) trajectory of the next frame; None where it is not predicted."""
        ...


@dataclass(frozen=True, eq=False)
class NextFrame:
    """A prediction of the next frame; attributes as in Drawn."""

    mean: Tensor
    log_sigma: Tensor
    contact_logits: Tensor
    trajectory_mean: Tensor | None = None


class PredictorStream(Protocol):
    """The state of B independent characters."""

    def reset(self, given: int = 0) -> None:
        """Forget all frames; the next `given` are recorded ones, of whose predictions only the last is used."""
        ...

    def step(
        self, x_BF: Tensor, contacts_B4: Tensor, controls_BC: Tensor, latent_BZ: Tensor | None = None
    ) -> Drawn:
        """Take in a frame and predict the next; without latent numbers, at their mean of zero."""
        ...


class Predictor(nn.Module):
    """A network that predicts the next frame.

    Attributes:
        config: its sizes and choices; with control_size all that is needed to build it.
        control_size: length of its control vector.
        config_class: the class of config.
        latent_size: normal numbers that a step takes per character, 0 for none.
    """

    config: Any
    control_size: int
    config_class: ClassVar[Any]
    latent_size: int = 0

    def __init__(self, config: PredictorConfig, control_size: int) -> None:
        super().__init__()
        self.config, self.control_size = config, control_size

    def losses(self, batch: Batch, space: FeatureSpace, progress: float) -> dict[str, Tensor]:
        """Return the terms of the training loss by name, weighted; progress is the share of the run that is done."""
        raise NotImplementedError

    def layer_matrices(self) -> dict[str, int]:
        """Return the names of the weights (P, M, C N) within layers and the C of each: how many matrices it has side
        by side. None here: Muon moves those of part transformers alone (training/optimizer.py)."""
        return {}

    def stream(self, batch: int) -> PredictorStream:
        """Return the state of a batch of characters before their first frame."""
        raise NotImplementedError

    @classmethod
    def from_weights(cls, weights: NetworkWeights) -> Any:
        """Return the network of a model file, in evaluation mode."""
        network = cls(weights.config, weights.control_size)
        network.load_state_dict({name: torch.from_numpy(array) for name, array in weights.arrays.items()})
        return network.eval()

    def weights(self) -> NetworkWeights:
        """Return a copy of all parameters as arrays."""
        arrays = {name: t.detach().cpu().float().numpy().copy() for name, t in self.state_dict().items()}
        return NetworkWeights(self.config, self.control_size, arrays)
