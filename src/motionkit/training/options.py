"""What a training run is told; every field is in the model card of what comes out."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from motionkit.errors import MotionkitError
from motionkit.training.losses import WEIGHTS, LossOptions
from motionkit.training.sampler import SamplerOptions
from motionkit.training.scheduled_sampling import ScheduledSamplingOptions

# The paper's weights but for smoothness: ten times its share damps every movement (docs/training.md).
SHIPPED_WEIGHTS = WEIGHTS | {"smooth": 1.0}


@dataclass(frozen=True)
class TrainOptions:
    """Settings of a run. steps or minutes says when it ends; with both, whichever comes first."""

    preset: str = "tptn"
    init: str | None = None  # a model file to begin from
    steps: int | None = None
    minutes: float | None = None
    batch: int = 16  # windows per step, over all processes
    rate: float = 1e-3  # peak learning rate
    warmup: int = 200  # steps
    final_rate: float = 0.02  # share of the peak at the end of the cosine
    weight_decay: float = 0.01
    betas: tuple[float, float] = (0.9, 0.98)
    clip_norm: float = 1.0
    ema: float = 0.998
    outlier: float = 3.0  # deviations beyond which the Gaussian loss is linear (paper: never)
    beta_nll: float = 0.5  # of the Gaussian loss between what is easy and what is hard to predict (paper: 0)
    slip_weight: float = 10.0  # of the slip of touching feet in the FK loss (paper: 1)
    step_weight: float = 0.0  # there, of how low feet move from the frame given; docs/results-log.md tries 50
    step_except: tuple[str, ...] = ()  # types in whose frames it does not count
    seed: int = 0
    precision: str = "auto"  # "auto", "float32" or "bfloat16"
    checkpoint_seconds: float = 40.0
    score_minutes: float = 10.0  # between roll-out scores
    score_seconds: float = 10.0  # length of a scored roll-out
    log_every: int = 20
    half: bool = False  # write the model in 16 bits
    weights: dict[str, float] = field(default_factory=lambda: dict(SHIPPED_WEIGHTS))
    sampler: SamplerOptions = field(default_factory=SamplerOptions)
    scheduled_sampling: ScheduledSamplingOptions = field(default_factory=ScheduledSamplingOptions)
    config: dict[str, Any] = field(default_factory=dict)  # fields that differ from the preset

    def __post_init__(self) -> None:
        if self.steps is None and self.minutes is None:
            raise MotionkitError("training needs --steps or --minutes to know when to end")

    @property
    def losses(self) -> LossOptions:
        """Those of how the losses are measured."""
        return LossOptions(self.outlier, self.beta_nll, self.slip_weight, self.step_weight, self.step_except)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for logs and model cards."""
        return asdict(self)
