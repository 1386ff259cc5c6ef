from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.editing.loop import make_loop, motion_seam
from motionkit.errors import MotionkitError
from motionkit.export.clip import Clip
from motionkit.export.formats import WRITERS, read_clip, read_motion, write_motion
from motionkit.models.model import MotionModel
from motionkit.motion.bvh import bvh_to_motion, read_bvh, write_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import JOINT_NAMES, Skeleton
from synthetic_motions import make_walk


@pytest.fixture(scope="module")
def walk() -> Motion:
    return make_walk(40)


def positions(motion: Motion) -> np.ndarray:
    return motion_kinematics(motion)[1]


def test_convert(motionkit, walk: Motion, tmp_path: Path) -> None:
    write_bvh(tmp_path / "a.bvh", walk)
    took = "unit: centimetres; +Y up; 23 joints found by name"
    said = motionkit("convert", "a.bvh", "a.glb").out
    assert said == f"wrote a.glb: 23 joints, 40 frames at 60 fps\n  a.bvh: 40 frames at 60 fps; {took}\n"
    said = motionkit("convert", "a.glb", "b.bvh", "--fps", 30, "--json")
    assert json.loads(said.out) == {
        "file": "a.glb",
        "taken": f"40 frames at 60 fps; {took.replace('centimetres', 'metres, as the format says')}",
        "output": "b.bvh",
        "frames": 20,
        "fps": 30.0,
        "joints": 23,
    }
    back = read_motion(tmp_path / "b.bvh")
    assert np.abs(positions(back) - positions(walk)[::2]).max() < 1e-2
    assert motionkit("convert", "a.bvh", "a.gltf").code == 2
    assert motionkit("convert", "a.csv", "b.bvh").failed_with("a.csv: no such file", ".bvh, .amc")
    assert motionkit("convert", "a.bvh", "a.bvh").code == 2
    assert motionkit("convert", "none.bvh", "c.glb").failed_with("none.bvh: no such file")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.bvh", "a.glb", "b.bvh"]


def test_synthesize_and_follow_path_write_every_format(
    motionkit, tiny_model_file: Path, tmp_path: Path
) -> None:
    for ending in set(WRITERS) - {".vrm", ".fbx"}:
        words = ("--types", "walking:0.2,idle:0.1", "--model", tiny_model_file, "-o", f"a{ending}")
        assert motionkit("synthesize", *words).code == 0
    assert np.load(tmp_path / "a.npz")["types"].tolist() == ["walking"] * 12 + ["idle"] * 6
    words = ("follow-path", "line", "--size", 0.2, "--model", tiny_model_file, "-o", "b.glb")
    assert motionkit(*words).code == 0
    assert read_motion(tmp_path / "b.glb").skeleton.names == JOINT_NAMES
    for name, words in (("c.gltf", "use .glb"), ("v.html", ".bvh, .glb"), ("c", ".bvh, .glb")):
        said = motionkit("synthesize", "--types", "walking", "--model", tiny_model_file, "-o", name)
        assert said.code == 2 and words in said.err and not (tmp_path / name).exists()


def test_faults_of_a_rig_name_its_file(motionkit, walk: Motion, tmp_path: Path) -> None:
    crane = Skeleton(("Base", "Boom"), (-1, 0), np.array([[0, 0, 0], [0, 60, 0]], np.float32))
    write_bvh(tmp_path / "crane.bvh", Motion(crane, walk.local_rotations[:, :2], walk.root_positions, 60.0))
    assert motionkit("convert", "crane.bvh", "a.vrma").failed_with("crane.bvh: not a known human rig")
    write_bvh(tmp_path / "zero.bvh", replace(walk, skeleton=walk.skeleton.scaled(0.0)))
    assert motionkit("convert", "zero.bvh", "a.glb").failed_with("zero.bvh: all bones have length zero")
    assert motionkit("view", "crane.bvh", "zero.bvh", "-o", "a.html").failed_with("zero.bvh: all bones")
    (tmp_path / "crane.bvh").unlink()
    assert motionkit("preprocess", ".").failed_with("zero.bvh: LeftUpLeg is a bone of zero length")
    assert not list(tmp_path.glob("a.*"))


def test_types_outlive_conversions_and_cuts(motionkit, tmp_path: Path) -> None:
    types = (("jumping-l", 0.5), ("walking", 1.5))
    write_motion(tmp_path / "a.glb", Clip(make_walk(120), "a", types))
    for words in ("convert a.glb b.npz", "convert b.npz c.glb", "fix a.glb -o d.npz"):
        assert motionkit(*words.split()).code == 0
        assert read_clip(tmp_path / words.split()[-1]).types == types
    assert motionkit("mirror", "a.glb", "e.npz").code == 0
    assert read_clip(tmp_path / "e.npz").types == (("jumping-r", 0.5), ("walking", 1.5))
    cut = ("trim", "a.glb", "--from", 0.25, "--to", 1, "--speed", 0.5, "-o", "f.glb", "--replace")
    assert motionkit(*cut).code == 0
    assert read_clip(tmp_path / "f.glb").types == (("jumping-l", 0.5), ("walking", 1.0))


def test_results_are_written_with_their_types(tiny_model: MotionModel, tmp_path: Path) -> None:
    mk.write(tmp_path / "a.npz", mk.synthesize("walking:0.5,running:0.5", model=tiny_model))
    assert [kind for kind, _ in read_clip(tmp_path / "a.npz").types] == ["walking", "running"]
    mk.write(tmp_path / "b.npz", mk.follow_path("line", size=0.5, model=tiny_model))
    assert [kind for kind, _ in read_clip(tmp_path / "b.npz").types] == ["walking"]
    with pytest.raises(MotionkitError, match="a file takes one motion, found 2"):
        mk.write(tmp_path / "c.npz", mk.synthesize("walking:0.5", count=2, model=tiny_model))


def test_a_cycle_stays_one_at_another_rate_and_pace(motionkit, tmp_path: Path) -> None:
    walk = make_walk(200)
    write_motion(tmp_path / "a.bvh", make_loop(walk).motion)
    assert motionkit("convert", "a.bvh", "b.bvh", "--fps", 24).code == 0
    assert motionkit("trim", "a.bvh", "--speed", 1.3, "-o", "c.bvh").code == 0
    assert motionkit("retarget", "a.bvh", "--fps", 25, "--no-ik", "-o", "d.bvh").code == 0
    for name in ("a", "b", "c", "d"):
        motion = bvh_to_motion(read_bvh(tmp_path / f"{name}.bvh"))
        assert motion_seam(motion).distance < 0.1, name


def test_what_a_format_cannot_show_is_said(motionkit, tmp_path: Path) -> None:
    write_motion(tmp_path / "a.bvh", make_walk(40))
    said = motionkit("convert", "a.bvh", "b.vrma", "--root", "ground", "--body", "woman")
    assert said.code == 0 and "--body left out: b.vrma shows none" in said.err
    assert "--root ground left out" in said.err
    assert motionkit("convert", "a.bvh", "c.glb", "--body", "woman").err == ""
