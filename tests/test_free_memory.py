"""Motion that does not fit into memory is refused before the work."""

from __future__ import annotations

import resource
import subprocess
import sys
import tracemalloc
from pathlib import Path

import pytest

import motionkit as mk
from motionkit import free_memory
from motionkit.editing.join import join_motions
from motionkit.editing.root_motion import with_ground_root
from motionkit.errors import MotionkitError
from motionkit.export.formats import read_motion, write_motion
from motionkit.finish.on_rig import on_rig
from motionkit.metrics.report import evaluate_motion
from motionkit.motion.bvh import read_bvh, write_bvh
from motionkit.motion.motion import resample
from motionkit.rig.built_in import rig_file
from motionkit.rig.on_rig import read_rig
from synthetic_motions import make_walk

GB = 10**9


def test_what_would_fit_is_said_and_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(free_memory, "free_memory", lambda: GB)
    with pytest.raises(
        MotionkitError, match=r"432,000 frames of 50 joints take about 8.6 GB .* at most 416 s at 120"
    ):
        free_memory.check_memory(432_000, 50, 120.0)
    free_memory.check_memory(416 * 120, 50, 120.0)


def test_a_file_that_cannot_even_be_read_is_refused_unread(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_bvh(tmp_path / "a.bvh", make_walk(600))
    size = (tmp_path / "a.bvh").stat().st_size
    monkeypatch.setattr(free_memory, "free_memory", lambda: 3 * size)
    monkeypatch.setattr("motionkit.motion.bvh_text.read_bytes", None)
    with pytest.raises(
        MotionkitError, match=r"a.bvh: 0 MB of text take about .* are free; expected at most 0 MB"
    ):
        read_bvh(tmp_path / "a.bvh")


@pytest.mark.parametrize("name", ["a.bvh", "a.glb", "a.npz"])
def test_a_file_says_its_frames_and_joints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    write_motion(tmp_path / name, make_walk(600))
    monkeypatch.setattr(free_memory, "free_memory", lambda: 5 * 10**6)
    said = rf"{name}.*: 600 frames of 23 joints take about .* at most 9 s at 60 fps"
    with pytest.raises(MotionkitError, match=said):
        read_motion(tmp_path / name)


@pytest.mark.parametrize(("work", "said"), [
    (lambda: resample(make_walk(60), 480.0), "473 frames of 23 joints"),
    (lambda: mk.synthesize("walking:3000"), "180,000 frames of 23 joints"),
    (lambda: join_motions([make_walk(600), with_ground_root(make_walk(600))]), "1,200 frames of 24 joints"),
    (lambda: evaluate_motion(make_walk(600), make_walk(600)), "1,200 frames of 23 joints"),
    (lambda: on_rig(make_walk(600), read_rig(rig_file("@mixamo"))), "600 frames of 52 joints"),
])  # fmt: skip
def test_it_is_asked_before_the_work(monkeypatch: pytest.MonkeyPatch, work, said: str) -> None:
    monkeypatch.setattr(free_memory, "free_memory", lambda: 10**6)
    with pytest.raises(MotionkitError, match=f"{said} take about .* are free; expected at most"):
        work()


@pytest.mark.parametrize(("work", "told"), [
    (lambda walk: join_motions([walk, walk], at=[(49.0, 1.0)]), free_memory.BYTES_OF_JOINT),
    (lambda walk: join_motions([walk.cut(0, 100)] * 30, at=[(1.6, 0.05)] * 29), free_memory.BYTES_OF_JOINT // 2),
    (lambda walk: evaluate_motion(walk, walk), free_memory.BYTES_BESIDE),
    (lambda walk: on_rig(walk, read_rig(rig_file("@mixamo"))), free_memory.BYTES_OF_JOINT * 52 / 46),
    (lambda walk: on_rig(walk, read_rig(rig_file("@lafan1"))), free_memory.BYTES_OF_JOINT / 2),
])  # fmt: skip
def test_no_more_is_taken_than_is_told(work, told: float) -> None:
    walk = make_walk(3000)
    tracemalloc.start()
    try:
        work(walk)
        assert tracemalloc.get_traced_memory()[1] < told * 2 * 3000 * len(walk.skeleton)
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("limit", "low", "high"), [(2 * GB, 0.5 * GB, 2 * GB), (None, 0.1 * GB, sys.maxsize)]
)
def test_the_limit_of_the_process_counts(limit: int | None, low: float, high: float) -> None:
    def limited() -> None:
        if limit:
            resource.setrlimit(resource.RLIMIT_AS, (limit, limit))

    code = "from motionkit.free_memory import free_memory; print(free_memory())"
    done = subprocess.run(
        [sys.executable, "-c", code], preexec_fn=limited, capture_output=True, text=True, check=True
    )
    assert low <= int(done.stdout) <= high
