"""Ctrl-C and SIGTERM: one line at once, no half-written file, no process left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from motionkit.cli.main import main
from motionkit.motion.bvh import write_bvh
from synthetic_motions import make_walk

from .test_mirror import RIG
from .test_terminal import CONTROL_SEQUENCE, fcntl, open_terminal, termios

WORKERS = """
import os, sys, time
from pathlib import Path
from motionkit.data.workers import worker_processes

def hang(number):
    Path(f"{number}.pid").write_text(str(os.getpid()))
    Path(f"{number}.pid").rename(f"{number}.ready")
    time.sleep(100)

if __name__ == "__main__":
    with worker_processes(2) as each:
        list(each(hang, list(range(8))))
"""


@pytest.mark.parametrize(
    ("words", "interrupted"),
    [
        (["preprocess", "clips", "-o", "ds", "--jobs", 1], "data.first_pass.prepare_file"),
        (["train", "DATASET", "-o", "m2.safetensors", "--preset", "tiny"], "training.trainer.WindowSampler"),
        (["synthesize", "--types", "idle:0.1", "--model", "MODEL"], "control.synthesize.run"),
        (["synthesize", "--types", "idle:0.1", "--model", "MODEL"], "motion.bvh._hierarchy_lines"),
        (["follow-path", "line", "--size", "0.2", "--model", "MODEL"], "control.follow.unfinished"),
        (["metrics", "a.bvh"], "metrics.report.canonical_with_notes"),
        (["evaluate", "MODEL", "DATASET", "-o", "x.md"], "lab.scoreboard.board.RealMotion"),
        (["mirror", "a.bvh", "out.bvh"], "rig.mirror.mirror_bvh"),
        (["view", "a.bvh", "-o", "a.gif"], "view.film.Scenery"),
        (["convert", "a.bvh", "out.glb"], "export.glb.make_figure"),
        (["trim", "a.bvh", "-o", "out.bvh"], "motion.bvh._check_numbers"),
        (["join", "a.bvh", "a.bvh", "-o", "out.bvh"], "editing.join.join_motions"),
        (["fix", "a.bvh", "-o", "out.bvh"], "editing.fix.fix_motion"),
        (["loop", "a.bvh", "-o", "out.bvh"], "editing.loop.make_loop"),
        (["retarget", "a.bvh", "-o", "out.bvh"], "rig.on_rig.canonical_for"),
        (["export", "--onnx", "x.onnx", "--model", "MODEL"], "export.onnx_export.build_graph"),
    ],
)
def test_ctrl_c_in_every_command(
    words: list, interrupted: str, tmp_path: Path, tiny_model_file: Path, dataset_folder: Path,
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """The signal arrives in the middle of the work, and again during the clean-up."""
    (tmp_path / "clips").mkdir()
    for name in ("a.bvh", "clips/a.bvh"):
        (tmp_path / name).write_text(RIG)
    monkeypatch.chdir(tmp_path)

    def twice(*_: object, **__: object) -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(f"motionkit.{interrupted}", twice)
    places = {"MODEL": tiny_model_file, "DATASET": dataset_folder}
    monkeypatch.setattr(sys, "argv", ["motionkit", *(str(places.get(word, word)) for word in words)])
    with pytest.raises(SystemExit) as stop:
        main()
    out, err = capfd.readouterr()
    assert (stop.value.code, out, err) == (130, "", "stopped\n")
    assert sorted(str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*")) == [
        "a.bvh",
        "clips",
        "clips/a.bvh",
    ]


def test_the_key_itself(tmp_path: Path, tiny_model_file: Path) -> None:
    ours, theirs = open_terminal(80)
    running = subprocess.Popen(
        [sys.executable, "-m", "motionkit", "synthesize", "--types", "idle", "--seconds", "3600",
         "--model", str(tiny_model_file)],
        cwd=tmp_path, stdin=theirs, stdout=theirs, stderr=theirs, env=os.environ | {"TERM": "xterm"},
        start_new_session=True, preexec_fn=lambda: fcntl.ioctl(theirs, termios.TIOCSCTTY, 0),
    )  # fmt: skip
    os.close(theirs)
    said = b""
    try:
        while b"synthesizing" not in said:
            said += os.read(ours, 65536)
        os.write(ours, b"\x03")
        # Before waiting: a terminal may lose what nobody has read when its last process ends.
        while not said.endswith(b"stopped\r\n"):
            said += os.read(ours, 65536)
        assert running.wait(timeout=30) == 130
    finally:
        running.kill()
        running.wait()
        os.close(ours)
    words = CONTROL_SEQUENCE.sub("", said.decode())
    assert words.startswith("making 1.0 hours of motion, which can take minutes; Ctrl-C stops")
    assert words.count("stopped") == 1 and "Traceback" not in words
    assert not list(tmp_path.iterdir())


def alive(number: int) -> bool:
    """Whether a process runs; a zombie does not."""
    try:
        return Path(f"/proc/{number}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc here")
@pytest.mark.parametrize("name", ["SIGINT", "SIGKILL"])
def test_workers_end_with_their_parent(name: str, tmp_path: Path) -> None:
    (tmp_path / "work.py").write_text(WORKERS)
    running = subprocess.Popen(
        [sys.executable, "work.py"], cwd=tmp_path, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        while len(ready := list(tmp_path.glob("*.ready"))) < 2:
            assert running.poll() is None
            time.sleep(0.05)
        workers = [int(path.read_text()) for path in ready]
        if name == "SIGINT":
            os.killpg(running.pid, signal.SIGINT)  # as the key does
        else:
            running.kill()
        _, err = running.communicate(timeout=30)
        deadline = time.monotonic() + 30
        while any(map(alive, workers)) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert not any(map(alive, workers))
    finally:
        for number in (running.pid, *(int(path.read_text()) for path in tmp_path.glob("*.ready"))):
            if alive(number):
                os.kill(number, signal.SIGKILL)
    assert err.count("Traceback") == (1 if name == "SIGINT" else 0), "the parent's own, of this script"


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="no process groups here")
def test_ctrl_c_in_a_folder_leaves_no_file_that_a_process_was_writing(tmp_path: Path) -> None:
    for name in "abcd":
        write_bvh(tmp_path / "clips" / f"{name}.bvh", make_walk(1500))
    running = subprocess.Popen(
        [sys.executable, "-m", "motionkit", "convert", "clips", "out", "--format", "csv", "--jobs", "2"],
        cwd=tmp_path, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    try:
        while not list(tmp_path.glob("out/.*")):
            assert running.poll() is None
            time.sleep(0.01)
        os.killpg(running.pid, signal.SIGINT)
        _, err = running.communicate(timeout=60)
    finally:
        running.kill()
    assert (running.returncode, err) == (130, "stopped\n")
    assert not list(tmp_path.glob("out/.*"))
