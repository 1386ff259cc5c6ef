"""Training settings by preset name: the shipped recipe, and the paper's own."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from motionkit.models.presets import preset
from motionkit.training.losses import LossOptions
from motionkit.training.options import GROUP_OF, OptimizerOptions, TrainOptions
from motionkit.training.sampler import SamplerOptions
from motionkit.training.scheduled_sampling import ScheduledSamplingOptions

# Paper section 4.3: 56 windows of 300 frames, types equally often, no spliced transitions, learning rate 1e-4.
PAPER: dict[str, Any] = {
    "batch": 56,
    "optimizer": OptimizerOptions(rate=1e-4),
    "losses": LossOptions(outlier=1e9),
    "sampler": SamplerOptions(
        window=300,
        balance=1.0,
        splices=0,
        trajectory_dropout=0.0,
        reference_dropout=1.0,
        lead_share=0.0,
        phase_weight=1.0,
        noise=0.05,
    ),
    "scheduled_sampling": ScheduledSamplingOptions(share=0.0),
}


def train_options(
    name: str, steps: int | None = None, minutes: float | None = None, **changes: Any
) -> TrainOptions:
    """Return the options of a preset with some of them changed.

    Args:
        name: the preset.
        changes: options of any group by name, such as rate=1e-4, window=64 or step_weight=35. None leaves an
            option as the preset has it.

    Raises:
        ModelError: if the preset is unknown.
        TypeError: if an option is unknown.
    """
    preset(name)
    options = TrainOptions(
        preset=name, steps=steps, minutes=minutes, **(PAPER if name == "tptn-paper" else {})
    )
    grouped: dict[str, dict[str, Any]] = {}
    plain = {}
    for option, value in changes.items():
        if value is None:
            continue
        if option in GROUP_OF:
            grouped.setdefault(GROUP_OF[option], {})[option] = value
        else:
            plain[option] = value
    options = replace(options, **plain)
    return replace(options, **{g: replace(getattr(options, g), **values) for g, values in grouped.items()})
