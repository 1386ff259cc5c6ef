"""A reconstruction of neural animation layering (Starke et al. 2021), whose code is not public.

A mixture of experts of 512-512 with ELU, blended by a gate of 128-128; dropout keeps 0.7. The generator takes the pose
and a control series; of their controls only locomotion is there, as in the paper's comparison: types and trajectory of
the coming second, and the same of LOOK_BACK earlier frames. What drives their gate, phases of each limb fitted to
contacts, is replaced by the contacts of those frames. The paper counts 25.2 M parameters for theirs; the number of
experts and the length of the series behind that figure are unknown.
Shape legend: B batch, T frames, S samples of the series.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor

from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.lab.networks.baseline import (
    OUTPUTS,
    BaselineConfig,
    ExpertLayers,
    mlp,
    prediction_losses,
    split_outputs,
)
from motionkit.models.batch import Batch, FeatureSpace
from motionkit.models.predictor import NextFrame, Predictor

LOOK_BACK = (0, 10, 20, 30, 40, 50, 60)  # frames: the past half of the control series


@dataclass(frozen=True)
class NeuralLayeringConfig(BaselineConfig):
    """Sizes of the network."""

    architecture: str = "neural-layering"
    hidden: int = 512
    experts: int = 10
    gate: int = 128
    dropout: float = 0.3


class NeuralLayering(Predictor):
    """A pose and a control series in, the next pose out."""

    config: NeuralLayeringConfig
    config_class = NeuralLayeringConfig

    def __init__(self, config: NeuralLayeringConfig, control_size: int) -> None:
        super().__init__(config, control_size)
        series = len(LOOK_BACK) * (control_size + CONTACT_COUNT)
        sizes = (FEATURE_COUNT + series, config.hidden, config.hidden, OUTPUTS)
        self.gate = mlp((series, config.gate, config.gate, config.experts))
        self.layers = ExpertLayers(config.experts, pairwise(sizes))

    def run(self, x: Tensor, series: Tensor) -> NextFrame:
        """Return the prediction for poses (..., 276) and control series (..., S (C + 4))."""
        shape = x.shape[:-1]
        inputs = series.reshape(-1, series.shape[-1])
        shares = torch.softmax(self.gate(F.dropout(inputs, self.config.dropout, self.training)), dim=-1)
        out = torch.cat([x.reshape(-1, FEATURE_COUNT), inputs], dim=-1)
        out = self.layers(out, shares, dropout=self.config.dropout)
        return split_outputs(out.reshape(*shape, OUTPUTS))

    def losses(self, batch: Batch, space: FeatureSpace, progress: float) -> dict[str, Tensor]:
        """Return squared errors of the next frame."""
        rows = torch.cat([batch.controls, batch.contacts], dim=-1)
        frames = torch.arange(rows.shape[1], device=rows.device)
        series = torch.cat([rows[:, (frames - back).clamp(min=0)] for back in LOOK_BACK], dim=-1)
        return prediction_losses(self.run(batch.inputs, series), batch)

    def stream(self, batch: int) -> SeriesStream:
        """Return the state of a batch of characters: the controls and contacts of the last second."""
        return SeriesStream(self)


class SeriesStream:
    """Controls and contacts of the last frames of B characters; before the first frame they are those of the first."""

    def __init__(self, network: NeuralLayering) -> None:
        self.network = network
        self.reset()

    def reset(self, warmup: int = 0) -> None:
        """Forget all frames."""
        self.rows: list[Tensor] = []

    def step(
        self, x_BF: Tensor, contacts_B4: Tensor, controls_BC: Tensor, latent_BZ: Tensor | None = None
    ) -> NextFrame:
        """Predict the next frame."""
        self.rows = [*self.rows, torch.cat([controls_BC, contacts_B4], dim=-1)][-LOOK_BACK[-1] - 1 :]
        last = len(self.rows) - 1
        return self.network.run(
            x_BF, torch.cat([self.rows[max(0, last - back)] for back in LOOK_BACK], dim=-1)
        )
