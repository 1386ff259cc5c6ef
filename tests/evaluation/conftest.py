from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from motionkit.data.dataset import Dataset
from motionkit.evaluation.judge import Judge
from motionkit.evaluation.real import RealMotion
from motionkit.evaluation.settings import QUICK, EvaluationSettings
from motionkit.evaluation.trial import Trial
from motionkit.models.model import MotionModel

TINY = replace(
    QUICK, seeds=2, accuracy_seconds=1.3, stability_seconds=0.5, mixed_seconds=0.5, reconstruction_seconds=0.6
)


@pytest.fixture(scope="session")
def real(dataset: Dataset) -> RealMotion:
    """The recordings of the small dataset."""
    return RealMotion(dataset)


@pytest.fixture
def make_trial(tiny_model: MotionModel, dataset: Dataset, real: RealMotion) -> Callable[..., Trial]:
    """A function that makes a trial of the tiny model: make_trial(settings, judge)."""

    def make(settings: EvaluationSettings = TINY, judge: Judge | None = None) -> Trial:
        return Trial(tiny_model, dataset, judge or Judge(real), settings)

    return make
