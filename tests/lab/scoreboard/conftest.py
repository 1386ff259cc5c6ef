from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from motionkit.data.dataset import Dataset
from motionkit.lab.scoreboard.settings import QUICK, EvaluationSettings
from motionkit.lab.scoreboard.trial import Trial
from motionkit.models.model import MotionModel
from motionkit.training.verdict.judge import Judge
from motionkit.training.verdict.real import RealMotion

TINY = replace(
    QUICK, seeds=2, accuracy_seconds=1.3, stability_seconds=0.5, mixed_seconds=0.5, reconstruction_seconds=0.6
)


@pytest.fixture
def make_trial(tiny_model: MotionModel, dataset: Dataset, real: RealMotion) -> Callable[..., Trial]:
    """A function that makes a trial of the tiny model: make_trial(settings, judge)."""

    def make(settings: EvaluationSettings = TINY, judge: Judge | None = None) -> Trial:
        return Trial(tiny_model, dataset, judge or Judge(real), settings)

    return make
