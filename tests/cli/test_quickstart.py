from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from motionkit.evaluation import quick
from motionkit.models.checkpoint import load_model
from motionkit.training import presets


@pytest.fixture
def clips(clips_folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(clips_folder, tmp_path / "mine"))


@pytest.mark.usefixtures("briefly_calibrated")
def test_a_folder_becomes_a_model_with_pictures_and_a_verdict(
    motionkit, clips: Path, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr(presets, "FINE_TUNE", presets.FINE_TUNE | {"splices": 2, "batch": 2, "window": 16})
    monkeypatch.setattr("motionkit.cli.quickstart.SHOWN_SECONDS", 0.2)
    monkeypatch.setattr("motionkit.cli.quickstart.ROLL_OUT_SECONDS", 0.5)
    few = replace(quick.QUICK_TYPES, seeds=2, accuracy_seconds=3.0, repeats=1)
    for name, value in (("QUICK_TYPES", few), ("WALK_RADIUS", 0.5), ("RUN_RADIUS", 1.0)):
        monkeypatch.setattr(quick, name, value)
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
    assert motionkit("quickstart", "mine").code == 2  # exists


def test_bad_requests(motionkit, clips: Path, tmp_path: Path) -> None:
    assert motionkit("quickstart", "mine", "-o", "mine/out").code == 2
    assert motionkit("quickstart", "nothing").code == 2
    (tmp_path / "none").mkdir()
    assert motionkit("quickstart", "none").failed_with("no .bvh files found")
    assert {path.name for path in tmp_path.iterdir()} == {"mine", "none"}
