"""--clip: one animation of a .glb or .vrm that has several, for every command that takes a clip."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from motionkit.export.clip import rig_clip
from motionkit.export.formats import read_motion, write_motion
from motionkit.finish.on_rig import on_rig
from motionkit.motion.kinematics import motion_kinematics
from motionkit.rig.on_rig import read_rig
from rig.test_character import parts, write
from rig.test_gltf_rig import character
from synthetic_motions import make_walk


@pytest.fixture
def hero(tmp_path: Path) -> Path:
    """A character with two animations of 3 and 2 s."""
    write(tmp_path / "bare.glb", character())
    for source, target, frames in (("bare", "one", 180), ("one", "hero", 120)):
        rig = read_rig(tmp_path / f"{source}.glb")
        clip = rig_clip(on_rig(make_walk(frames), rig), rig, "x", [(f"gait {frames}", 1.0)])
        write_motion(tmp_path / f"{target}.glb", clip)
    (tmp_path / "one.glb").unlink()
    return tmp_path / "hero.glb"


def test_a_format_without_animations_says_that_it_has_no_name(motionkit, tmp_path: Path) -> None:
    write_motion(tmp_path / "a.bvh", make_walk(30))
    said = motionkit("convert", "a.bvh", "b.glb", "--clip", "run")
    assert said.code == 0 and "its only motion, for its format has none called run" in said.err


@pytest.mark.parametrize(
    ("words", "made"),
    [
        ("retarget hero.glb -o a.bvh", "a.bvh"),
        ("retarget hero.glb --rig hero.glb -o a.glb", "a.glb"),
        ("metrics hero.glb", ""),
        ("mirror hero.glb a.glb", "a.glb"),
        ("view hero.glb -o a.html", "a.html"),
        ("convert hero.glb a.csv", "a.csv"),
        ("loop hero.glb -o a.glb", "a.glb"),
        ("fix hero.glb -o a.glb", "a.glb"),
        ("doctor hero.glb", ""),
        ("synthesize --types walking:0.3 --init hero.glb -o a.bvh", "a.bvh"),
        ("synthesize --types walking:0.3 --rig bare.glb --from hero.glb -o a.glb", "a.glb"),
    ],
)
def test_every_command_asks_which_and_takes_it(
    motionkit, hero: Path, tmp_path: Path, tiny_model_file: Path, words: str, made: str
) -> None:
    asked = words.split() + (["--model", tiny_model_file] if words.startswith("synth") else [])
    refused = motionkit(*asked)
    told = refused.err + refused.out
    assert (
        refused.code == 1 and "--clip: gait_180" not in told and "--clip: gait 180 (2.98 s), gait 120" in told
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bare.glb", "hero.glb"]
    done = motionkit(*asked, "--clip", "gait 120")
    assert done.code == 0, done.err
    assert not made or (tmp_path / made).stat().st_size > 1000
    if made == "a.glb" and "bare" not in words:
        names = [one["name"] for one in parts(tmp_path / "a.glb")[1]["animations"]]
        assert names[:2] == ["gait 180", "gait 120"] and len(names) == 3


def test_all_of_them(motionkit, hero: Path, tmp_path: Path) -> None:
    assert motionkit("convert", "hero.glb", "a.bvh", "--clip", "all").code == 0
    assert sorted(path.name for path in tmp_path.glob("*.bvh")) == ["a-gait 120.bvh", "a-gait 180.bvh"]
    done = motionkit("doctor", ".", "--clip", "all", "--json")
    assert done.code == 0 and '"hero.glb#gait 180"' in done.out and "bare.glb: has no animation" in done.out
    done = motionkit("convert", "hero.glb", "b.bvh", "--clip", "all", "--name", "x", "--replace")
    assert done.code == 0 and "--name and --replace left out: b" in done.err
    done = motionkit("convert", "hero.glb", "c.bvh", "--clip", "all", "--json")
    assert [one["output"] for one in json.loads(done.out)] == ["c-gait 180.bvh", "c-gait 120.bvh"]
    refused = motionkit("convert", "hero.glb", "-", "--clip", "all")
    assert refused.code == 2 and "--clip all cannot be combined with standard output" in refused.err


def test_an_animation_that_fails_leaves_the_others(motionkit, hero: Path, tmp_path: Path) -> None:
    """The first one moves no joint, only the weights of a face."""
    _, value, data = parts(hero)
    first = value["animations"][0]
    turn = next(c for c in first["channels"] if c["target"]["path"] == "rotation")
    turn["target"]["path"] = "weights"
    first["channels"] = [turn]
    write(hero, value, data)
    done = motionkit("convert", "hero.glb", "a.bvh", "--clip", "all")
    assert done.code == 1 and "failed: " in done.err and "gait 180" in done.err
    assert done.err.rstrip().endswith("1 of 2 animations failed")
    assert [path.name for path in tmp_path.glob("*.bvh")] == ["a-gait 120.bvh"]


def test_all_of_a_folder_overwrite_nothing(motionkit, hero: Path, tmp_path: Path) -> None:
    """A clip of a folder may have the name of an animation's file."""
    write_motion(tmp_path / "hero-gait 120.bvh", make_walk(30))
    refused = motionkit("convert", ".", "../out", "--clip", "all")
    assert refused.code == 2 and "out/hero-gait 120.bvh: would be written twice" in refused.err
    (tmp_path / "hero-gait 120.bvh").rename(tmp_path / "other.bvh")
    done = motionkit("convert", ".", "../out", "--clip", "all")
    assert "2 of 3 files written" in done.out and "bare.glb: has no animation" in done.err
    made = sorted(path.name for path in (tmp_path.parent / "out").iterdir())
    assert made == ["hero-gait 120.bvh", "hero-gait 180.bvh", "other.bvh"]


def test_a_true_unit_changes_nothing(motionkit, hero: Path, tmp_path: Path) -> None:
    """glTF is in metres."""
    places = []
    for unit in ((), ("--unit", "m")):
        for made in ("a.npz", "a.glb"):
            done = motionkit("convert", "hero.glb", made, "--clip", "gait 120", "--replace", *unit)
            assert done.code == 0, done.err
        with np.load(tmp_path / "a.npz") as found:
            places.append(found["positions"])
        places.append(motion_kinematics(read_motion(tmp_path / "a.glb"))[1])
    assert np.abs(places[2] - places[0]).max() < 1e-3
    assert np.abs(places[3] - places[1]).max() < 1e-3


def test_a_file_of_motionkit_keeps_its_body_and_animations(motionkit, tmp_path: Path) -> None:
    write_motion(tmp_path / "walk.bvh", make_walk(60))
    assert motionkit("convert", "walk.bvh", "own.glb", "--body", "woman").code == 0
    for command, target in (("trim", ("-o", "b.glb")), ("mirror", ("c.glb",))):
        assert motionkit(command, "own.glb", *target).code == 0
        made = parts(tmp_path / target[-1])[1]
        assert len(made["animations"]) == 2 and made["meshes"] == parts(tmp_path / "own.glb")[1]["meshes"]
    assert motionkit("convert", "own.glb", "other.glb", "--body", "heavy").code == 0
    other = parts(tmp_path / "other.glb")[1]
    assert len(other["animations"]) == 1 and other["accessors"] != parts(tmp_path / "own.glb")[1]["accessors"]
    assert motionkit("convert", "own.glb", "ground.glb", "--root", "ground").code == 0, "it has another joint"


def test_the_written_animation(motionkit, hero: Path, tmp_path: Path, tiny_model_file: Path) -> None:
    """Name and place beside the others; an avatar is asked for before any work; the input stays."""
    words = ("synthesize", "--types", "walking:0.3,idle:0.2", "--model", tiny_model_file, "--rig", "hero.glb")
    assert motionkit(*words, "-o", "a.glb").code == 0
    assert motionkit(*words).code == 0 and len(parts(tmp_path / "walking-idle.glb")[1]["animations"]) == 3
    assert motionkit(*words, "-o", "b.glb", "--name", "my move", "--replace").code == 0
    names = [[one["name"] for one in parts(tmp_path / name)[1]["animations"]] for name in ("a.glb", "b.glb")]
    assert names == [["gait 180", "gait 120", "walking-idle"], ["my move"]]
    for name, said in (("c.vrm", "a .vrm is an avatar"), ("hero.glb", "is read by this command")):
        refused = motionkit(*words, "-o", name)
        assert refused.code in (1, 2) and said in refused.err
    assert not (tmp_path / "c.vrm").exists()
