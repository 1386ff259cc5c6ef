"""Types are recognised by their motion: everything is measured on a model whose types have other names."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from motionkit.control.steering import usual_gaits
from motionkit.data.dataset import Dataset
from motionkit.lab.scoreboard.paths import paths_section
from motionkit.lab.scoreboard.response import commands, response_section
from motionkit.lab.scoreboard.roles import bears_on_hands, find_roles
from motionkit.lab.scoreboard.smoothness import sequences, smoothness_section
from motionkit.lab.scoreboard.trial import Trial
from motionkit.lab.scoreboard.visible import visible_section
from motionkit.models.model import MotionModel
from motionkit.training.verdict.judge import Judge, fitting_detectors
from motionkit.training.verdict.real import RealMotion

pytestmark = pytest.mark.thorough

NAMES = {
    "idle": "steht",
    "walking": "Gehen",
    "running": "Lauf_02",
    "b-walking": "zurück",
    "jumping-l": "左跳",
    "jumping-r": "右跳",
    "cartwheel": "Rad",
}


@pytest.fixture(scope="session")
def renamed_dataset(dataset_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """The small dataset under names that say nothing."""
    folder = tmp_path_factory.mktemp("renamed") / "motion"
    shutil.copytree(dataset_folder, folder)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["types"] = [NAMES[name] for name in manifest["types"]]
    for facts in ("phase_seconds", "phase_events"):
        manifest[facts] = {NAMES[name]: value for name, value in manifest[facts].items()}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return Dataset(folder)


@pytest.fixture
def renamed_trial(make_trial: Callable[..., Trial], renamed_dataset: Dataset) -> Trial:
    """The trial of the tiny model, its types renamed like the dataset's."""
    trial = make_trial()
    types = {NAMES[name]: kind for name, kind in trial.model.types.items()}
    judge = Judge(RealMotion(renamed_dataset))
    return Trial(replace(trial.model, types=types), renamed_dataset, judge, trial.settings)


def quiet(share: float) -> None:
    """Ignore progress."""


def test_detectors_are_found_by_recordings(make_trial: Callable[..., Trial], renamed_trial: Trial) -> None:
    named = fitting_detectors(make_trial().real)
    assert {"cartwheel", "idle", "jumping-l", "jumping-r"} <= set(named)
    assert all(kind == detector for kind, detector in named.items())
    assert fitting_detectors(renamed_trial.real) == {NAMES[kind]: name for kind, name in named.items()}


def test_a_misleading_name_gets_no_detector(renamed_dataset: Dataset) -> None:
    real = RealMotion(renamed_dataset)
    swap = {"Rad": "idle", "steht": "cartwheel"}
    real.types = tuple(swap.get(kind, kind) for kind in real.types)
    real.stretches = [replace(s, type=swap.get(s.type, s.type)) for s in real.stretches]
    found = fitting_detectors(real)
    assert found["idle"] == "cartwheel" and found["cartwheel"] == "idle"


def test_a_detector_that_fits_two_types_judges_neither(
    renamed_dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = RealMotion(renamed_dataset)
    real.types = (*real.types, "wartet")
    real.stretches += [replace(s, type="wartet") for s in real.of_type("steht")]
    assert fitting_detectors(real)["steht"] == "idle", "nothing else can judge a single recording"
    monkeypatch.setattr("motionkit.training.verdict.judge._has_profile", lambda real, kind: True)
    found = fitting_detectors(real)
    assert "steht" not in found and "wartet" not in found and found["Rad"] == "cartwheel"


def test_judging_by_own_clips_leaves_detectors_aside(renamed_trial: Trial) -> None:
    assert Judge(renamed_trial.real, by_recordings=True).detector("Rad") is None
    assert renamed_trial.judge.detector("Rad") is not None


def test_roles_need_no_names(make_trial: Callable[..., Trial], renamed_trial: Trial) -> None:
    named, other = find_roles(make_trial()), find_roles(renamed_trial)
    assert other.performances == tuple(NAMES[kind] for kind in named.performances)
    assert "Rad" in other.performances
    assert other.strikes == tuple(NAMES[kind] for kind in named.strikes)
    gaits = usual_gaits(make_trial().model)
    assert (other.gaits.walk, other.gaits.stand) == (NAMES[str(gaits.walk)], NAMES[str(gaits.stand)])
    assert bears_on_hands(renamed_trial.real, "Rad") and not bears_on_hands(renamed_trial.real, "Gehen")


def test_every_section_measures_a_model_with_other_names(
    renamed_trial: Trial, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("motionkit.control.follow.PATIENCE", -0.1)  # leaves a second or two
    monkeypatch.setattr("motionkit.lab.scoreboard.paths.speed_trials", lambda *kinds: [])
    monkeypatch.setattr("motionkit.lab.scoreboard.response.BEFORE_SECONDS", 0.5)
    monkeypatch.setattr("motionkit.lab.scoreboard.response.AFTER_SECONDS", 0.5)
    renamed_trial.settings = replace(renamed_trial.settings, seeds=1, repeats=1, accuracy_seconds=1.0)
    told = ""
    for measure in (response_section, smoothness_section, paths_section, visible_section):
        section = measure(renamed_trial, quiet)
        assert section.goals and section.tables[0].rows
        told += "".join(goal.what for goal in section.goals) + str(section.tables[0].rows)
    assert {"Rad", "Gehen", "steht"} <= {name for name in NAMES.values() if name in told}
    assert "steht → Gehen → steht: low toes" in told
    assert "lowest hands in Rad" in told and "Lauf_02 → Rad" in told
    assert not any(name in told for name in ("walking", "idle", "cartwheel"))


def test_sequences_need_two_types(make_trial: Callable[..., Trial], tiny_model: MotionModel) -> None:
    roles = find_roles(make_trial())
    found = sequences(roles)
    assert len(found) == len(set(found)) > 1
    assert all(a != b for sequence in found for a, b in pairwise(sequence))
    alone = replace(roles, performances=(), hops=(), strikes=(), lasting=(), gaits=usual_gaits(tiny_model))
    alone = replace(alone, gaits=replace(alone.gaits, walk=None, run=None))
    assert sequences(alone) == []
    assert not commands(replace(tiny_model, types={"Rad": tiny_model.types["cartwheel"]}))
