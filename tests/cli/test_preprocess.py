from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from motionkit.data.dataset import Dataset
from motionkit.motion.bvh import write_bvh
from synthetic_motions import make_idle, make_walk


@pytest.fixture
def clips(tmp_path: Path) -> Path:
    """A folder with two good clips and a broken one."""
    folder = tmp_path / "clips"
    folder.mkdir()
    write_bvh(folder / "walk.bvh", make_walk(60))
    write_bvh(folder / "idle.bvh", make_idle(60))
    (folder / "torn.bvh").write_text("HIERARCHY\nROOT Hips\n{\n")
    return folder


def test_the_table_is_on_stdout_and_what_was_skipped_on_stderr(
    motionkit, clips: Path, tmp_path: Path
) -> None:
    said = motionkit("preprocess", clips, "--jobs", 1)
    for words in (
        "walk",
        "idle",
        "train min",
        "types from folder and file names",
        "files: 2 used, 1 skipped",
    ):
        assert words in said.out
    assert "units: " in said.out and "cleaned: " in said.out
    skipped, verdict = said.err.strip().splitlines()
    assert skipped.startswith("skipped ") and "torn.bvh" in skipped
    assert said.code == 1 and verdict.startswith("error: 1 of 3 files")
    assert Dataset(tmp_path / "datasets" / "motion").types == ("idle", "walk"), "the others are still used"


def test_json_without_faults(motionkit, clips: Path) -> None:
    (clips / "torn.bvh").unlink()
    said = motionkit("preprocess", clips, "-o", "out", "--jobs", 1, "--json")
    value = json.loads(said.out)
    assert said.code == 0 and said.err == ""
    assert value["dataset"] == "out" and value["labels"] is None
    assert set(value["types"]) == {"idle", "walk"}
    assert value["seconds"] == pytest.approx(2.0)


def test_json_names_the_skipped(motionkit, clips: Path) -> None:
    said = motionkit("preprocess", clips, "-o", "out", "--jobs", 1, "--json")
    skipped = {Path(f["name"]).name: f["skipped"] for f in json.loads(said.out)["files"] if f["skipped"]}
    assert list(skipped) == ["torn.bvh"] and said.code == 1


def test_strict(motionkit, clips: Path, tmp_path: Path) -> None:
    said = motionkit("preprocess", clips, "-o", "out", "--jobs", 1, "--strict")
    assert said.failed_with("torn.bvh", "--strict")
    assert [p.name for p in tmp_path.iterdir()] == ["clips"]


def test_a_broken_label_table_names_the_line(motionkit, clips: Path, tmp_path: Path) -> None:
    (tmp_path / "l.csv").write_text("file,start_frame,end_frame,type\nwalk.bvh,a,2,walking\n")
    said = motionkit("preprocess", clips, "-o", "out", "--labels", "l.csv")
    assert said.failed_with("l.csv:2", "expected a number for start_frame")
    assert not (tmp_path / "out").exists()


def test_no_bvh_files(motionkit, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    assert motionkit("preprocess", "empty").failed_with("no .bvh, .amc, .npz, .glb, .vrm or .fbx files found")
    assert [p.name for p in tmp_path.iterdir()] == ["empty"]


def test_a_folder_that_is_no_dataset_is_not_replaced(motionkit, clips: Path, tmp_path: Path) -> None:
    said = motionkit("preprocess", clips, "-o", clips, "--jobs", 1)
    assert said.failed_with("not a dataset folder")
    assert len(list(clips.iterdir())) == 3


def test_given_units_and_rate(motionkit, clips: Path) -> None:
    said = motionkit("preprocess", clips, "-o", "out", "--jobs", 1, "--scale", 2, "--fps", 30, "--json")
    value = json.loads(said.out)
    used = [f for f in value["files"] if not f["skipped"]]
    assert {f["mapping"]["scale"] for f in used} == {2.0}
    assert value["seconds"] == pytest.approx(4.0, abs=0.1)


def test_a_terminated_process_leaves_nothing_behind(tmp_path: Path) -> None:
    folder = tmp_path / "clips"
    folder.mkdir()
    for i in range(40):
        write_bvh(folder / f"walk_{i}.bvh", make_walk(60))
    command = [sys.executable, "-m", "motionkit", "preprocess", "clips", "-o", "out", "--jobs", "1"]
    running = subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    deadline = time.monotonic() + 50
    while not any(p.name.startswith(".out.") for p in tmp_path.iterdir()) and running.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    running.send_signal(signal.SIGTERM)
    out, err = running.communicate(timeout=50)
    assert running.returncode == 130 and not out
    assert err.strip() == "stopped"
    assert [p.name for p in tmp_path.iterdir()] == ["clips"]


def test_the_layout_of_the_paper_has_references_of_its_own(motionkit, clips: Path, tmp_path: Path) -> None:
    said = motionkit("preprocess", clips, "-o", "out", "--layout", "expmap-root-1", "--references", "own")
    assert said.code == 2 and "--references is for the other layout" in said.err
    assert not (tmp_path / "out").exists()
