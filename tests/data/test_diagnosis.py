from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.data.diagnosis import Diagnosis, diagnose, two_groups
from motionkit.motion.bvh import write_bvh

CLIPS = {
    "Sprung": ("jumping-b", 3),
    "Gehen": ("walking", 4),
    "Lauf_02": ("running", 3),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Clips under foreign names. One jump is a walk, four walks are runs, and a file is torn."""
    out = tmp_path_factory.mktemp("doctor")
    for name, (kind, count) in CLIPS.items():
        (out / name).mkdir()
        motion = mk.synthesize(f"{kind}:{1.8 * count}", seed=2).motion
        for number in range(count):
            write_bvh(out / name / f"{number}.bvh", motion.cut(108 * number, 108 * (number + 1)))
    shutil.copy(out / "Gehen" / "0.bvh", out / "Sprung" / "wrong.bvh")
    (out / "Lauf_02" / "torn.bvh").write_text("HIERARCHY\n")
    return out


@pytest.fixture(scope="module")
def found(folder: Path) -> Diagnosis:
    return diagnose([folder])


def warnings_of(found: Diagnosis, kind: str) -> str:
    return "; ".join(next(t.warnings for t in found.types if t.name == kind))


def test_every_clip_is_described(found: Diagnosis, folder: Path) -> None:
    clips = {clip.name: clip for clip in found.clips}
    assert len(clips) == 12
    walk = clips[str(Path("Gehen") / "0.bvh")]
    assert (walk.types, walk.fps, walk.up, walk.fault) == (("Gehen",), 60.0, "Y", "")
    assert walk.seconds == pytest.approx(1.8, abs=0.1) and walk.rig == "23 joints, Hips"
    assert abs(walk.floor) < 3.0 and walk.glitches == 0 and "centimetres" in walk.unit
    torn = clips[str(Path("Lauf_02") / "torn.bvh")]
    assert "torn.bvh" in torn.fault and torn.seconds == 0.0


def test_types_are_measured_not_named(found: Diagnosis) -> None:
    types = {t.name: t for t in found.types}
    assert list(types) == ["Gehen", "Lauf_02", "Sprung"]
    assert 80.0 < types["Gehen"].speed < 180.0 < 230.0 < types["Lauf_02"].speed
    assert types["Gehen"].clips == 4 and types["Gehen"].flights == 0.0 and types["Sprung"].flights == 0.75


def test_a_jump_that_stays_on_the_ground_is_named(found: Diagnosis) -> None:
    assert "most clips leave the ground, but not Sprung" in warnings_of(found, "Sprung")
    assert "wrong.bvh" in warnings_of(found, "Sprung")
    assert "leave the ground" not in warnings_of(found, "Gehen")


def test_clips_of_another_type_are_named(found: Diagnosis, folder: Path, tmp_path: Path) -> None:
    assert "move like" not in warnings_of(found, "Gehen") + warnings_of(found, "Lauf_02")
    mixed = tmp_path / "mixed"
    shutil.copytree(folder / "Gehen", mixed / "Gehen")
    shutil.copytree(folder / "Lauf_02", mixed / "Lauf_02")
    (mixed / "Lauf_02" / "torn.bvh").unlink()
    for number in range(2):
        shutil.copy(folder / "Lauf_02" / f"{number}.bvh", mixed / "Gehen" / f"fast{number}.bvh")
    words = warnings_of(diagnose([mixed]), "Gehen")
    assert (
        "two groups" in words
        and "fast0.bvh" in words
        and "fast1.bvh" in words
        and "0.bvh differ" not in words
    )


def test_singletons_and_short_types_are_named(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    shutil.copy(folder / "Gehen" / "0.bvh", tmp_path / "one" / "a.bvh")
    words = warnings_of(diagnose([tmp_path / "one"]), "a")
    assert "one clip only" in words and "1.8 s in all" in words


@pytest.mark.parametrize("shift", [0.0, 40.0])
def test_two_groups(shift: float) -> None:
    places = np.random.default_rng(0).normal(size=(9, 5))
    places[6:] += shift
    assert two_groups(places) == ([6, 7, 8] if shift else None)


def test_a_type_that_is_only_held_out_is_told(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder / "Gehen", tmp_path / "clips")
    rows = "".join(
        f"{n}.bvh,0,-1,{'Rad' if n == 3 else 'Gehen'},{'test' if n == 3 else ''}\n" for n in range(4)
    )
    (tmp_path / "clips" / "labels.csv").write_text("file,start_frame,end_frame,type,split\n" + rows)
    found = diagnose([tmp_path / "clips"])
    assert "held out" in warnings_of(found, "Rad") and "held out" not in warnings_of(found, "Gehen")
