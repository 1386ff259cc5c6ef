"""Budgets of runs that train as the paper does, by name. No torch here: the command line lists them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Budget:
    """How much of the paper's training a run does: steps of batch windows, and the learning rate it begins with.

    Short runs need a higher rate than the paper's 1e-4; it is halved at every quarter of the run in all of them.
    config changes part transformers, whose head and dropout in the paper learn nothing in a few hundred steps.
    """

    steps: int
    batch: int
    window: int
    rate: float
    config: Mapping[str, Any] = field(default_factory=dict)


# Few hundred steps teach the paper's head little: this one adds to nine tenths of the present frame.
NEAR_COPY = {"head_leak": 0.9, "input_dropout": 0.1, "deep_dropout": 0.0}

BUDGETS = {
    "short": Budget(200, 8, 96, 1e-3, NEAR_COPY),  # a minute of one core
    # Two minutes of one core: all networks in an hour. At 1e-3 whole-body networks no longer see their input.
    "medium": Budget(600, 4, 96, 3e-4, NEAR_COPY),
    "long": Budget(3000, 4, 96, 3e-4, NEAR_COPY),  # ten minutes of one core
    "cpu": Budget(1500, 8, 96, 3e-4),  # under 40 minutes of two cores
    "gpu": Budget(40_000, 56, 300, 2e-4),  # a few hours of one GPU
    "paper": Budget(2_178_000, 56, 300, 1e-4),  # 2000 epochs of 60,962 windows
}
