"""Outputs of commands: never over an input, into new folders, to standard output."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.cli.common import lines_of_files
from motionkit.errors import OverwriteError
from motionkit.export.formats import write_motion
from motionkit.files import atomic_write, check_outputs, files_below
from motionkit.motion.bvh import read_bvh, write_bvh
from synthetic_motions import make_walk

from .test_mirror import RIG

QUICK = ("--preset", "tiny", "--batch", 2, "--window", 16, "--splices", 0, "--device", "cpu")


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def home(tmp_path: Path, tiny_model_file: Path, dataset_folder: Path) -> Path:
    """A user's folder: clips, a link to one, a model, a path, a dataset."""
    (tmp_path / "d" / "sub").mkdir(parents=True)
    (tmp_path / "d" / "a.bvh").write_text(RIG)
    (tmp_path / "d" / "sub" / "sub").mkdir()
    (tmp_path / "d" / "sub" / "a.bvh").write_text(RIG.replace("0.05", "0.1"))
    (tmp_path / "a.bvh").write_text(RIG)
    (tmp_path / "link.bvh").symlink_to("a.bvh")
    (tmp_path / "m.safetensors").write_bytes(tiny_model_file.read_bytes())
    (tmp_path / "way.csv").write_text("x,z,type\n0,0,walking\n0,2,walking\n")
    (tmp_path / "x.json").write_text("{}")
    (tmp_path / "ds").symlink_to(dataset_folder)
    return tmp_path


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["mirror", "a.bvh", "a.bvh"], "a.bvh: is read by this command"),
        (["mirror", "a.bvh", "./d/../a.bvh"], "d/../a.bvh: is read by this command"),
        (["mirror", "a.bvh", "link.bvh"], "link.bvh: is read by this command"),
        (["mirror", "d", "d"], "d: is inside the input folder d"),
        (["mirror", "d", "d/new"], "d/new: is inside the input folder d"),
        (["mirror", "d/sub", "d"], "d/a.bvh: is read by this command"),
        (["synthesize", "--types", "idle:0.1", "--init", "a.bvh", "-o", "link.bvh"], "link.bvh: is read"),
        (["convert", "a.bvh", "link.bvh"], "link.bvh: is read"),
        (["loop", "a.bvh", "-o", "d/../a.bvh"], "d/../a.bvh: is read"),
        (["synthesize", "--types", "idle:0.1", "--init", "a.bvh", "-o", "a.bvh"], "a.bvh: is read"),
        (["follow-path", "way.csv", "-o", "way.csv"], "way.csv: is read"),
        (["export", "--onnx", "m.json"], "m.json: the metadata are written to this file"),
        (["export", "--model", "m.safetensors", "--onnx", "m.safetensors"], "m.safetensors: is read"),
        (["train", "ds", "-o", "m.safetensors", *QUICK, "--steps", 1], "m.safetensors: exists"),
        (
            ["train", "ds", "-o", "m.safetensors", "--init", "m.safetensors", "--force", *QUICK],
            "m.safetensors: is",
        ),
        (["evaluate", "m.safetensors", "ds", "-o", "ds/manifest.json"], "ds/manifest.json: is read"),
        (["evaluate", "m.safetensors", "ds", "-o", "r.md", "-o", "./r.md"], "r.md: would be written twice"),
    ],
)
def test_nothing_that_is_read_is_written(motionkit, home: Path, words: list, complaint: str) -> None:
    """link.bvh points to a.bvh; files in d/sub/sub would be mirrored onto d/sub."""
    if words == ["mirror", "d/sub", "d"]:
        (home / "d" / "sub" / "sub" / "a.bvh").write_text(RIG)
        complaint = "d/sub/a.bvh: is read by this command"
    before = contents(home)
    said = motionkit(*words)
    assert said.code == 2 and said.err.startswith(f"error: {complaint}") and said.err.count("\n") == 1
    assert contents(home) == before


@pytest.mark.usefixtures("unscored")
def test_a_run_that_is_there_is_not_begun_anew_unasked(motionkit, home: Path) -> None:
    words = ("train", "ds", "-o", "new.safetensors", *QUICK, "--steps", 1)
    assert motionkit(*words).code == 0
    (home / "new.safetensors").unlink()
    before = contents(home)
    said = motionkit(*words)
    assert said.code == 2 and "new.run/checkpoint.safetensors: exists; continue with --resume" in said.err
    assert contents(home) == before
    assert motionkit(*words, "--force").code == 0 and (home / "new.safetensors").is_file()


def test_the_check_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("x")
    os.link(tmp_path / "a", tmp_path / "b")
    check_outputs([tmp_path / "c", tmp_path / "new" / "c"], [tmp_path / "a", None, tmp_path / "nothing"])
    with pytest.raises(OverwriteError, match="is read"):
        check_outputs([tmp_path / "b"], [tmp_path / "a"])
    with pytest.raises(OverwriteError, match="twice"):
        check_outputs([tmp_path / "new", tmp_path / "x" / ".." / "new"], [])
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    "words",
    [
        ["synthesize", "--types", "idle:0.1", "-o", "new/deep/x.bvh", "--model", "m.safetensors"],
        ["follow-path", "line", "--size", 0.2, "-o", "new/deep/x.bvh", "--model", "m.safetensors"],
        ["mirror", "a.bvh", "new/deep/x.bvh"],
        ["view", "a.bvh", "-o", "new/deep/x.bvh.html", "--no-open"],
        ["view", "a.bvh", "-o", "new/deep/x.bvh.png", "--width", 600],
    ],
)
def test_folders_are_made(motionkit, home: Path, words: list) -> None:
    assert motionkit(*words).code == 0
    assert [path.name.split(".")[0] for path in (home / "new" / "deep").iterdir()] == ["x"]


def test_a_file_in_the_place_of_a_folder(tmp_path: Path, motionkit) -> None:
    (tmp_path / "a.bvh").write_text(RIG)
    assert motionkit("mirror", "a.bvh", "a.bvh/x.bvh").failed_with(
        "a.bvh/x.bvh: cannot be written", "is not a folder"
    )


@pytest.mark.parametrize(
    "words", [["synthesize", "--types", "idle:0.1"], ["follow-path", "line", "--size", "0.2"]]
)
def test_motion_on_standard_output(words: list[str], tmp_path: Path, tiny_model_file: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "motionkit", *words, "--model", tiny_model_file, "-o", "-"],
        cwd=tmp_path, capture_output=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 0 and done.stderr.startswith(b"wrote standard output: ")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "x.bvh").write_bytes(done.stdout)
    assert len(read_bvh(tmp_path / "x.bvh").values) >= 6


@pytest.mark.parametrize(
    ("words", "told"), [(["--view"], "--view"), (["--json"], "--json"), (["--count", "2"], "2 motions")]
)
def test_what_does_not_go_with_standard_output(
    motionkit, tmp_path: Path, words: list[str], told: str
) -> None:
    said = motionkit("synthesize", "--types", "idle:0.1", "-o", "-", *words)
    assert (
        said.code == 2
        and f"{told} cannot be combined" in said.err
        and not said.out
        and not list(tmp_path.iterdir())
    )


def linked_clips(folder: Path) -> Path:
    """Clips, one folder behind two links, and links that are circular or broken."""
    (folder / "outside" / "running").mkdir(parents=True)
    clips = folder / "clips"
    (clips / "walking").mkdir(parents=True)
    (clips / "walking" / "a.bvh").write_text(RIG)
    (folder / "outside" / "running" / "b.BVH").write_text(RIG)
    (clips / "again").symlink_to("walking")
    (clips / "more").symlink_to(folder / "outside")
    (clips / "twice").symlink_to(folder / "outside")
    (clips / "walking" / "up").symlink_to("..")
    (folder / "outside" / "back").symlink_to(clips)
    (clips / "nowhere").symlink_to("gone")
    return clips


def test_links_to_folders_are_followed_once(tmp_path: Path, motionkit) -> None:
    clips = linked_clips(tmp_path)
    assert files_below(clips, ".bvh") == [clips / "more" / "running" / "b.BVH", clips / "walking" / "a.bvh"]
    said = motionkit("mirror", clips, "out", "--json")
    assert json.loads(said.out)["written"] == 2 and said.code == 0
    assert sorted(contents(tmp_path / "out")) == ["more/running/b.bvh", "walking/a.bvh"]


def test_linked_folders_of_a_dataset(tmp_path: Path, clips_folder: Path, motionkit) -> None:
    (tmp_path / "clips").mkdir()
    (tmp_path / "real").mkdir()
    (tmp_path / "real" / "1.bvh").write_bytes((clips_folder / "walk_02.bvh").read_bytes())
    (tmp_path / "clips" / "strolling").symlink_to("../real")
    (tmp_path / "real" / "loop").symlink_to("../clips")
    said = motionkit("preprocess", "clips", "-o", "ds", "--jobs", 1, "--json")
    value = json.loads(said.out)
    assert said.code == 0 and list(value["types"]) == ["strolling"] and len(value["files"]) == 1


def test_a_fault_while_writing_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), atomic_write(tmp_path / "x" / "y"):
        raise ZeroDivisionError
    assert not contents(tmp_path)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (
            ["synthesize", "--types", "idle", "--seconds", 3600, "--count", 4096],
            "884,736,000 frames, expected at most",
        ),
        (
            ["synthesize", "--types", "idle:3600,walking:3600", "--fps", 480],
            "at 480 fps are 3,456,000 frames",
        ),
        (["synthesize", "--types", ",".join(["idle:3600"] * 5)], "18000 s of motion for each of 1 at 60 fps"),
        (["follow-path", "far.json"], "50000 s of motion for each of 1 at 60 fps are"),
    ],
)
def test_more_than_memory_holds_is_refused_before_it_is_asked_for(
    motionkit, home: Path, words: list, complaint: str
) -> None:
    part = {"type": "cartwheel", "speed": 0.05, "points": [[0, -4999.99], [0, 5000]]}
    (home / "far.json").write_text(json.dumps({"parts": [part]}))
    before = contents(home)
    refused = motionkit(*words, "--model", "m.safetensors")
    notes = refused.err.splitlines()[:-1]
    assert replace(refused, err=refused.err.splitlines()[-1]).failed_with(complaint)
    assert all("paths are in metres" in note for note in notes)
    assert contents(home) == before


def test_a_speed_that_no_recording_has_is_said_or_refused(motionkit, home: Path) -> None:
    words = ["follow-path", "line", "--size", 1, "--speed", 0.3, "--model", "m.safetensors"]
    said = motionkit(*words, "-o", "walk.bvh")
    assert said.code == 0 and said.err.startswith("part 1: walking goes at 0.75 m/s instead of 0.3: 0.75 to ")
    refused = motionkit(*words, "--strict", "-o", "other.bvh")
    assert refused.failed_with("part 1: expected a speed at which walking looks right, 0.75 to ")
    assert (home / "walk.bvh").exists() and not (home / "other.bvh").exists()


def test_long_work_says_so_before_it_begins(motionkit, home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    part = {"type": "walking", "speed": 1.0, "points": [[0, 0], [0, 5000]]}
    (home / "far.json").write_text(json.dumps({"parts": [part]}))

    def refuse(*_: object) -> None:
        raise OverwriteError("the work")

    monkeypatch.setattr("motionkit.control.follow.follow_path", refuse)
    said = motionkit("follow-path", "far.json", "--model", "m.safetensors")
    assert said.err.splitlines() == [
        "the path is 5000 m long; paths are in metres: divide by 100 if yours is in centimetres",
        "making 1.4 hours of motion, which can take minutes; Ctrl-C stops", "error: the work",
    ]  # fmt: skip
    assert motionkit("follow-path", "line", "--model", "m.safetensors").err == "error: the work\n"


@pytest.mark.parametrize(
    ("files", "lines"),
    [
        (3, 3),  # few are named
        (3000, 1),  # many of which the same is said are one line
    ],
)
def test_lines_of_files_stay_few(files: int, lines: int) -> None:
    said = [(f"in/{number}.bvh", f"in/{number}.bvh:1: is empty") for number in range(files)]
    odd = [(f"in/odd{number}.bvh", "is a folder") for number in range(3)]
    found = lines_of_files([*said, *odd])
    assert len(found) == lines + 3 and found[-1] == "in/odd2.bvh: is a folder"
    assert found[0] == ("in/0.bvh:1: is empty" if lines > 1 else "3000 files, such as in/0.bvh:1: is empty")
    each = [(f"{number}.bvh", f"{number} values were cut") for number in range(3000)]
    assert lines_of_files(each)[-1] == "... and 2980 more files; --json lists all"


def test_files_of_one_name_with_other_endings_keep_them(motionkit, home: Path) -> None:
    (home / "in").mkdir()
    for name in ("a.b.bvh", "a.b.npz", "c.bvh"):
        write_motion(home / "in" / name, make_walk(frames=12))
    assert motionkit("convert", "in", "out", "--format", "bvh").code == 0
    assert sorted(path.name for path in (home / "out").iterdir()) == ["a.b-bvh.bvh", "a.b-npz.bvh", "c.bvh"]


def test_a_body_far_away_is_told_that_its_places_are_rounded(motionkit, home: Path) -> None:
    walk = make_walk(frames=12)
    write_motion(home / "far.bvh", replace(walk, root_positions=walk.root_positions + np.float32(4e6)))
    said = motionkit("convert", "far.bvh", "near.npz")
    assert "places rounded to 0.25, because it is 4,000," in said.err


def test_a_folder_tells_what_each_clip_tells(motionkit, tmp_path: Path) -> None:
    (tmp_path / "d").mkdir()
    for turn in (0.0, 0.3):
        write_bvh(tmp_path / "d" / f"walk-{turn}.bvh", make_walk(300, turn=turn))
    alone = json.loads(motionkit("loop", "d/walk-0.0.bvh", "--seconds", 1.5, "--json").out)
    for again in (False, True):
        said = motionkit("loop", "d", "-o", "out", "--seconds", 1.5, "--json")
        told = json.loads(said.out)
        assert told["written"] == 2 and [each["output"] for each in told["clips"]] == [
            "out/walk-0.0.bvh",
            "out/walk-0.3.bvh",
        ]
        assert told["clips"][0] | {"output": ""} == alone | {"output": ""}
        assert ("replaced" in said.err) == again == any("replaced" in note for note in told["notes"])
