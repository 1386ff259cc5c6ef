"""Every script in benchmarks runs: with the least that it can be asked for."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LEAST = {
    "bvh_reading": ("--frames", "60", "--repeats", "1"),
    "corrections": ("--count", "1"),
    "in_between": (),
    "live": ("--characters", "1", "--frames", "2"),
    "metric_response": (),
    "preprocessing": ("--copies", "1", "--jobs", "1"),
    "rigs": ("examples/data", "--most", "2"),
    "training_step": ("--batch", "1", "--window", "20", "--repeats", "1"),
    "synthesis": ("--characters", "1", "--steps", "2"),
}
# They need a browser or a video encoder (films, demo, pages), or datasets (gpu_job, verdicts).
ELSEWHERE = {"common", "demo", "films", "gpu_job", "pages", "verdicts"}


def test_no_script_is_left_out() -> None:
    assert {path.stem for path in (ROOT / "benchmarks").glob("*.py")} == LEAST.keys() | ELSEWHERE


@pytest.mark.slow
@pytest.mark.parametrize("name", LEAST)
def test_it_runs(name: str) -> None:
    command = [sys.executable, f"benchmarks/{name}.py", *LEAST[name]]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.strip() and "Traceback" not in done.stderr
