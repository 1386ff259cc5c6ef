from __future__ import annotations

import json
import os
import shlex
import shutil
import signal
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from motionkit import first_model
from motionkit.data.dataset import Dataset
from motionkit.models.checkpoint import load_model
from motionkit.motion.bvh import write_bvh
from motionkit.training import presets
from motionkit.training.trainer import TrainingRun
from motionkit.training.verdict import types as quick
from motionkit.training.verdict.types import TypeVerdict
from synthetic_motions import make_walk

pytestmark = pytest.mark.thorough


@pytest.fixture
def clips(clips_folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(clips_folder, tmp_path / "mine"))


@pytest.fixture
def brief(briefly_calibrated: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """A quickstart of seconds."""
    monkeypatch.setattr(presets, "FINE_TUNE", presets.FINE_TUNE | {"splices": 2, "batch": 2, "window": 16})
    monkeypatch.setattr("motionkit.first_model.EXAMPLE_SECONDS", 0.2)
    monkeypatch.setattr("motionkit.first_model.ROLL_OUT_SECONDS", 0.5)
    few = replace(quick.QUICK_TYPES, seeds=2, accuracy_seconds=3.0, repeats=1)
    for name, value in (("QUICK_TYPES", few), ("WALK_RADIUS", 0.5), ("RUN_RADIUS", 1.0)):
        monkeypatch.setattr(quick, name, value)


@pytest.mark.usefixtures("brief")
def test_a_folder_becomes_a_model_with_pictures_and_a_verdict(motionkit, clips: Path, tmp_path: Path) -> None:
    said = motionkit("quickstart", "mine", "--steps", 1, "--device", "cpu", "--json")
    assert said.code == 0, said.err
    value = json.loads(said.out)
    folder = tmp_path / "mine-model"
    assert {path.name for path in folder.iterdir()} >= {
        "dataset", "model.safetensors", "motions.html", "motions.png", "verdict.md"
    }  # fmt: skip
    model = load_model(folder / "model.safetensors")
    assert {v["type"] for v in value["verdicts"]} <= set(model.types) and value["verdicts"]
    for verdict in value["verdicts"]:
        assert verdict["works"] == (not verdict["reasons"]) and verdict["rollouts"] > 0
    text = (folder / "verdict.md").read_text("utf-8")
    assert all(f"| {v['type']} |" in text for v in value["verdicts"])
    said = motionkit("quickstart", "mine", "--add")
    assert said.code == 2 and "go on with: motionkit quickstart mine --add --resume, or" in said.err


def test_bad_requests(motionkit, clips: Path, tmp_path: Path) -> None:
    assert motionkit("quickstart", "mine", "-o", "mine/out").code == 2
    assert motionkit("quickstart", "nothing").code == 2
    (tmp_path / "none").mkdir()
    assert motionkit("quickstart", "none").failed_with("no .bvh, .amc, .npz, .glb, .vrm or .fbx files found")
    assert {path.name for path in tmp_path.iterdir()} == {"mine", "none"}
    assert motionkit("quickstart", "mine", "--force", "--resume").code == 2


@pytest.mark.usefixtures("brief")
def test_it_goes_on_wherever_it_stopped(motionkit, clips: Path, tmp_path: Path, monkeypatch) -> None:
    """Each time by the command that it has printed."""
    target, words = tmp_path / "mine-model", ["quickstart", "mine", "--steps", 2, "--device", "cpu"]
    steps: list[int] = []
    step, prepared = TrainingRun._train_step, []
    again = shlex.join(["motionkit", *map(str, words), "--resume"])

    def counted(run: TrainingRun) -> dict[str, float]:
        out = step(run)
        steps.append(run.progress.step)
        if len(steps) == 1:
            os.kill(os.getpid(), signal.SIGINT)
        return out

    def stop(*_: object, **__: object) -> None:
        signal.raise_signal(signal.SIGINT)

    def look(data: Path, watcher: Any, found: Any = first_model._look) -> None:
        prepared.append(data)
        found(data, watcher)

    monkeypatch.setattr(TrainingRun, "_train_step", counted)
    monkeypatch.setattr(first_model, "_look", look)
    for place in (
        "data.first_pass.prepare_file", "training.sampler.WindowSampler.make_splices", None,
        "training.outcome.calibrated_gains", "first_model._show", "first_model._judge",
    ):  # fmt: skip
        with monkeypatch.context() as patched:
            if place is not None:
                patched.setattr(f"motionkit.{place}", stop)
            said = motionkit(*words)
        assert said.code == 130, (place, said.err)
        assert said.err.splitlines()[-1] == f"go on with: {again}"
        assert not (target / "verdict.md").exists()
        words = shlex.split(again)[1:]
    assert steps == [1, 2], "what was trained is not trained again"
    assert len(prepared) == 2, "the dataset is made once, after the run that was stopped while reading"
    said = motionkit(*words)
    assert said.code == 0 and "types work; wrote" in said.out
    assert {"motions.html", "motions.png", "verdict.md"} <= {path.name for path in target.iterdir()}
    assert steps == [1, 2] and load_model(target / "model.safetensors").card["steps"] == 2
    (tmp_path / "other").mkdir()
    write_bvh(tmp_path / "other" / "spin.bvh", make_walk(90, turn=2.0))
    said = motionkit("quickstart", "other", "-o", target, "--steps", 2, "--resume")
    assert said.code == 2 and "was made of other clips than other; begin anew with --force" in said.err
    for other in (["--add"], ["--seed", "7"], ["--no-mirror"]):
        said = motionkit(*words[:-1], *other, "--resume")
        assert said.code == 2 and "was begun with" in said.err, other


@pytest.mark.usefixtures("brief")
def test_changed_clips_are_told(motionkit, clips: Path) -> None:
    words = ("quickstart", "mine", "--steps", 1, "--device", "cpu")
    assert motionkit(*words).code == 0
    assert "newer" not in motionkit(*words, "--resume").err
    changed = sorted(clips.glob("*.bvh"))[0]
    later = changed.stat().st_mtime + 3600
    os.utime(changed, (later, later))
    said = motionkit(*words, "--resume")
    assert said.code == 0 and f"{changed.name} is newer than" in said.err
    os.utime(changed, (later - 7200, later - 7200))
    table = clips / "labels.csv"
    table.write_text(f"file,start_frame,end_frame,type\n{changed.name},0,-1,other\n")
    os.utime(table, (later, later))
    said = motionkit(*words, "--resume")
    assert said.code == 0 and "labels.csv is newer than" in said.err


@pytest.fixture
def old_results(clips: Path, tmp_path: Path) -> set[Path]:
    """What an earlier quickstart has left."""
    target = tmp_path / "mine-model"
    files = {target / name for name in ("model.safetensors", "motions.html", "motions.png", "verdict.md")}
    files |= {target / "model.run" / "checkpoint.safetensors"}
    for file in files:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    (target / "notes.txt").touch()
    return files


@pytest.mark.parametrize(("stage", "left"), [("_look", True), ("_preprocess", False), ("_train", False)])
def test_no_old_result_stands_beside_a_new_model(
    motionkit, old_results: set[Path], tmp_path: Path, monkeypatch, stage: str, left: bool
) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(first_model, stage, stop)
    said = motionkit("quickstart", "mine", "--force", "--no-mirror")
    assert said.code == 130
    assert {file.exists() for file in old_results} == {left} and (tmp_path / "mine-model/notes.txt").exists()
    way = "--force" if left else "--resume"
    assert said.err.endswith(f"go on with: motionkit quickstart mine --no-mirror {way}\n")
    if stage == "_train":
        assert not any(clip.mirrored for clip in Dataset(tmp_path / "mine-model" / "dataset").clips)


def test_what_cannot_be_learnt_is_told_before_training(motionkit, clips: Path, tmp_path: Path) -> None:
    (tmp_path / "short").mkdir()
    write_bvh(tmp_path / "short" / "a.bvh", make_walk(18))
    said = motionkit("quickstart", "short")
    assert said.failed_with("no type can be learnt; a: ", "too short, at most 0.3 s, and 0.4 s are needed")
    write_bvh(tmp_path / "short" / "a.bvh", make_walk(10))
    assert motionkit("quickstart", "short").failed_with("none of the 1 files can be used")
    table = clips / "labels.csv"
    table.write_text(table.read_text("utf-8").replace(",train,", ",test,"), "utf-8")
    said = motionkit("quickstart", "mine")
    assert said.failed_with("no type can be learnt", "split column of labels.csv", "more types)")
    assert {path.name for path in tmp_path.iterdir()} == {"mine", "short"}, "nothing half-made"


def test_types_that_do_not_work_are_not_suggested(
    motionkit, clips: Path, tmp_path: Path, monkeypatch
) -> None:
    good = TypeVerdict('a "walk"', 9, 40.0, 8, 8, 1.0, 0.4, 1.0, 0.6)
    bad = replace(good, type="bad", reasons=("shown in 1 of 8 roll-outs",))
    lost = replace(good, type="lost", rollouts=0, reasons=("there are no clips to learn from",))
    monkeypatch.setattr(first_model, "_train", lambda *_: SimpleNamespace(card={"steps": 3, "seconds": 60.0}))
    monkeypatch.setattr(first_model, "_show", lambda *_: [])
    for verdicts, suggested in (([lost, bad, good], 'a "walk"'), ([lost, bad], "bad"), ([lost], None)):
        monkeypatch.setattr(first_model, "_judge", lambda *_, found=verdicts: found)
        said = motionkit("quickstart", "mine", "--force", "--json")
        assert said.code == 0
        said = motionkit("quickstart", "mine", "--force")
        lines = said.out.splitlines()
        assert any(line.startswith("lost does not work: ") for line in lines)
        assert not any("warning: hop" in line and "held out" in line for line in said.err.splitlines())
        last = shlex.split(lines[-1])
        if suggested is None:
            assert "try:" not in said.out
        else:
            assert last[:3] == ["try:", "motionkit", "synthesize"] and last[-2] == suggested
