"""Settings of a training run, in groups. The model card records all of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from typing import Any

from motionkit.errors import MotionkitError
from motionkit.seeds import check_seed
from motionkit.training.losses import WEIGHTS, LossOptions
from motionkit.training.scheduled_sampling import ScheduledSamplingOptions
from motionkit.training.windows import ControlSampling, SamplerOptions

# The paper's weights except for smoothness, whose weight of 10 damps every movement (docs/training.md).
SHIPPED_WEIGHTS = WEIGHTS | {"smooth": 1.0}
SHIPPED_LOSSES = LossOptions(outlier=3.0, beta_nll=0.5, slip_weight=10.0, weights=SHIPPED_WEIGHTS)


@dataclass(frozen=True)
class OptimizerOptions:
    """The optimizer, its batches and learning rate, and the running average of the weights."""

    method: str = "muon"  # for the matrices within layers; "adamw" for all weights (training/optimizer.py)
    batch: int = 16  # windows per step, over all processes
    rate: float = 1e-3  # peak learning rate
    warmup: int = 200  # steps of linear warm-up
    final_rate: float = 0.02  # rate at the end of the cosine, as a share of the peak
    weight_decay: float = 0.01
    betas: tuple[float, float] = (0.9, 0.98)
    schedule: str = "cosine"  # or "halving": the rate halves at every quarter of the run, as in the paper
    # Times that the rate falls from its peak (warm restarts, Loshchilov and Hutter 2017). The model is the mean of the
    # averages at their ends.
    cycles: int = 1
    clip_norm: float = 1.0  # largest norm of the gradient
    ema: float = 0.998  # decay per step of the running average that becomes the model
    precision: str = "auto"  # arithmetic of the network: "auto", "float32" or "bfloat16"


@dataclass(frozen=True)
class OutputOptions:
    """What a run writes, and how often. A resumed run may have other values."""

    checkpoint_seconds: float = 40.0  # between checkpoints
    score_minutes: float = 10.0  # between roll-out scores
    score_seconds: float = 10.0  # length of a scored roll-out; 0 for no scores
    log_every: int = 20  # steps between log lines
    half: bool = False  # write the model in 16 bits


@dataclass(frozen=True)
class Stage:
    """A part of a run: the share of the first cycle, 0 to 1, at which it begins, and changes of options by name."""

    begins: float
    changes: dict[str, Any]


@dataclass(frozen=True)
class TrainOptions:
    """Settings of a run, which ends after so many steps or minutes, whichever come first.

    Raises:
        MotionkitError: if neither steps nor minutes are given.
    """

    preset: str = "tptn"
    config: dict[str, Any] = field(default_factory=dict)  # network settings that differ from the preset
    init: str | None = None  # model file whose weights the run starts from
    steps: int | None = None
    minutes: float | None = None
    seed: int = 0
    optimizer: OptimizerOptions = field(default_factory=OptimizerOptions)
    losses: LossOptions = SHIPPED_LOSSES
    sampler: SamplerOptions = field(default_factory=SamplerOptions)
    scheduled_sampling: ScheduledSamplingOptions = field(default_factory=ScheduledSamplingOptions)
    output: OutputOptions = field(default_factory=OutputOptions)
    stages: tuple[Stage, ...] = ()  # in order; a stage keeps the changes of earlier ones

    def at(self, progress: float) -> TrainOptions:
        """Return the settings at a share of the run.

        Later cycles are in the last stage, and so is all of a run that starts from a model.
        """
        changes: dict[str, Any] = {}
        for stage in self.stages:
            if self.init is not None or stage.begins <= self.optimizer.cycles * progress:
                changes |= stage.changes
        return with_changes(self, changes)

    def __post_init__(self) -> None:
        if self.steps is None and self.minutes is None:
            raise MotionkitError("training needs --steps or --minutes to know when to end")
        check_seed(self.seed)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, for logs and model cards."""
        return asdict(self)


GROUPS: dict[str, type] = {
    "optimizer": OptimizerOptions,
    "losses": LossOptions,
    "sampler": SamplerOptions,
    "sampler.controls": ControlSampling,
    "scheduled_sampling": ScheduledSamplingOptions,
    "output": OutputOptions,
}
# The group of each option, by name; no two groups have options of the same name.
GROUP_OF = {
    option.name: group
    for group, kind in GROUPS.items()
    for option in fields(kind)
    if f"{group}.{option.name}" not in GROUPS
}
_GROUP_WORDS = {group.rpartition(".")[2] for group in GROUPS}


def with_changes(options: TrainOptions, changes: Mapping[str, Any]) -> TrainOptions:
    """Return options with changes by name, in whichever group a name is. Raises TypeError if a name is unknown."""
    grouped: dict[str, Any] = {}
    for name, value in changes.items():
        values = grouped
        for group in _groups(name):
            values = values.setdefault(group, {})
        values[name] = value
    return _replaced(options, grouped)


def _groups(name: str) -> list[str]:
    """Return the nested groups that contain an option, outermost first."""
    return GROUP_OF[name].split(".") if name in GROUP_OF else []


def _replaced(record: Any, changes: Mapping[str, Any]) -> Any:
    """Return a dataclass with changed fields; the change of a field that is a dataclass may be a mapping of changes."""
    values = dict(changes)
    for name, value in changes.items():
        now = getattr(record, name, None)
        if is_dataclass(now) and isinstance(value, Mapping):
            values[name] = _replaced(now, value)
    return replace(record, **values)


# Present names of options, by their names in checkpoints of earlier releases.
EARLIER_NAMES = {
    "evenness": "beta_nll",
    "self_feed": "scheduled_sampling",
    "guide_dropout": "reference_dropout",
    "guided_back": "reference_back",
    "guided_limit": "reference_limit",
}


def flat_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of to_dict under flat names such as "optimizer.rate".

    Options from checkpoints of earlier releases, which had other groups, get their present names.
    """
    flat: dict[str, Any] = {}
    for key, value in options.items():
        name = EARLIER_NAMES.get(key, key)
        if isinstance(value, Mapping) and name in _GROUP_WORDS:
            flat |= flat_options(value)
        else:
            flat[".".join([*_groups(name), name])] = value
    return flat
