"""Settings of a training run, grouped by what they belong to. The model card records all of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from motionkit.errors import MotionkitError
from motionkit.training.losses import WEIGHTS, LossOptions
from motionkit.training.sampler import SamplerOptions
from motionkit.training.scheduled_sampling import ScheduledSamplingOptions

# The paper's weights, but for smoothness: the paper's weight of 10 damps every movement (docs/training.md).
SHIPPED_WEIGHTS = WEIGHTS | {"smooth": 1.0}
SHIPPED_LOSSES = LossOptions(outlier=3.0, beta_nll=0.5, slip_weight=10.0, weights=SHIPPED_WEIGHTS)


@dataclass(frozen=True)
class OptimizerOptions:
    """AdamW, its learning rate, and the running average of the weights."""

    rate: float = 1e-3  # peak learning rate
    warmup: int = 200  # steps of linear warm-up
    final_rate: float = 0.02  # share of the peak rate at the end of the cosine
    weight_decay: float = 0.01
    betas: tuple[float, float] = (0.9, 0.98)
    clip_norm: float = 1.0  # largest norm of the gradient
    ema: float = 0.998  # decay of the running average that becomes the model
    precision: str = "auto"  # arithmetic of the network: "auto", "float32" or "bfloat16"


@dataclass(frozen=True)
class OutputOptions:
    """What a run writes, and how often. A resumed run may change these."""

    checkpoint_seconds: float = 40.0  # between checkpoints
    score_minutes: float = 10.0  # between roll-out scores
    score_seconds: float = 10.0  # length of a scored roll-out; 0 for no scores
    log_every: int = 20  # steps between log lines
    half: bool = False  # write the model in 16 bits


@dataclass(frozen=True)
class TrainOptions:
    """Settings of a run. It ends after steps or minutes; with both, after whichever comes first.

    Raises:
        MotionkitError: if neither steps nor minutes are given.
    """

    preset: str = "tptn"
    config: dict[str, Any] = field(default_factory=dict)  # network settings that differ from the preset
    init: str | None = None  # model file whose weights the run starts from
    steps: int | None = None
    minutes: float | None = None
    batch: int = 16  # windows per step, over all processes
    seed: int = 0
    optimizer: OptimizerOptions = field(default_factory=OptimizerOptions)
    losses: LossOptions = SHIPPED_LOSSES
    sampler: SamplerOptions = field(default_factory=SamplerOptions)
    scheduled_sampling: ScheduledSamplingOptions = field(default_factory=ScheduledSamplingOptions)
    output: OutputOptions = field(default_factory=OutputOptions)

    def __post_init__(self) -> None:
        if self.steps is None and self.minutes is None:
            raise MotionkitError("training needs --steps or --minutes to know when to end")

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, for logs and model cards."""
        return asdict(self)


GROUPS: dict[str, type] = {
    "optimizer": OptimizerOptions,
    "losses": LossOptions,
    "sampler": SamplerOptions,
    "scheduled_sampling": ScheduledSamplingOptions,
    "output": OutputOptions,
}
GROUP_OF = {option.name: group for group, kind in GROUPS.items() for option in fields(kind)}
# Names in checkpoints of earlier releases.
EARLIER_NAMES = {
    "evenness": "beta_nll",
    "self_feed": "scheduled_sampling",
    "guide_dropout": "reference_dropout",
    "guided_back": "reference_back",
    "guided_limit": "reference_limit",
}


def flat_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of to_dict by names such as "optimizer.rate".

    Options of a checkpoint of an earlier release, which had fewer groups, get today's names.
    """
    flat: dict[str, Any] = {}
    for key, value in options.items():
        name = EARLIER_NAMES.get(key, key)
        if name in GROUPS and isinstance(value, Mapping):
            flat |= {f"{name}.{EARLIER_NAMES.get(k, k)}": v for k, v in value.items()}
        else:
            flat[f"{GROUP_OF[name]}.{name}" if name in GROUP_OF else name] = value
    return flat
