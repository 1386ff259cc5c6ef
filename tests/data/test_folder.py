"""Making a dataset never loses the user's files or the old dataset, whenever the process is killed."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from motionkit.data import folder as module
from motionkit.data.dataset import Dataset
from motionkit.data.folder import DATASET_NAMES, MOTIONS, put_in_place, staging_folder
from motionkit.data.options import PreprocessOptions
from motionkit.data.preprocess import preprocess
from motionkit.errors import DatasetError
from motionkit.motion.bvh import write_bvh
from synthetic_motions import make_idle, make_walk

ONE_JOB = PreprocessOptions(jobs=1)
STEPS = ("rename", "unlink", "rmdir", "mkdir")  # what os does to names


@pytest.fixture
def clips(tmp_path: Path) -> Path:
    folder = tmp_path / "clips"
    folder.mkdir()
    write_bvh(folder / "walk.bvh", make_walk(40))
    write_bvh(folder / "idle.bvh", make_idle(40))
    return folder


def fill(folder: Path, text: str) -> None:
    """A stand-in for a dataset: its six files, each with this text."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in DATASET_NAMES:
        (folder / name).write_text(text)
    (folder / "manifest.json").write_text(json.dumps({"motionkit": text}))


def version_of(folder: Path) -> str:
    """The text of the complete stand-in in a folder, or ""."""
    if not all((folder / name).is_file() for name in DATASET_NAMES):
        return ""
    text = json.loads((folder / "manifest.json").read_text())["motionkit"]
    return text if all((folder / n).read_text() == text for n in DATASET_NAMES - {"manifest.json"}) else ""


def replace_dataset(target: Path) -> None:
    with staging_folder(target) as (staging, _):
        (staging / MOTIONS).mkdir()
        (staging / MOTIONS / "0.npz").write_text("x")
        fill(staging, "new")
        (staging / MOTIONS / "0.npz").unlink()
        (staging / MOTIONS).rmdir()
        put_in_place(staging, target)


def killed_at(step: int, work: Callable[[], None]) -> bool:
    """Run work in a child process that is killed before its step-th rename; returns whether it was killed."""
    child = os.fork()
    if child == 0:
        count = 0

        def counted(honest: Callable) -> Callable:
            def change(*args: object, **options: object) -> object:
                nonlocal count
                if count == step:
                    os.kill(os.getpid(), signal.SIGKILL)
                count += 1
                return honest(*args, **options)

            return change

        for name in STEPS:
            setattr(os, name, counted(getattr(os, name)))
        try:
            work()
        finally:
            os._exit(0)
    _, status = os.waitpid(child, 0)
    return os.WIFSIGNALED(status)


def test_killed_at_any_step_one_whole_dataset_is_there(tmp_path: Path) -> None:
    """The old or new dataset and the user's file exist, in place or beside it; the next run cleans up."""
    for step in range(100):
        target = tmp_path / str(step) / "ds"
        fill(target, "old")
        (target / "notes.txt").write_text("years of work")
        killed = killed_at(step, lambda target=target: replace_dataset(target))
        places = [target, *target.parent.glob(".ds.*")]
        whole = [version_of(place) for place in places if version_of(place)]
        assert whole, (step, places)
        assert any((place / "notes.txt").exists() for place in places), step
        if not killed:
            break
        replace_dataset(target)
        assert version_of(target) == "new"
        assert (target / "notes.txt").read_text() == "years of work"
        assert [p.name for p in target.parent.iterdir()] == ["ds"], step
    assert not killed and 15 < step < 99
    assert version_of(target) == "new" and [p.name for p in target.parent.iterdir()] == ["ds"]


def test_between_the_renames_the_former_dataset_is_put_back_and_told(clips: Path, tmp_path: Path) -> None:
    preprocess([clips], tmp_path / "ds", ONE_JOB)
    (tmp_path / "ds").rename(tmp_path / ".ds.old-12345678")
    with pytest.raises(DatasetError, match=r"\.ds\.old-12345678"):
        Dataset(tmp_path / "ds")
    (tmp_path / ".ds.new-12345678").mkdir()
    (tmp_path / ".ds.new-12345678" / "features.npy").write_text("half")
    report = preprocess([clips], tmp_path / "ds", ONE_JOB)
    assert any("restored the old dataset" in note for note in report.notes)
    assert any(".ds.new-12345678: removed; an interrupted run had left it" in note for note in report.notes)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["clips", "ds"]


@pytest.mark.parametrize("fault", [OSError(5, "Input/output error"), KeyboardInterrupt()])
def test_a_rename_that_fails_puts_the_former_dataset_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: BaseException
) -> None:
    fill(tmp_path / "ds", "old")
    honest, calls = os.rename, []

    def rename(source: object, target: object) -> None:
        calls.append(source)
        if len(calls) == 2:
            raise fault
        honest(source, target)

    monkeypatch.setattr(os, "rename", rename)
    with pytest.raises(type(fault)):
        replace_dataset(tmp_path / "ds")
    assert version_of(tmp_path / "ds") == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["ds"]


def test_only_what_preprocess_wrote_is_removed(clips: Path, tmp_path: Path) -> None:
    preprocess([clips], tmp_path / "ds", ONE_JOB)
    (tmp_path / "ds" / "notes.txt").write_text("years of work")
    (tmp_path / "ds" / "runs").mkdir()
    (tmp_path / "ds" / "runs" / "model.safetensors").write_text("days of training")
    preprocess([clips], tmp_path / "ds", ONE_JOB)
    assert Dataset(tmp_path / "ds").clips
    assert (tmp_path / "ds" / "notes.txt").read_text() == "years of work"
    assert (tmp_path / "ds" / "runs" / "model.safetensors").read_text() == "days of training"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["clips", "ds"]


@pytest.mark.parametrize("how", ["folder", "file", "link", "itself"])
def test_a_source_inside_the_dataset_is_refused(clips: Path, tmp_path: Path, how: str) -> None:
    output = tmp_path / "ds"
    preprocess([clips], output, ONE_JOB)
    raw = output / "raw"
    shutil.copytree(clips, raw)
    source = {"folder": raw, "file": raw / "walk.bvh", "link": tmp_path / "link", "itself": output}[how]
    if how == "link":
        source.symlink_to(raw)
    before = sorted(output.rglob("*"))
    with pytest.raises(DatasetError, match=r"is inside the output folder .*ds"):
        preprocess([source], output, ONE_JOB)
    assert sorted(output.rglob("*")) == before


def test_a_link_to_a_dataset_stays_a_link(clips: Path, tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    preprocess([clips], tmp_path / "disk" / "real", ONE_JOB)
    (tmp_path / "ds").symlink_to(tmp_path / "disk" / "real")
    (clips / "idle.bvh").unlink()
    preprocess([clips], tmp_path / "ds", ONE_JOB)
    assert (tmp_path / "ds").is_symlink() and Dataset(tmp_path / "ds").types == ("walk",)
    assert [p.name for p in (tmp_path / "disk").iterdir()] == ["real"]


def test_two_runs_do_not_make_one_dataset_at_once(tmp_path: Path) -> None:
    with staging_folder(tmp_path / "ds") as (staging, _):
        with pytest.raises(DatasetError, match="another run is making this dataset"):
            replace_dataset(tmp_path / "ds")
        assert staging.is_dir(), "the other's folder is no leftover"
    replace_dataset(tmp_path / "ds")
    assert [p.name for p in tmp_path.iterdir()] == ["ds"]


# ---- a full disk ----

IN_A_SMALL_FILE_SYSTEM = """
import sys
from motionkit.cli.main import main
sys.argv = ["motionkit", "preprocess", sys.argv[1], "-o", sys.argv[2], "--jobs", sys.argv[3]]
main()
"""


@pytest.mark.parametrize(
    ("size", "jobs"),
    [
        ("300k", 1),
        pytest.param("300k", 2, marks=pytest.mark.slow),
        pytest.param("60k", 1, marks=pytest.mark.slow),
    ],
)
def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path: Path, size: str, jobs: int) -> None:
    """The features or even the first pass do not fit on the disk; a memory map would die of SIGBUS."""
    small, clips = tmp_path / "small", tmp_path / "clips"
    small.mkdir()
    clips.mkdir()
    write_bvh(clips / "walk.bvh", make_walk(400))
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(small)]
    if shutil.which("mount") is None or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("may not mount a small file system here")
    try:
        done = subprocess.run(
            [sys.executable, "-c", IN_A_SMALL_FILE_SYSTEM, clips, small / "ds", str(jobs)],
            capture_output=True,
            text=True,
            timeout=120,
        )
        left = [p.name for p in small.iterdir()]
    finally:
        subprocess.run(["umount", str(small)], check=True)
    assert done.returncode == 1 and done.stdout == ""
    assert done.stderr == f"error: {small / 'ds'}: cannot be written (No space left on device)\n"
    assert left == []


def test_a_file_that_may_not_grow_is_one_line_and_leaves_nothing(clips: Path, tmp_path: Path) -> None:
    import resource

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, before[1]))
    try:
        with pytest.raises(DatasetError, match=r"ds: cannot be written \(File too large\)"):
            preprocess([clips], tmp_path / "ds", ONE_JOB)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert [p.name for p in tmp_path.iterdir()] == ["clips"]


def test_numbers_that_are_not_finite_make_no_dataset(
    clips: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import motionkit.data.second_pass as passes

    monkeypatch.setattr(passes, "_plain", lambda scaling: {"mean": [float("nan")], "std": [1.0]})
    with pytest.raises(DatasetError, match="not finite"):
        preprocess([clips], tmp_path / "ds", ONE_JOB)
    assert [p.name for p in tmp_path.iterdir()] == ["clips"]


def test_where_the_system_knows_no_locks_work_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fcntl = pytest.importorskip("fcntl")

    def flock(*_: object) -> None:
        raise OSError(37, "No locks available")

    monkeypatch.setattr(fcntl, "flock", flock)
    replace_dataset(tmp_path / "ds")
    assert version_of(tmp_path / "ds") == "new" and module.set_aside(tmp_path / "ds") == []
