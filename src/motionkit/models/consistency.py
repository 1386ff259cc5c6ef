"""Consistency modules for training: they decode shared channels to the data of the shared joints (paper 4.1)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from motionkit.models.config import ModelConfig
from motionkit.models.layers import FeedForward
from motionkit.models.network import PartTransformer


class ConsistencyModules(nn.Module):
    """A two-layer network per part and level, from the shared channels to the data of the shared joints."""

    def __init__(self, network: PartTransformer) -> None:
        super().__init__()
        config: ModelConfig = network.config
        self.parts = len(network.body.parts)
        self.channels = config.embedding.shared_channels
        self.outputs = 12 * len(network.body.shared)
        sizes = (self.parts, self.channels, config.head.consistency_hidden, self.outputs)
        self.shallow, self.deep = FeedForward(*sizes), FeedForward(*sizes)

    def forward(self, shallow: Tensor, deep: Tensor) -> tuple[Tensor, Tensor]:
        """Decode features (P, B, T, D) of both levels to data (P, B, T, 12 S)."""
        return self.shallow(shallow[..., : self.channels].float()), self.deep(
            deep[..., : self.channels].float()
        )


def shared_data(network: PartTransformer, x_BTF: Tensor) -> Tensor:
    """Return the shared joints' columns (B, T, 12 S) of features, in the order of the parts' inputs."""
    columns = network.part_columns[0, : 12 * len(network.body.shared)]
    return x_BTF[..., columns]


def feature_difference(features: Tensor, channels: int) -> Tensor:
    """Return the mean distance between the shared channels of pairs of parts (paper L_feat), a scalar."""
    shared = features[..., :channels].float()
    pairs = [(p, q) for p in range(len(shared)) for q in range(p)]
    if not pairs:
        return torch.zeros((), device=features.device)
    return torch.stack([safe_norm(shared[p] - shared[q]).mean() for p, q in pairs]).mean()


def safe_norm(x: Tensor) -> Tensor:
    """Return the Euclidean norm over the last dimension, with a finite gradient at zero."""
    return torch.sqrt(x.float().square().sum(-1) + 1e-8)
