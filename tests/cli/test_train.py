from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

import motionkit as mk
from motionkit.models.checkpoint import load_model
from motionkit.training.trainer import TrainResult

QUICK = ("--preset", "tiny", "--batch", 2, "--window", 16, "--splices", 0, "--device", "cpu")


@pytest.mark.usefixtures("unscored")
def test_a_short_run_and_going_on(motionkit, dataset_folder: Path, tmp_path: Path) -> None:
    said = motionkit("train", dataset_folder, "-o", "m.safetensors", *QUICK, "--steps", 2)
    assert said.code == 0
    assert said.out.startswith("trained after 2 steps") and said.out.rstrip().endswith("wrote m.safetensors")
    assert "parameters on cpu" in said.err
    said = motionkit(
        "train", dataset_folder, "-o", "m.safetensors", *QUICK, "--steps", 3, "--resume", "--json"
    )
    value = json.loads(said.out)
    assert said.code == 0 and (value["steps"], value["finished"]) == (3, True)
    assert {"gauss", "smooth", "contact", "fk", "consistency", "trajectory", "total"} <= set(value["losses"])
    assert load_model(tmp_path / "m.safetensors").card["steps"] == 3


def test_a_run_folder_that_cannot_be_made(motionkit, dataset_folder: Path, tmp_path: Path) -> None:
    (tmp_path / "m.run").touch()
    said = motionkit("train", dataset_folder, "-o", "m.safetensors", *QUICK, "--steps", 1)
    assert said.code == 1 and "m.run: cannot be written (File exists)" in said.err


def test_a_model_has_an_ending(motionkit, dataset_folder: Path, tmp_path: Path) -> None:
    said = motionkit("train", dataset_folder, "-o", "mod2", *QUICK, "--steps", 1)
    assert said.code == 2 and "-o mod2: expected a name that ends in .safetensors" in said.err
    assert not list(tmp_path.iterdir())


def test_clips_that_are_all_held_out(motionkit, clips_folder: Path, tmp_path: Path) -> None:
    shutil.copytree(clips_folder, tmp_path / "mine")
    table = tmp_path / "mine" / "labels.csv"
    table.write_text(table.read_text("utf-8").replace(",train,", ",test,"), "utf-8")
    assert motionkit("preprocess", "mine", "-o", "ds").code == 0
    said = motionkit("train", "ds", "-o", "m.safetensors", *QUICK, "--steps", 1)
    assert said.code == 1 and "no training clips; the split column of labels.csv" in said.err


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--resume"], "no checkpoint to resume from"),
        (["--device", "cuda:77"], "device 'cuda:77' not found"),
        (["--device", "toaster"], "unknown device 'toaster'"),
        (["--type-weights", "walking=1,flying=2"], "--type-weights: unknown type 'flying'"),
        (["--step-weight", "9", "--step-except", "walking, flying"], "--step-except: unknown type 'flying'"),
        (["--preset", "tptn-paper"], "run preprocess with --layout expmap-root-1"),
    ],
)
def test_faults(motionkit, dataset_folder: Path, tmp_path: Path, words: list[str], complaint: str) -> None:
    said = motionkit("train", dataset_folder, *QUICK, "--steps", 1, *words)
    assert said.failed_with(complaint)
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("unscored")
def test_a_share_of_windows_without_reference_poses(motionkit, dataset_folder: Path, tmp_path: Path) -> None:
    words = ("--reference-dropout", 0.8, "--trajectory-drift", 0.1)
    said = motionkit("train", dataset_folder, *QUICK, "--steps", 1, *words)
    controls = load_model(tmp_path / "model.safetensors").card["options"]["sampler"]["controls"]
    assert said.code == 0 and (controls["reference_dropout"], controls["trajectory_drift"]) == (0.8, 0.1)
    said = motionkit("train", dataset_folder, *QUICK, "--steps", 1, "--reference-dropout", 1.5)
    assert said.code == 2 and "1.5 is not in the range 0.0<=x<=1.0" in said.err


@pytest.mark.parametrize("text", ["walking", "walking=", "=2", "walking=much", "walking=-1", "walking=nan"])
def test_malformed_type_weights(motionkit, dataset_folder: Path, text: str) -> None:
    said = motionkit("train", dataset_folder, *QUICK, "--steps", 1, "--type-weights", text)
    assert said.code == 2 and f"{text!r}: expected TYPE=NUMBER, with a number from 0 to 1000" in said.err


def test_a_folder_that_is_no_dataset(motionkit, tmp_path: Path) -> None:
    (tmp_path / "clips").mkdir()
    assert motionkit("train", "clips", *QUICK, "--steps", 1).failed_with("not a dataset folder")


def test_a_damaged_dataset(motionkit, dataset_folder: Path, tmp_path: Path) -> None:
    shutil.copytree(dataset_folder, tmp_path / "ds")
    (tmp_path / "ds" / "features.npy").write_bytes(b"torn")
    assert motionkit("train", "ds", *QUICK, "--steps", 1).failed_with("features.npy")
    assert [p.name for p in tmp_path.iterdir()] == ["ds"]


@pytest.mark.usefixtures("unscored")
def test_the_log_of_another_run_is_kept(motionkit, dataset_folder: Path, tmp_path: Path) -> None:
    words = ("train", dataset_folder, *QUICK, "--log-dir", "logs")
    assert motionkit(*words, "-o", "a.safetensors", "--steps", 1).code == 0
    kept = (tmp_path / "logs" / "log.csv").read_bytes()
    refused = motionkit(*words, "-o", "b.safetensors", "--steps", 1)
    assert refused.code == 2
    assert "log.csv: exists; choose another folder, or replace it with --force" in refused.err
    assert (tmp_path / "logs" / "log.csv").read_bytes() == kept
    assert motionkit(*words, "-o", "a.safetensors", "--steps", 2, "--resume").code == 0
    assert motionkit(*words, "-o", "a.safetensors", "--steps", 2, "--resume", "--force").code == 2


@pytest.mark.parametrize("words", [(), ("--json",)])
def test_a_run_that_is_stopped_says_so(
    motionkit, dataset_folder: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    result = TrainResult(Path("m.safetensors"), 1, 1.0, False, {"total": 1.0})
    monkeypatch.setattr(mk, "train", lambda *_: result)
    said = motionkit("train", dataset_folder, "-o", "m.safetensors", *QUICK, "--steps", 2, *words)
    assert said.code == 130
