"""Named budgets of runs with the paper's training. Imports no torch, because the command line lists them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Budget:
    """Size of a run: steps, windows per batch, frames per window, and the initial learning rate.

    Short runs need a higher rate than the paper's 1e-4. In all runs it halves at every quarter. config and options are
    settings of part transformers and of training that differ from the paper's.
    """

    steps: int
    batch: int
    window: int
    rate: float
    config: Mapping[str, Any] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)


# For short runs: the network begins near a copy that keeps moving, and there is less dropout. The predicted mean is
# 0.9 x input pose + a share of the last step + output; the trajectory is the one given + output.
NEAR_COPY = {
    "head_leak": 0.9,
    "head_momentum": True,
    "velocity_momentum": 0.0,  # velocities of unfiltered recordings tremble: their last step says nothing of the next
    "trajectory_skip": True,
    "input_dropout": 0.1,
    "deep_dropout": 0.0,
}
# The paper's AdamW learns a third as fast at 3e-4, and at 1e-3 collapses without warm-up.
MUON = {"method": "muon", "warmup": 50}
WINDOW = 160  # frames: positions up to the longest memory in the comparison (135) are trained

BUDGETS = {
    "short": Budget(200, 8, WINDOW, 1e-3, NEAR_COPY, MUON),
    "medium": Budget(600, 4, WINDOW, 1e-3, NEAR_COPY, MUON),
    "long": Budget(3000, 4, WINDOW, 1e-3, NEAR_COPY, MUON),
    # The paper's head and dropout. Without the skip it has 15 times the trajectory error of repeating the one given.
    "cpu": Budget(1500, 8, WINDOW, 1e-3, {"trajectory_skip": True}, MUON),
    "gpu": Budget(40_000, 56, 300, 2e-4),  # a few hours of one GPU
    "paper": Budget(2_178_000, 56, 300, 1e-4),  # 2000 epochs of 60,962 windows
}
