"""How many roll-outs an evaluation makes, how long they are, and on which split."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from motionkit.errors import ControlError
from motionkit.inference.noise import Noise
from motionkit.models.model import REFERENCE_CHOICES
from motionkit.names import unknown_name
from motionkit.training.verdict.types import QUICK_TYPES as VERDICT

# First seed of each split, and the first seed that belongs to it no more. Settings, gains and checkpoints are chosen on
# the validation split; test clips and test seeds are only reported.
SEEDS: dict[str, tuple[int, int]] = {"validation": (0, 1000), "test": (1000, 2**31)}
MOST_SEEDS = 500  # a section counts up by as many seeds at most


@dataclass(frozen=True)
class EvaluationSettings:
    """How many roll-outs an evaluation makes, and how long they are. The model card quotes the defaults.

    Attributes:
        split: "validation" or "test": the recordings held out, and the seeds.
        seeds: roll-outs per type for action accuracy, visible faults and variety.
        accuracy_seconds: length of each of these roll-outs, counted from the command.
        repeats: roll-outs per path, response, transition and held-out clip.
        stability_seconds: length of the roll-out of each type.
        mixed_seconds: length of the roll-out with random changes of type.
        reconstruction_seconds: longest stretch of a held-out clip to compare.
        seed: first random seed; None is the split's first. The same seed, model and dataset give the same scoreboard.
        noise: how frames are sampled.
        reference: "auto", or "none" to measure the network without its reference recordings only.

    Raises:
        ControlError: for an unknown split, or seeds of another split.
    """

    split: str = "test"
    seeds: int = 20
    accuracy_seconds: float = 8.0
    repeats: int = 3
    stability_seconds: float = 60.0
    mixed_seconds: float = 300.0
    reconstruction_seconds: float = 10.0
    seed: int | None = None
    noise: Noise = field(default_factory=Noise)
    reference: str = "auto"

    def __post_init__(self) -> None:
        if self.split not in SEEDS:
            raise ControlError(unknown_name("split", self.split, tuple(SEEDS)))
        if self.reference not in REFERENCE_CHOICES:
            raise ControlError(unknown_name("reference", self.reference, REFERENCE_CHOICES))
        first, end = SEEDS[self.split]
        if not (
            first <= self.first_seed and self.first_seed + MOST_SEEDS <= end and self.seeds <= MOST_SEEDS
        ):
            expected = f"{first} to {end - MOST_SEEDS}" if self.split == "validation" else f"{first} or more"
            raise ControlError(
                f"seed {self.first_seed} with {self.seeds} roll-outs per type does not belong to the {self.split} "
                f"split: expected a first seed of {expected} and at most {MOST_SEEDS} roll-outs; seeds below "
                f"{SEEDS['test'][0]} are for validation, the others for the test"
            )

    @property
    def first_seed(self) -> int:
        """The first random seed."""
        return SEEDS[self.split][0] if self.seed is None else self.seed

    def as_dict(self) -> dict[str, Any]:
        """Plain values for reports."""
        noise = f"{self.noise.kind}, temperature {self.noise.temperature:g}"
        return {**asdict(self), "seed": self.first_seed, "noise": noise}


QUICK = EvaluationSettings(
    seeds=3,
    accuracy_seconds=5.0,
    repeats=1,
    stability_seconds=10.0,
    mixed_seconds=20.0,
    reconstruction_seconds=3.0,
)
# Of the types section alone: as quickstart judges.
QUICK_TYPES = EvaluationSettings(
    seeds=VERDICT.seeds, accuracy_seconds=VERDICT.accuracy_seconds, repeats=VERDICT.repeats
)
