from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.export.formats import WRITERS, read_motion
from motionkit.motion.bvh import write_bvh
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
