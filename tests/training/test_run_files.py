"""The files of a run when something fails, and checkpoints from untrusted sources."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from motionkit.errors import DatasetError, ModelError, MotionkitError
from motionkit.models.checkpoint import load_model
from motionkit.training import outcome, run_state
from motionkit.training.report import TrainEvent
from motionkit.training.run_state import TAKEN, run_options
from motionkit.training.trainer import train

pytestmark = pytest.mark.thorough

ODD_NAMES = ("walk/run", "aux", "..")


def renamed(dataset_folder: Path, to: Path, names: tuple[str, ...]) -> Path:
    """Copy a dataset and rename its types without a phase."""
    shutil.copytree(dataset_folder, to)
    manifest = json.loads((to / "manifest.json").read_text())
    plain = [kind for kind in manifest["types"] if kind not in manifest["phase_seconds"]]
    other = dict(zip(plain, names, strict=False))
    manifest["types"] = [other.get(kind, kind) for kind in manifest["types"]]
    (to / "manifest.json").write_text(json.dumps(manifest))
    return to


@pytest.mark.usefixtures("briefly_calibrated")
def test_types_whose_names_are_no_file_names(dataset_folder: Path, tmp_path: Path, tiny_options) -> None:
    folder = renamed(dataset_folder, tmp_path / "ds", ODD_NAMES)
    path = tmp_path / "run" / "m.safetensors"
    notes: list[str] = []
    train(folder, path, tiny_options(steps=1, score_seconds=0.1), device="cpu", on_event=_notes(notes))
    model = load_model(path)
    assert set(ODD_NAMES) < set(model.types) and set(model.card["scores"]) == set(model.types)
    samples = [sample.name for sample in (tmp_path / "run" / "m.run" / "samples").iterdir()]
    assert len(samples) == 2 * len(model.types)
    assert not any(word in note for note in notes for word in ("failed", "missing")), notes
    assert {p.name for p in (tmp_path / "run").iterdir()} == {"m.safetensors", "m.run"}


@pytest.mark.usefixtures("briefly_calibrated")
def test_a_new_run_has_nothing_of_an_earlier_one(dataset_folder: Path, tmp_path: Path, tiny_options) -> None:
    path, run = tmp_path / "m.safetensors", tmp_path / "m.run"
    train(dataset_folder, path, tiny_options(steps=2, score_seconds=0.1), device="cpu")
    (run / "samples" / "a-type-of-other-data-predicted.bvh").touch()
    (run / "preview").mkdir()
    (run / "preview" / "idle-step-2.bvh").touch()
    (run / "samples" / "clip of mine.bvh").touch()
    notes = (run / "log.jsonl").read_text("utf-8").splitlines()
    train(dataset_folder, path, tiny_options(steps=2, score_seconds=0.1), device="cpu")
    assert len((run / "log.jsonl").read_text("utf-8").splitlines()) == len(notes)
    assert not list(run.glob("samples/a-type*")) and not list(run.glob("preview/*"))
    assert (run / "samples" / "clip of mine.bvh").exists()


@pytest.mark.usefixtures("briefly_calibrated")
def test_a_finished_run_that_is_resumed_leaves_the_same_model(
    dataset_folder: Path, tmp_path: Path, tiny_options
) -> None:
    path = tmp_path / "m.safetensors"
    train(dataset_folder, path, tiny_options(steps=2, score_seconds=0.1), device="cpu")
    made = load_model(path)
    train(dataset_folder, path, tiny_options(steps=2, score_seconds=0.1), resume=True, device="cpu")
    again = load_model(path)
    assert again.card["losses"] == made.card["losses"] != {} and again.card["scores"] == made.card["scores"]
    assert {k: t.preset for k, t in again.types.items()} == {k: t.preset for k, t in made.types.items()}


def test_a_name_that_models_cannot_hold_is_an_error_before_training(
    dataset_folder: Path, tmp_path: Path, tiny_options
) -> None:
    folder = renamed(dataset_folder, tmp_path / "ds", ("x" * 201,))
    with pytest.raises(DatasetError, match="which has 201 characters"):
        train(folder, tmp_path / "m.safetensors", tiny_options(steps=1), device="cpu")
    assert [p.name for p in tmp_path.iterdir()] == ["ds"]


def _notes(notes: list[str]) -> Callable[[TrainEvent], None]:
    def on_event(event: TrainEvent) -> None:
        if event.kind == "note":
            notes.append(event.text)

    return on_event


@pytest.mark.usefixtures("briefly_calibrated")
def test_the_model_is_written_before_the_score_and_a_failed_score_is_a_note(
    dataset_folder: Path, tmp_path: Path, tiny_options, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "m.safetensors"
    there: list[bool] = []

    def fail(*_: object, **__: object) -> None:
        there.append(path.is_file())
        raise RuntimeError("no such\nthing")

    monkeypatch.setattr(outcome, "score_rollouts", fail)
    notes: list[str] = []
    options = tiny_options(steps=1, score_seconds=0.1)
    result = train(dataset_folder, path, options, device="cpu", on_event=_notes(notes))
    assert result.finished and there == [True] and load_model(path).card["steps"] == 1
    assert "the score failed, the run continues: no such thing" in notes


@pytest.mark.usefixtures("briefly_calibrated")
def test_scores_survive_samples_that_cannot_be_written(
    dataset_folder: Path, tmp_path: Path, tiny_options
) -> None:
    path = tmp_path / "m.safetensors"
    (tmp_path / "m.run").mkdir()
    (tmp_path / "m.run" / "samples").write_text("in the way")
    notes: list[str] = []
    options = tiny_options(steps=1, score_seconds=0.1)
    train(dataset_folder, path, options, device="cpu", on_event=_notes(notes))
    assert any(note.startswith("cannot write samples: ") for note in notes)
    assert len(load_model(path).card["scores"]) == 6


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_a_log_on_a_full_disk_is_a_note(dataset_folder: Path, tmp_path: Path, tiny_options) -> None:
    (tmp_path / "m.run").mkdir()
    os.symlink("/dev/full", tmp_path / "m.run" / "log.jsonl")
    notes: list[str] = []
    path = tmp_path / "m.safetensors"
    train(dataset_folder, path, tiny_options(steps=3), device="cpu", on_event=_notes(notes))
    assert load_model(path).card["steps"] == 3
    assert len([note for note in notes if note.startswith("cannot write log.jsonl (No space left")]) == 1


def test_the_model_is_written_even_if_the_checkpoint_is_not(
    dataset_folder: Path, tmp_path: Path, tiny_options
) -> None:
    path = tmp_path / "m.safetensors"
    (tmp_path / "m.run" / "checkpoint.safetensors").mkdir(parents=True)
    options = tiny_options(steps=2, checkpoint_seconds=0.0)
    with pytest.raises(MotionkitError, match=r"checkpoint\.safetensors: is a folder"):
        train(dataset_folder, path, options, device="cpu")
    assert load_model(path).card["steps"] == 2


# ---- checkpoints from untrusted sources ----


@pytest.fixture(scope="module")
def finished_run(dataset_folder: Path, tmp_path_factory: pytest.TempPathFactory, tiny_options) -> Path:
    """The folder of a finished run; tests must not write to it."""
    folder = tmp_path_factory.mktemp("run")
    train(dataset_folder, folder / "m.safetensors", tiny_options(steps=1, splices=0), device="cpu")
    return folder / "m.run"


def test_a_resumed_run_keeps_its_splices(
    dataset_folder, tmp_path: Path, finished_run: Path, tiny_options
) -> None:
    shutil.copytree(finished_run, tmp_path / "m.run")
    for steps in (2, 3):
        said: list[str] = []
        options = tiny_options(steps=steps, splices=5)
        train(
            dataset_folder,
            tmp_path / "m.safetensors",
            options,
            True,
            device="cpu",
            on_event=lambda event: said.append(event.text),  # noqa: B023
        )
        assert "0 spliced transitions" in said


def _first(tensors: dict[str, torch.Tensor], prefix: str) -> str:
    return min(name for name in tensors if name.startswith(prefix))


@pytest.mark.parametrize(
    ("prefix", "change", "complaint"),
    [
        ("optimizer.exp_avg.", lambda t: t.flatten()[:1], "has shape (1,), expected"),
        ("optimizer.exp_avg_sq.", lambda t: -1.0 - t.abs(), "has -1"),
        ("optimizer.step.", lambda t: t * 0.0, "has 0"),
        ("optimizer.step.", lambda t: None, "is missing"),
        ("optimizer.momentum.", lambda t: t[:1], "expected (2, "),
        ("average.", lambda t: t.half(), "is of type F16"),
        ("average.", lambda t: None, "is missing"),
        ("weights.", lambda t: t * torch.nan, "numbers that are NaN, infinite or above"),
        ("random.cpu", lambda t: t[:7], "has shape (7,), expected"),
        ("random.cpu", lambda t: t.float(), "is of type F32"),
    ],
)
def test_tensors_of_a_checkpoint(
    dataset_folder: Path,
    finished_run: Path,
    tmp_path: Path,
    tiny_options,
    prefix: str,
    change,
    complaint: str,
) -> None:
    def spoil(tensors: dict[str, torch.Tensor], facts: dict[str, Any]) -> None:
        name = _first(tensors, prefix)
        value = change(tensors.pop(name))
        if value is not None:
            tensors[name] = value

    assert complaint in _resumed(dataset_folder, finished_run, tmp_path, tiny_options, spoil)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"step": "one"}, "step is 'one'"),
        ({"step": -1}, "step is -1"),
        ({"seconds": None}, "seconds is None"),
        ({"cycles": -1}, "cycles is -1"),
        ({"options": [1]}, "options is [1], expected an object"),
        ({"options": {"batch": [[]]}}, "started with optimizer.batch [[]] (now 4)"),
        ({"options": {"optimizer": {"rate": 0.5}}}, "started with optimizer.rate 0.5 (now 0.001)"),
        # Checkpoints of earlier releases, without groups.
        ({"options": {"rate": 0.5, "half": True}}, "started with optimizer.rate 0.5 (now 0.001); resume"),
        (
            {"options": {"sampler": {"lead_share": 0.9}}},
            "started with sampler.controls.lead_share 0.9 (now 0.5)",
        ),
        ({"options": {"evenness": 0.0}}, "started with losses.beta_nll 0.0 (now 0.5)"),
        (
            {"options": {"self_feed": {"guided_back": 0.5}}},
            "scheduled_sampling.reference_back 0.5 (now 0.02)",
        ),
    ],
)
def test_facts_of_a_checkpoint(
    dataset_folder: Path, finished_run: Path, tmp_path: Path, tiny_options, change: dict, complaint: str
) -> None:
    def spoil(tensors: dict[str, torch.Tensor], facts: dict[str, Any]) -> None:
        facts |= change

    assert complaint in _resumed(dataset_folder, finished_run, tmp_path, tiny_options, spoil, method="adamw")


def test_ends_of_cycles_must_be_there(
    dataset_folder: Path, finished_run: Path, tmp_path: Path, tiny_options
) -> None:
    def spoil(tensors: dict[str, torch.Tensor], facts: dict[str, Any]) -> None:
        facts["cycles"] = 1

    assert "tensor 'ends." in _resumed(dataset_folder, finished_run, tmp_path, tiny_options, spoil)


def test_a_run_goes_on_with_features_of_the_same_references(
    dataset_folder: Path, finished_run: Path, tmp_path: Path, tiny_options
) -> None:
    """They may be encoded relative to other rotations although files and options are the same."""

    def spoil(tensors: dict[str, torch.Tensor], facts: dict[str, Any]) -> None:
        facts["references"][3] = [0.8, 0.6, 0.0, 0.0]

    checkpoint = tmp_path / "m.run" / "checkpoint.safetensors"
    _spoilt(finished_run, checkpoint, spoil)
    with pytest.raises(DatasetError, match="started with other reference rotations than those of"):
        train(
            dataset_folder,
            tmp_path / "m.safetensors",
            tiny_options(steps=2, splices=0),
            resume=True,
            device="cpu",
        )


@pytest.mark.parametrize("name", TAKEN)
@pytest.mark.parametrize("value", ["x", -1, 1e99, [1], True, "left out"])
def test_what_a_resumed_run_takes_from_its_checkpoint_is_checked(
    dataset_folder: Path, finished_run: Path, tmp_path: Path, tiny_options, name: str, value: object
) -> None:
    def spoil(tensors: dict[str, torch.Tensor], facts: dict[str, Any]) -> None:
        *group, key = name.split(".")
        options = facts["options"][group[0]] if group else facts["options"]
        options[key] = value
        if value == "left out":
            del options[key]

    checkpoint = tmp_path / "m.run" / "checkpoint.safetensors"
    if name == "sampler.splices":
        assert f"damaged ({name} is" in _resumed(dataset_folder, finished_run, tmp_path, tiny_options, spoil)
    else:
        _spoilt(finished_run, checkpoint, spoil)
    if value == "left out" and name not in ("seed", "sampler.splices"):
        assert run_options(checkpoint)[name] is None
    else:
        with pytest.raises(ModelError, match=rf"checkpoint.safetensors: .* damaged \({name} is "):
            run_options(checkpoint)


def test_runs_of_earlier_releases_had_adamw_alone(
    dataset_folder: Path, finished_run: Path, tmp_path: Path, tiny_options
) -> None:
    def spoil(tensors: dict[str, torch.Tensor], facts: dict[str, Any]) -> None:
        del facts["options"]["optimizer"]["method"]

    complaint = _resumed(dataset_folder, finished_run, tmp_path, tiny_options, spoil)
    assert "started with optimizer.method 'adamw' (now 'muon'); resume it with the same" in complaint


def _spoilt(run: Path, checkpoint: Path, spoil: Callable) -> None:
    """Write a damaged copy of a run's checkpoint."""
    checkpoint.parent.mkdir()
    with safe_open(str(run / "checkpoint.safetensors"), framework="pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}
        facts = json.loads(file.metadata()["run"])
    spoil(tensors, facts)
    save_file({n: t.contiguous() for n, t in tensors.items()}, checkpoint, {"run": json.dumps(facts)})


def _resumed(
    dataset_folder: Path, run: Path, tmp_path: Path, tiny_options, spoil: Callable, **options: Any
) -> str:
    """Return the error for a damaged copy of a run; check that nothing is written."""
    checkpoint = tmp_path / "m.run" / "checkpoint.safetensors"
    _spoilt(run, checkpoint, spoil)
    with pytest.raises(ModelError) as caught:
        now = tiny_options(steps=2, splices=0, **options)
        train(dataset_folder, tmp_path / "m.safetensors", now, resume=True, device="cpu")
    message = str(caught.value)
    assert message.startswith(f"{checkpoint}: ") and len(message.splitlines()) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["m.run"] and list(checkpoint.parent.iterdir()) == [
        checkpoint
    ]
    return message


@pytest.mark.parametrize(
    ("block", "fault"),
    [
        ({"step": 1000, "progress": 0.0}, None), ({"step": 1999, "progress": 1.0}, None), (None, None),
        ({"step": 999, "progress": 0.5}, "first step of the block"), ({"step": 1.5, "progress": 0.5}, "first step"),
        ({"step": 2000, "progress": 0.5}, "first step of the block"), ({"step": 1500, "progress": 1.1}, "progress"),
        ({"step": 1500}, "progress"), ({}, "first step"), (7, "first step"),
    ],
)  # fmt: skip
def test_the_block_of_a_checkpoint(block: object, fault: str | None) -> None:
    facts = {"step": 2000, "seconds": 1.0, "options": {}, "block": block}
    if fault is None:
        run_state._check_facts(facts)
    else:
        with pytest.raises(ModelError, match=fault):
            run_state._check_facts(facts)
