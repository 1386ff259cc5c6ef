"""The scoreboard of a model, section by section: the library call behind `motionkit evaluate`."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

from motionkit.data.dataset import Dataset
from motionkit.data.workers import worker_processes
from motionkit.errors import ControlError, DatasetError, MotionkitError
from motionkit.lab.scoreboard.accuracy import accuracy_section
from motionkit.lab.scoreboard.gaits import gaits_section
from motionkit.lab.scoreboard.paths import paths_section
from motionkit.lab.scoreboard.reconstruction import reconstruction_section
from motionkit.lab.scoreboard.report import Scoreboard, Section
from motionkit.lab.scoreboard.response import response_section
from motionkit.lab.scoreboard.settings import EvaluationSettings
from motionkit.lab.scoreboard.smoothness import smoothness_section
from motionkit.lab.scoreboard.stability import stability_section
from motionkit.lab.scoreboard.trial import Trial
from motionkit.lab.scoreboard.types import types_section
from motionkit.lab.scoreboard.variety import variety_section
from motionkit.lab.scoreboard.visible import visible_section
from motionkit.models.bundled import open_model
from motionkit.models.model import MotionModel
from motionkit.names import unknown_name
from motionkit.training.verdict.judge import Judge
from motionkit.training.verdict.real import RealMotion

# Called with the name of a section and the share of it that is done (0 to 1).
SectionProgress = Callable[[str, float], None]
Measure = Callable[[Trial, Callable[[float], None]], Section]


def _classes_section(trial: Trial, progress: Callable[[float], None]) -> Section:
    if find_spec("torch") is None:
        raise MotionkitError(
            "the section classes trains a classifier, which needs torch: pip install 'motionkit[train]'"
        )
    from motionkit.lab.scoreboard.classes import classes_section

    return classes_section(trial, progress)


SECTIONS: dict[str, Measure] = {
    "visible": visible_section,
    "accuracy": accuracy_section,
    "variety": variety_section,
    "stability": stability_section,
    "reconstruction": reconstruction_section,
    "gaits": gaits_section,
    "paths": paths_section,
    "response": response_section,
    "smoothness": smoothness_section,
    "types": types_section,
    "classes": _classes_section,
}
# Measured only where they are asked for: types sums up what the others measure at length, classes needs torch.
ON_REQUEST = ("types", "classes")


def evaluate(
    dataset: str | Path | Dataset,
    *,
    model: MotionModel | None = None,
    only: Iterable[str] = (),
    settings: EvaluationSettings | None = None,
    jobs: int = 1,
    progress: SectionProgress | None = None,
) -> Scoreboard:
    """The scoreboard of a model against the recordings of a dataset folder (docs/evaluation.md).

    Args:
        model: the bundled model by default.
        only: names of the sections to measure; all but those of ON_REQUEST by default.
        settings: how much is measured, on which split, with or without reference recordings; the test split, 20
            roll-outs of each type by default.
        jobs: processes that roll out; the result does not depend on them.
        progress: called with the section's name and the share of it that is done.

    Raises:
        ControlError: for an unknown section.
        DatasetError: for a folder that is no dataset, has none of the model's types, or another frame rate, layout or
            reference rotations.
    """
    model, settings = model or open_model(None), settings or EvaluationSettings()
    dataset = dataset if isinstance(dataset, Dataset) else Dataset(dataset)
    chosen = list(only) or [name for name in SECTIONS if name not in ON_REQUEST]
    for name in chosen:
        if name not in SECTIONS:
            raise ControlError(unknown_name("section", name, tuple(SECTIONS)))
    if not set(model.types) & set(dataset.types):
        raise DatasetError(f"{dataset.folder}: the dataset has none of the model's motion types")
    if abs(dataset.fps - model.fps) > 1e-6:
        raise DatasetError(f"{dataset.folder}: {dataset.fps:g} fps, expected the model's {model.fps:g}")
    dataset.check_layout(model.config.layout, "the model needs")
    if not dataset.encoded_alike(model.reference_rotations):
        raise DatasetError(
            f"{dataset.folder}: the reference rotations differ from the model's; preprocess it again with --references "
            "and this model"
        )
    judge = Judge(RealMotion(dataset, settings.split))
    sections = []
    with worker_processes(jobs) as each:
        trial = Trial(model.with_reference(settings.reference), dataset, judge, settings, each)
        for name in SECTIONS:
            if name in chosen:
                began = time.perf_counter()

                def report(share: float, name: str = name) -> None:
                    if progress:
                        progress(name, share)

                report(0.0)
                section = SECTIONS[name](trial, report)
                sections.append(replace(section, seconds=time.perf_counter() - began))
    return Scoreboard(settings.as_dict(), sections)
