"""Training settings by preset name: the shipped recipe, and the paper's own."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from motionkit.models.presets import preset
from motionkit.training.losses import WEIGHTS
from motionkit.training.options import TrainOptions
from motionkit.training.sampler import SamplerOptions
from motionkit.training.scheduled_sampling import ScheduledSamplingOptions


def train_options(
    name: str,
    steps: int | None = None,
    minutes: float | None = None,
    window: int | None = None,
    splices: int | None = None,
    rate: float | None = None,
    type_weights: dict[str, float] | None = None,
    **changes: Any,
) -> TrainOptions:
    """The options of a preset with some fields changed; None leaves a field as the preset has it.

    Raises ModelError for an unknown preset.
    """
    preset(name)
    options = TrainOptions(preset=name, steps=steps, minutes=minutes)
    if name == "tptn-paper":
        # Paper section 4.3: 56 windows of 300 frames, types equally often, no spliced transitions, 1e-4.
        paper = SamplerOptions(
            window=300,
            balance=1.0,
            splices=0,
            trajectory_dropout=0.0,
            reference_dropout=1.0,
            lead_share=0.0,
            phase_weight=1.0,
            noise=0.05,
        )
        options = replace(options, batch=56, rate=1e-4, sampler=paper, weights=dict(WEIGHTS))
        options = replace(
            options,
            outlier=1e9,
            beta_nll=0.0,
            slip_weight=1.0,
            scheduled_sampling=ScheduledSamplingOptions(share=0.0),
        )
    sampler = options.sampler
    if window is not None:
        sampler = replace(sampler, window=window)
    if splices is not None:
        sampler = replace(sampler, splices=splices)
    if type_weights:
        sampler = replace(sampler, type_weights=type_weights)
    changes = {key: value for key, value in changes.items() if value is not None}
    if rate is not None:
        changes["rate"] = rate
    return replace(options, sampler=sampler, **changes)
