from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from motionkit.features.control import ControlLayout
from motionkit.models.config import ModelConfig
from motionkit.models.network import PartTransformer

CONTROL_SIZE = ControlLayout(("walking", "running", "idle")).size


@pytest.fixture
def make_network() -> Callable[..., PartTransformer]:
    """A function that makes a network ready to run, whose every weight matters: make_network(config, seed)."""

    def make(config: ModelConfig, seed: int = 0) -> PartTransformer:
        torch.manual_seed(seed)
        network = PartTransformer(config, CONTROL_SIZE).eval()
        with torch.no_grad():
            for name, p in network.named_parameters():
                if "bias" in name:  # zero at the start
                    p.normal_(std=0.5)
        return network

    return make


@pytest.fixture
def make_inputs() -> Callable[..., tuple[Tensor, Tensor, Tensor]]:
    """A function that draws features, contacts and controls: make_inputs(batch, frames, seed)."""

    def make(batch: int, frames: int, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
        draw = torch.Generator().manual_seed(seed)
        return (
            torch.randn(batch, frames, 276, generator=draw),
            (torch.rand(batch, frames, 4, generator=draw) > 0.5).float(),
            torch.randn(batch, frames, CONTROL_SIZE, generator=draw),
        )

    return make
