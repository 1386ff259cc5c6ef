"""The numbered scripts in examples/ run, as a user would run them, in a folder of their own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from motionkit.models.bundled import BUNDLED_MODEL
from motionkit.motion.bvh import read_bvh

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
DATA = EXAMPLES / "data"

needs_model = pytest.mark.skipif(not BUNDLED_MODEL.is_file(), reason="the bundled model is not there")
needs_data = pytest.mark.skipif(not (DATA / "labels.csv").is_file(), reason="examples/data is not there")


def run_example(name: str, folder: Path, *arguments: str | Path) -> str:
    """What a script prints; fails with its errors if it does not end well."""
    command = [sys.executable, str(EXAMPLES / name), *map(str, arguments)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def some_samples(folder: Path, *names: str) -> Path:
    """A folder with a few of the sample clips and all labels."""
    folder.mkdir()
    for name in (*names, "labels.csv"):
        shutil.copy(DATA / name, folder / name)
    return folder


def test_every_script_is_numbered_and_tested() -> None:
    scripts = sorted(path.name for path in EXAMPLES.glob("*.py"))
    assert [name[:3] for name in scripts] == [f"{i:02d}_" for i in range(1, len(scripts) + 1)]
    tested = Path(__file__).read_text("utf-8")
    assert all(name in tested for name in scripts)


@needs_data
def test_read_and_inspect(tmp_path: Path) -> None:
    out = run_example("01_read_and_inspect_bvh.py", tmp_path, DATA / "35_01.bvh")
    assert "31 joints, 96 channels" in out and "CMU units" in out


def test_a_missing_file_is_told_in_a_line(tmp_path: Path) -> None:
    script = EXAMPLES / "01_read_and_inspect_bvh.py"
    done = subprocess.run([sys.executable, script, tmp_path / "none.bvh"], capture_output=True, text=True)
    assert done.returncode == 1 and "Traceback" not in done.stderr and "none.bvh" in done.stderr


@needs_data
def test_features_round_trip(tmp_path: Path) -> None:
    out = run_example("02_features_round_trip.py", tmp_path, DATA / "49_06.bvh")
    assert "sixd-root-1: joints within 0.000" in out and "left toe on the floor" in out


@needs_model
def test_synthesize(tmp_path: Path) -> None:
    run_example("03_synthesize.py", tmp_path, "--types", "running:0.5,cartwheel:0.5", "-o", "made.bvh")
    assert len(read_bvh(tmp_path / "made.bvh").values) == 60


@needs_model
def test_follow_path(tmp_path: Path) -> None:
    sizes = ("--turns", "0.3", "--radius", "1.5", "--run", "1")
    out = run_example("04_follow_path.py", tmp_path, *sizes, "-o", "followed.bvh")
    assert "from the path on average" in out
    assert len(read_bvh(tmp_path / "followed.bvh").values) > 30


@needs_data
def test_train_tiny(tmp_path: Path) -> None:
    folder = some_samples(tmp_path / "clips", "35_01.bvh", "127_07.bvh")
    run_example("05_train_tiny.py", tmp_path, folder, "--steps", "2", "-o", "tiny.safetensors")
    assert (tmp_path / "tiny.safetensors").is_file()
    assert len(read_bvh(tmp_path / "tiny.bvh").values) == 120
