"""The interface of a network for training, model files and roll-outs, so that another architecture is one file.

Inputs are normalised features (..., 276), contacts (..., 4) and control vectors (..., C). losses() returns the loss of
a batch of windows. stream() predicts frame by frame and keeps its own state. The output is a Gaussian per feature; some
networks also take latent_size normal numbers.
Shape legend: B batch, T frames, C controls, Z latent numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Protocol

import torch
from torch import Tensor, nn

from motionkit.models.batch import Batch, FeatureSpace
from motionkit.models.config import PredictorConfig
from motionkit.models.weights import NetworkWeights


@dataclass(frozen=True, eq=False)
class NextFrame:
    """A prediction: the Gaussian of the next frame, in normalised units.

    Attributes:
        mean, log_sigma: (..., 276) features.
        contact_logits: (..., 4) foot contacts.
        trajectory_mean: (..., 24) trajectory of the next frame; None if the network does not predict it.
    """

    mean: Tensor
    log_sigma: Tensor
    contact_logits: Tensor
    trajectory_mean: Tensor | None


def stacked(frames: Sequence[NextFrame]) -> NextFrame:
    """Return predictions (B, ...) of frames one after another as one with time (B, T, ...)."""
    columns = ([getattr(each, field.name) for each in frames] for field in fields(NextFrame))
    values: list[Any] = [None if each[0] is None else torch.stack(each, dim=1) for each in columns]
    return NextFrame(*values)


class PredictorStream(Protocol):
    """The state of B independent characters."""

    def reset(self, warmup: int = 0) -> None:
        """Forget all frames. Of the next `warmup` recorded frames, only the prediction of the last is used."""
        ...

    def step(
        self, x_BF: Tensor, contacts_B4: Tensor, controls_BC: Tensor, latent_BZ: Tensor | None = None
    ) -> NextFrame:
        """Predict the next frame from a new one; without latent numbers, they are at their mean of zero."""
        ...


class Predictor(nn.Module):
    """A network that predicts the next frame.

    Attributes:
        config: its sizes and choices; config and control_size suffice to build it.
        latent_size: normal numbers per character that a step takes; 0 for none.
    """

    config: Any
    control_size: int
    config_class: ClassVar[Any]
    latent_size: int = 0

    def __init__(self, config: PredictorConfig, control_size: int) -> None:
        super().__init__()
        self.config, self.control_size = config, control_size

    def losses(self, batch: Batch, space: FeatureSpace, progress: float) -> dict[str, Tensor]:
        """Return the weighted terms of the training loss by name; progress is the finished share of the run."""
        raise NotImplementedError

    def layer_matrices(self) -> dict[str, int]:
        """Return, by name, the weights (P, M, C N) within layers and their C, the number of matrices side by side.

        Muon updates these weights (training/optimizer.py). The default is none; only part transformers have some.
        """
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
