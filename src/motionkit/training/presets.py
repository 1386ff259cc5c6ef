"""Training settings by preset name: the shipped recipe, the paper's, and that of fine-tuning."""

from __future__ import annotations

from typing import Any

from motionkit.errors import ModelError
from motionkit.models.bundled import BUNDLED
from motionkit.models.config import ModelConfig
from motionkit.models.presets import preset
from motionkit.training.budgets import BUDGETS
from motionkit.training.losses import LossOptions
from motionkit.training.options import OptimizerOptions, Stage, TrainOptions, with_changes
from motionkit.training.scheduled_sampling import ScheduledSamplingOptions
from motionkit.training.windows import ControlSampling, SamplerOptions

# Stages of a run from random weights (docs/training.md):
# - No scheduled sampling at first, because predictions are still too far off to be inputs.
# - Few reference poses until 0.8: following them is learnt quickly, moving without them slowly.
# - The step loss from 0.4 on, once the network makes steps.
# - Types almost equally often from 0.6 on, so that rare, hard types are learnt.
STAGES = (
    Stage(0.0, {"share": 0.0, "reference_dropout": 0.8}),
    Stage(0.04, {"share": 0.4}),
    Stage(0.4, {"step_weight": 10.0}),
    Stage(0.6, {"balance": 0.9}),
    Stage(0.8, {"reference_dropout": 0.5}),
)

# Paper section 4.3: batches of 56 windows of 300 frames, cut at intervals that depend on the type; AdamW; learning rate
# 1e-4, halved every 500 of 2000 epochs; no warm-up, no average of the weights, no clipping of the gradient.
PAPER: dict[str, Any] = {
    "optimizer": OptimizerOptions(
        method="adamw",
        batch=56,
        rate=1e-4,
        warmup=0,
        schedule="halving",
        betas=(0.9, 0.999),
        clip_norm=1e9,
        ema=0.0,
    ),
    "losses": LossOptions(outlier=1e9, foot_term="paper"),
    "sampler": SamplerOptions(
        window=300,
        balance=1.0,
        splices=0,
        splice_share=0.0,
        controls=ControlSampling(trajectory_dropout=0.0, reference_dropout=1.0, lead_share=0.0),
        phase_weight=1.0,
        interval=4.0,
        noise=0.05,
    ),
    "scheduled_sampling": ScheduledSamplingOptions(share=0.0),
}

# Default length of a run from random weights, and of one from a model.
TRAIN_MINUTES, FINE_TUNE_MINUTES = 30.0, 5.0
KEPT_SHARE = 0.5  # share of windows with kept types, if a run keeps its model's types

# Fine-tuning lasts minutes: a low rate, a short average of the weights, and few splices.
FINE_TUNE: dict[str, Any] = {"method": "adamw", "rate": 5e-4, "warmup": 50, "ema": 0.99, "splices": 400}


def train_options(
    name: str,
    steps: int | None = None,
    minutes: float | None = None,
    budget: str | None = None,
    **changes: Any,
) -> TrainOptions:
    """Return the options of a preset with some of them changed.

    Args:
        budget: a name in BUDGETS, for presets with the paper's training; other arguments override it.
        changes: options of any group by name, such as rate=1e-4, window=64 or step_weight=10; None keeps the
            preset's value.

    Raises:
        ModelError: if the preset is unknown.
        TypeError: if an option is unknown.
    """
    as_in_paper = preset(name).controls == "paper"
    chosen = {option: value for option, value in changes.items() if value is not None}
    if not as_in_paper:
        chosen = {"splices": _splices(SamplerOptions().splices, TRAIN_MINUTES, minutes, steps)} | chosen
    if budget is not None:
        if not as_in_paper:
            raise ModelError(f"budgets are for presets that train as the paper does, not for {name}")
        size = BUDGETS[budget]
        steps = size.steps if steps is None and minutes is None else steps
        sizes = {"batch": size.batch, "window": size.window, "rate": size.rate}
        chosen = sizes | dict(size.options) | chosen
        if isinstance(preset(name), ModelConfig):
            chosen["config"] = {**size.config, **chosen.get("config", {})}
    recipe = PAPER if as_in_paper else {"stages": STAGES}
    options = TrainOptions(preset=name, steps=steps, minutes=minutes, **recipe)
    # Changes hold in all stages.
    stages = tuple(
        Stage(stage.begins, {k: v for k, v in stage.changes.items() if k not in chosen})
        for stage in options.stages
    )
    return with_changes(options, {"stages": stages} | chosen)


def fine_tune_options(
    name: str, init: str = BUNDLED, steps: int | None = None, minutes: float | None = None, **changes: Any
) -> TrainOptions:
    """Return the options of a run that starts from a model file, or "bundled"; arguments as for train_options.

    Presets that train as the paper does also do so from a model.
    """
    chosen = {option: value for option, value in changes.items() if value is not None}
    if preset(name).controls == "paper":
        return train_options(name, steps, minutes, init=init, **chosen)
    splices = _splices(FINE_TUNE["splices"], FINE_TUNE_MINUTES, minutes, steps)
    return train_options(name, steps, minutes, init=init, **(FINE_TUNE | {"splices": splices} | chosen))


def _splices(most: int, whole: float, minutes: float | None, steps: int | None) -> int:
    """How many splices a run makes before it trains: fewer in runs of less than `whole` minutes."""
    return most if minutes is None or steps is not None else round(most * min(1.0, minutes / whole))
