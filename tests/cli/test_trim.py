from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from motionkit.export.formats import read_motion, write_motion
from motionkit.motion.motion import Motion
from synthetic_motions import make_walk


@pytest.fixture
def walk(tmp_path: Path) -> Motion:
    write_motion(tmp_path / "walk.bvh", make_walk(120))
    return read_motion(tmp_path / "walk.bvh")


@pytest.mark.parametrize(
    ("words", "first", "frames", "fps"),
    [
        (("--from", 0.5, "--to", "90f"), 30, 60, 60),
        (("--from", "20f"), 20, 100, 60),
        (("--fps", 30), 0, 60, 30),
        (("--speed", 2), 0, 60, 60),
        (("--to", 99), 0, 120, 60),
    ],
)
def test_a_stretch_is_kept(
    motionkit, walk: Motion, tmp_path: Path, words: tuple[object, ...], first: int, frames: int, fps: float
) -> None:
    assert motionkit("trim", "walk.bvh", "-o", "a.bvh", *words).code == 0
    made = read_motion(tmp_path / "a.bvh")
    assert len(made) == frames and made.fps == pytest.approx(fps)
    assert np.abs(made.root_positions[0] - walk.root_positions[first]).max() < 1e-3


def test_what_stands_still_is_cut_off(motionkit, walk: Motion, tmp_path: Path) -> None:
    rows = np.clip(np.arange(-60, 180), 0, len(walk) - 1)
    still = Motion(walk.skeleton, walk.local_rotations[rows], walk.root_positions[rows], walk.fps)
    write_motion(tmp_path / "still.bvh", still)
    assert motionkit("trim", "still.bvh", "-o", "a.bvh", "--moving").code == 0
    assert len(read_motion(tmp_path / "a.bvh")) == pytest.approx(len(walk) + 2 * 15, abs=6)


def test_what_is_not_there_is_refused(motionkit, walk: Motion) -> None:
    assert motionkit("trim", "walk.bvh", "--from", 5).failed_with("--from is frame 300, but the clip has 120")
    assert motionkit("trim", "walk.bvh", "--from", 1, "--to", "20f").failed_with("--to is frame 20")
    assert motionkit("trim", "walk.bvh", "--from", "five").code == 2
    said = motionkit("trim", "walk.bvh", "--from", f"{'9' * 400}f")
    assert said.code == 2 and "expected at most 1,000,000,000" in said.err
    assert motionkit("trim", "walk.bvh", "--from", ".5", "-o", "half.bvh").code == 0


@pytest.mark.parametrize("command", ["trim", "fix", "loop", "convert", "retarget", "view"])
def test_a_folder_is_done_but_for_what_fails(motionkit, walk: Motion, tmp_path: Path, command: str) -> None:
    deep = tmp_path / "in" / "deep"
    deep.mkdir(parents=True)
    write_motion(tmp_path / "in" / "a.bvh", walk)
    write_motion(deep / "b.bvh", walk)
    (deep / "bad.bvh").write_text("HIERARCHY\n")
    target = ("out",) if command == "convert" else ("-o", "out")
    form = "png" if command == "view" else "csv"
    said = motionkit(command, "in", *target, "--jobs", 1, "--format", form)
    assert said.code == 1 and "out: 2 of 3 files written\n  2 files: unit: centimetres; +Y up; 23" in said.out
    assert said.err.count("failed: ") == 1 and "bad.bvh" in said.err and "1 of 3 files failed" in said.err
    assert sorted(p.name for p in (tmp_path / "out").rglob("*.*")) == [f"a.{form}", f"b.{form}"]
    assert motionkit(command, "in", *(("in/x",) if command == "convert" else ("-o", "in/x"))).code == 2


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("synthesise", "synthesize"),
        ("looking", "view"),
        ("follow_path", "follow-path"),
        ("list-types", "synthesize --list-types"),
        ("--list-types", "synthesize --list-types"),
        ("types", "synthesize --list-types"),
        ("--types", "synthesize --types"),
        ("resample", "trim --fps"),
        ("speed", "trim --speed"),
        ("walk.bvh", "view walk.bvh"),
    ],
)
def test_mistyped_commands_are_suggested(motionkit, walk: Motion, typed: str, meant: str) -> None:
    assert f"did you mean {meant}?" in motionkit(typed).err


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (("synthesize", "running,cartwheel"), "did you mean --types running,cartwheel?"),
        (("retarget", "walk.bvh", "walk.bvh"), "did you mean --rig walk.bvh?"),
        (("fix", "walk.bvh", "out.bvh"), "did you mean -o out.bvh?"),
        (("convert", "walk.bvh", "-o", "out.glb"), "'-o'; give the file to write as TARGET, after SOURCE"),
        (("convert", "walk.bvh", "--output", "out.glb"), "'--output'; give the file to write as TARGET"),
        (("follow-path", "walk.bvh"), "is a motion, expected a path"),
        (("follow-path", "walk.bvh", "--types", "walking"), "is a motion, expected a path"),
        (("follow-path", "none.bvh", "--types", "walking"), "none.bvh: no such file"),
    ],
)
def test_what_is_in_the_wrong_place_is_suggested(
    motionkit, walk: Motion, words: tuple[str, ...], meant: str
) -> None:
    said = motionkit(*words)
    assert said.code != 0 and meant in said.err
