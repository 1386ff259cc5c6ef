"""Every script in benchmarks runs: with the least that it can be asked for."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
# What a script is asked for, run by run. PAPER, FREE and OUT are datasets and a new folder.
LEAST: dict[str, list[str]] = {
    "bvh_reading": ["--frames 60 --repeats 1"],
    "clips": ["examples/data/16_05.bvh --pairs 2"],
    "corrections": ["--count 1"],
    "demo": ["--characters 1 --pictures 2"],
    "films": ["--figures 1 --width 64"],
    "gpu_job": [
        "pack PAPER FREE -o OUT",
        "times OUT --device cpu --seeds 1 --steps 2 --names TPTN --batch 1",
    ],
    "in_between": [""],
    "live": ["--characters 1 --frames 2 --presses 2 --repeats 1"],
    "metric_response": [""],
    "pages": ["--figures 1 --pictures 2"],
    "preprocessing": ["--copies 1 --jobs 1"],
    "rigs": ["examples/data --most 2"],
    "training_step": ["--batch 1 --window 20 --repeats 1"],
    "synthesis": ["--characters 1 --steps 2"],
    "verdicts": ["FREE"],
}
BROWSER = {"demo", "pages"}


def test_no_script_is_left_out() -> None:
    assert {path.stem for path in (ROOT / "benchmarks").glob("*.py")} == {*LEAST, "common"}


@pytest.mark.thorough
@pytest.mark.parametrize("name", LEAST)
def test_it_runs(name: str, tmp_path: Path, paper_folder: Path, dataset_folder: Path) -> None:
    browsers = ("chromium", "chromium-browser", "google-chrome")
    if name in BROWSER and not any(map(shutil.which, browsers)):
        assert os.environ.get("MOTIONKIT_BROWSER_TESTS") != "required"
        pytest.skip("no Chromium is installed")
    if name == "films":
        pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed")
    places = {"PAPER": str(paper_folder), "FREE": str(dataset_folder), "OUT": str(tmp_path / "out")}
    for words in LEAST[name]:
        command = [
            sys.executable,
            f"benchmarks/{name}.py",
            *(places.get(word, word) for word in words.split()),
        ]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr[-2000:]
        assert "Traceback" not in done.stderr
    assert done.stdout.strip()
