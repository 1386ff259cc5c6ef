"""Named budgets of runs with the paper's training. Imports no torch, because the command line lists them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Budget:
    """Size of a run: steps, windows per batch, frames per window, and the initial learning rate.

    Short runs need a higher rate than the paper's 1e-4. In all runs it halves at every quarter. config changes settings
    of part transformers, because the paper's head and dropout learn nothing in a few hundred steps.
    """

    steps: int
    batch: int
    window: int
    rate: float
    config: Mapping[str, Any] = field(default_factory=dict)


# For short runs: the predicted mean is 0.9 x input pose + output, and there is less dropout.
NEAR_COPY = {"head_leak": 0.9, "input_dropout": 0.1, "deep_dropout": 0.0}

BUDGETS = {
    "short": Budget(200, 8, 96, 1e-3, NEAR_COPY),  # a minute of one core
    # Two minutes of one core, so all networks take an hour. At 1e-3, whole-body networks stop using their input.
    "medium": Budget(600, 4, 96, 3e-4, NEAR_COPY),
    "long": Budget(3000, 4, 96, 3e-4, NEAR_COPY),  # ten minutes of one core
    "cpu": Budget(1500, 8, 96, 3e-4),  # under 40 minutes of two cores
    "gpu": Budget(40_000, 56, 300, 2e-4),  # a few hours of one GPU
    "paper": Budget(2_178_000, 56, 300, 1e-4),  # 2000 epochs of 60,962 windows
}
