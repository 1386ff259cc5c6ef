"""Runs side by side: Ctrl-C, a process that was killed or failed, and what is told."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

pytestmark = pytest.mark.thorough

needs_proc = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc here")
NAMES = ("MVAE", "PFNN", "HTSS", "LearnedMM")


@contextmanager
def running(folder: Path, data: Path, *words: str) -> Iterator[subprocess.Popen]:
    """The command in a process group of its own, as in a terminal; nothing of it is left afterwards."""
    command = [
        sys.executable, "-m", "motionkit", "experiment", "run", *NAMES, "--set", "all", "--data", str(data),
        "--device", "cpu", "--results", "results", *words,
    ]  # fmt: skip
    process = subprocess.Popen(
        command, cwd=folder, stderr=subprocess.PIPE, text=True, start_new_session=True,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    try:
        yield process
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def logs(folder: Path) -> list[Path]:
    return sorted(folder.glob("checkpoints/*/*/*.run/log.jsonl"))


def until(true: Callable[[], bool], process: subprocess.Popen, seconds: float = 300.0) -> None:
    deadline = time.monotonic() + seconds
    while not true():
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.05)


def workers(group: int) -> list[int]:
    """The processes of a group that do runs and are no zombies; multiprocessing's own tracker ends a little later."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            facts = path.read_text().rsplit(")", 1)[1].split()
            spawned = b"spawn_main" in path.with_name("cmdline").read_bytes()
            if spawned and facts[0] != "Z" and int(facts[2]) == group:
                found.append(int(path.parent.name))
    return found


def trained_for_a_while(folder: Path, count: int) -> Callable[[], bool]:
    return lambda: sum('"log"' in log.read_text() for log in logs(folder)) >= count


@needs_proc
@pytest.mark.parametrize("everyone", [True, False])
def test_ctrl_c_stops_runs_side_by_side_after_their_step(
    everyone: bool, paper_folder: Path, tmp_path: Path
) -> None:
    """The key reaches all processes, `kill` the first one alone."""
    with running(tmp_path, paper_folder, "--jobs", "2", "--steps", "100000") as process:
        until(trained_for_a_while(tmp_path, 2), process)
        (os.killpg if everyone else os.kill)(process.pid, signal.SIGINT)
        began = time.monotonic()
        _, said = process.communicate(timeout=300)
        assert process.returncode == 130 and time.monotonic() - began < 30
        assert not workers(process.pid)
    assert said.splitlines() == [
        "4 runs, 0 of them done", "PFNN, seed 0", "MVAE, seed 0", "stopped; the same command continues",
    ]  # fmt: skip
    # Both have written where they are, and the others have not begun.
    assert [log.parent.name for log in logs(tmp_path)] == ["mvae-0.run", "pfnn-0.run"]
    assert all((log.parent / "checkpoint.safetensors").exists() for log in logs(tmp_path))


def test_ctrl_c_says_one_thing_where_runs_follow_each_other(paper_folder: Path, tmp_path: Path) -> None:
    with running(tmp_path, paper_folder, "--steps", "100000") as process:
        until(trained_for_a_while(tmp_path, 1), process)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=300)
    assert process.returncode == 130 and said.splitlines()[-1] == "stopped; the same command continues"
    assert "--resume" not in said and said.count("stopped") == 1


@needs_proc
def test_a_killed_process_is_one_line(paper_folder: Path, tmp_path: Path) -> None:
    with running(tmp_path, paper_folder, "--jobs", "2", "--steps", "100000") as process:
        until(trained_for_a_while(tmp_path, 2), process)
        assert len(workers(process.pid)) == 2
        os.kill(workers(process.pid)[0], signal.SIGKILL)
        _, said = process.communicate(timeout=300)
        assert process.returncode == 1 and not workers(process.pid)
    (line,) = [line for line in said.splitlines() if line.startswith("error: ")]
    assert "its process ended before its result (exit code -9)" in line and "fewer --jobs" in line
    assert "Traceback" not in said
    (lasting,) = [log.parent for log in logs(tmp_path) if (log.parent / "checkpoint.safetensors").exists()]
    assert lasting.name in ("mvae-0.run", "pfnn-0.run"), "the other one stopped after its step"


def test_a_fault_in_one_run_is_one_line(dataset_folder: Path, tmp_path: Path) -> None:
    with running(tmp_path, dataset_folder, "--jobs", "2", "--steps", "100000") as process:
        _, said = process.communicate(timeout=300)
    assert process.returncode == 1 and "Traceback" not in said
    assert "run preprocess with --layout expmap-root-1" in said.splitlines()[-1]
    assert not list(tmp_path.glob("results/**/*.json"))


@needs_proc
def test_runs_end_with_a_parent_that_is_killed(paper_folder: Path, tmp_path: Path) -> None:
    with running(tmp_path, paper_folder, "--jobs", "2", "--steps", "100000") as process:
        until(trained_for_a_while(tmp_path, 2), process)
        process.kill()
        process.wait()
        deadline = time.monotonic() + 30
        while workers(process.pid) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert not workers(process.pid)
