"""What every section of the scoreboard measures, and roll-outs that several sections share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from motionkit.control.script import TypePart
from motionkit.data.dataset import Dataset
from motionkit.data.workers import Map
from motionkit.lab.matched_motion import MatchedMotion
from motionkit.lab.scoreboard.settings import EvaluationSettings
from motionkit.models.model import MotionModel
from motionkit.training.verdict.judge import Judge
from motionkit.training.verdict.real import RealMotion
from motionkit.training.verdict.rolling import Plan, Progress, Take, grouped, roll_plans


@dataclass(eq=False)
class Trial:
    """A model as the settings have it, the recordings to compare it with, and a map over roll-outs."""

    model: MotionModel
    dataset: Dataset
    judge: Judge
    settings: EvaluationSettings
    each: Map = map

    def __post_init__(self) -> None:
        self._alone: dict[str, Sequence[Take]] | None = None

    @property
    def real(self) -> RealMotion:
        """The recordings."""
        return self.judge.real

    @cached_property
    def without_references(self) -> MotionModel | None:
        """The model without its reference recordings, for a column of its own; None if it is measured anyway."""
        if self.settings.reference == "none" or not self.model.uses_references:
            return None
        return self.model.with_reference("none")

    @cached_property
    def matched(self) -> MatchedMotion:
        """Motion matching over the training clips, to compare the model with."""
        return MatchedMotion(self.model, self.dataset)

    @property
    def recorded_types(self) -> tuple[str, ...]:
        """The model's types that the dataset has recordings of."""
        return tuple(kind for kind in self.model.types if kind in self.real.types and self.real.of_type(kind))

    def roll(
        self, plans: list[Plan], progress: Progress | None = None, model: MotionModel | None = None
    ) -> list[Take]:
        """Roll out plans with the settings' noise; by the measured model unless another is given."""
        return roll_plans(model or self.model, plans, self.settings.noise, self.each, progress)

    def seeds(self, count: int) -> range:
        """The first seeds of the settings."""
        return range(self.settings.first_seed, self.settings.first_seed + count)

    def alone(self, progress: Progress) -> dict[str, Sequence[Take]]:
        """Takes of each recorded type alone, as `synthesize TYPE` makes them, one for each seed; made once."""
        if self._alone is None:
            kinds, seeds = self.recorded_types, self.seeds(self.settings.seeds)
            part = self.settings.accuracy_seconds
            plans = [Plan((TypePart(kind, part),), seed) for kind in kinds for seed in seeds]
            takes = self.roll(plans, progress)
            self._alone = dict(zip(kinds, grouped(takes, len(seeds)), strict=True))
        return self._alone
