from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.data.dataset import Dataset
from motionkit.data.diagnosis import Diagnosis, diagnose, two_groups
from motionkit.data.events import find_events
from motionkit.data.repeat import small_types
from motionkit.features.encode import encode_motion
from motionkit.features.layout import DEFAULT_LAYOUT, feature_layout
from motionkit.motion.bvh import write_bvh
from motionkit.motion.rotations import quat_identity
from motionkit.motion.skeleton import JOINT_COUNT

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
    assert walk.seconds == pytest.approx(1.8, abs=0.1) and walk.rig == "23 joints below Hips"
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
    assert "like '" not in warnings_of(found, "Gehen") + warnings_of(found, "Lauf_02")
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
    assert "held out" not in warnings_of(found, "Gehen")
    rad = next(t for t in found.types if t.name == "Rad")
    assert rad.warnings == (rad.unlearnable,), "one line, and no other that contradicts it"
    assert "split column of labels.csv holds out all its clips" in rad.unlearnable


def test_a_type_of_clips_that_are_too_short_cannot_be_learnt(tmp_path: Path) -> None:
    motion = mk.synthesize("walking:3", seed=2).motion
    for number in range(2):
        (tmp_path / "a").mkdir(exist_ok=True)
        write_bvh(tmp_path / "a" / f"{number}.bvh", motion.cut(60 * number, 60 * number + 20))
    (facts,) = diagnose([tmp_path]).types
    assert "too short, at most 0.33 s, and 0.4 s are needed" in facts.unlearnable
    assert facts.warnings == (facts.unlearnable,)
    write_bvh(tmp_path / "a" / "longer.bvh", motion.cut(100, 126))
    (facts,) = diagnose([tmp_path]).types
    assert not facts.unlearnable


def test_short_stretches_of_one_clip_do_not_add_up(tmp_path: Path) -> None:
    write_bvh(tmp_path / "a.bvh", mk.synthesize("walking:4", seed=2).motion)
    rows = [f"a.bvh,{start},{start + 21},steps" for start in (60, 120, 180)]
    (tmp_path / "labels.csv").write_text("\n".join(["file,start_frame,end_frame,type", *rows]))
    (facts,) = diagnose([tmp_path]).types
    assert "too short, at most 0.35 s" in facts.unlearnable
    mk.preprocess([tmp_path], tmp_path / "ds", mk.PreprocessOptions(held_out=()))
    (line,) = small_types(Dataset(tmp_path / "ds"))
    assert "clips of at most 0.35 s, expected at least 0.4 s" in line


def test_short_stretches_that_touch_are_usable(tmp_path: Path) -> None:
    write_bvh(tmp_path / "a.bvh", mk.synthesize("walking:3", seed=2).motion.cut(60, 105))
    rows = [f"a.bvh,{start},{start + 15},{kind}" for start, kind in ((0, "x"), (15, "y"), (30, "z"))]
    (tmp_path / "labels.csv").write_text("\n".join(["file,start_frame,end_frame,type", *rows]))
    (clip,) = diagnose([tmp_path]).clips
    assert not clip.fault and clip.types == ("x", "y", "z")


def test_few_clips_fall_into_no_groups(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "hop").mkdir()
    for kind in ("Gehen", "Lauf_02"):
        for number in range(2):
            shutil.copy(folder / kind / f"{number}.bvh", tmp_path / "hop" / f"{kind}{number}.bvh")
    assert "two groups" not in warnings_of(diagnose([tmp_path]), "hop")


def test_jumps_are_a_share_of_the_time(folder: Path, found: Diagnosis, tmp_path: Path) -> None:
    types = {t.name: t for t in found.types}
    assert types["Gehen"].in_the_air == 0.0 and 0.05 < types["Sprung"].in_the_air < 0.5
    (tmp_path / "long").mkdir()
    write_bvh(tmp_path / "long" / "0.bvh", mk.synthesize("walking:6,jumping-b,walking:6", seed=1).motion)
    (facts,) = diagnose([tmp_path]).types
    assert facts.flights == 1.0 and 0.0 < facts.in_the_air < 0.1


def test_kicks_of_one_side_are_told(tmp_path: Path) -> None:
    layout = feature_layout(DEFAULT_LAYOUT)
    motion = mk.synthesize("kicking:12", seed=2).motion
    features = encode_motion(motion, quat_identity((JOINT_COUNT,)), DEFAULT_LAYOUT).features
    kicks = find_events(features, layout)["kick"]
    for right, name in ((False, "tritt_1"), (True, "tritt_2")):
        (tmp_path / name).mkdir()
        for number, kick in enumerate([kick for kick in kicks if kick.right == right]):
            write_bvh(tmp_path / name / f"{number}.bvh", motion.cut(kick.start, kick.end))
    notes = {t.name: t.notes for t in diagnose([tmp_path / "tritt_1"]).types}
    assert "all its kicks are of the left side" in notes["motion"][0] and "--no-mirror" in notes["motion"][0]
    assert not any(t.notes for t in diagnose([tmp_path]).types), "each other's other side"
    (tmp_path / "tritt_2").rename(tmp_path / "tritt_1" / "tritt")
    both = diagnose([tmp_path])
    assert len(both.types) == 2 and not any(t.notes for t in both.types)


def test_files_that_a_table_leaves_out_are_skipped(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder / "Gehen", tmp_path / "clips")
    (tmp_path / "clips" / "labels.csv").write_text("file,start_frame,end_frame,type\n0.bvh,0,-1,Gehen\n")
    found = diagnose([tmp_path / "clips"])
    assert [clip.fault for clip in found.clips] == [""] and len(found.skipped) == 3
    assert all("not in labels.csv" in line for line in found.skipped)
