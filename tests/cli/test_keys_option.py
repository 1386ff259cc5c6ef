from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.export.formats import read_motion, write_motion
from motionkit.motion.kinematics import motion_kinematics
from synthetic_motions import make_walk


def test_keys_of_a_file(motionkit, tmp_path: Path) -> None:
    (tmp_path / "keys.json").write_text(
        json.dumps({"keys": [{"time": 1, "position": [0.2, 1.2], "facing": 15}]})
    )
    said = motionkit("synthesize", "--types", "walking:1.5", "--keys", "keys.json", "-o", "a.bvh")
    assert said.code == 0 and "key at 1 s: 0.00 cm and 0.0 degrees away" in said.out
    value = json.loads(motionkit("synthesize", "--types", "walking:1.5", "--keys", "keys.json", "--json").out)
    assert value["motions"][0]["keys"][0]["cm"] < 2.0
    before = sorted(tmp_path.iterdir())
    assert motionkit("synthesize", "--types", "walking:0.5", "--keys", "keys.json").failed_with(
        "a key at 1 s"
    )
    assert motionkit("synthesize", "--types", "walking", "--keys", "keys.json", "--loop").code == 2
    assert motionkit("synthesize", "--types", "walking", "--keys", "keys.json", "--in-place").code == 2
    (tmp_path / "bad.json").write_text("{")
    assert motionkit("synthesize", "--types", "walking", "--keys", "bad.json").failed_with(
        "bad.json: not JSON"
    )
    assert sorted(path for path in tmp_path.iterdir() if path.name != "bad.json") == before


def test_the_clip_of_a_key_is_not_overwritten(motionkit, tmp_path: Path) -> None:
    assert motionkit("synthesize", "--types", "walking:1", "-o", "pose.bvh").code == 0
    before = (tmp_path / "pose.bvh").read_bytes()
    (tmp_path / "keys.json").write_text(
        json.dumps({"keys": [{"time": 1, "pose": {"file": "pose.bvh", "seconds": 0.5}}]})
    )
    words = "synthesize", "--types", "walking:1.5", "--keys", "keys.json", "-o", "pose.bvh"
    said = motionkit(*words)
    assert said.code == 2 and "pose.bvh: is read by this command" in said.err
    assert (tmp_path / "pose.bvh").read_bytes() == before


@pytest.mark.parametrize("ending", ["glb", "bvh"])  # one says its unit, the other has canonical joints in cm
@pytest.mark.parametrize("command", ["synthesize", "follow-path"])
def test_places_are_those_of_the_world_of_the_rig(
    motionkit, tmp_path: Path, command: str, ending: str
) -> None:
    walk = make_walk(frames=30).scaled(0.6)
    write_motion(
        tmp_path / f"child.{ending}", replace(walk, skeleton=replace(walk.skeleton, cm=1.0, up="+Y"))
    )
    (tmp_path / "keys.json").write_text(json.dumps({"keys": [{"time": 3, "position": [0, 3]}]}))
    part = {"type": "walking", "points": [[0, 0], [0, 3]], "stop": 1}
    (tmp_path / "path.json").write_text(json.dumps({"parts": [part]}))
    words = ["path.json"] if command == "follow-path" else ["--types", "walking:3", "--keys", "keys.json"]
    said = motionkit(command, *words, "--rig", f"child.{ending}", "-o", "out.npz")
    assert said.code == 0
    hips = motion_kinematics(read_motion(tmp_path / "out.npz"))[1][-1, 0]
    assert abs(hips[2] - 300.0) < 8.0 and abs(hips[0]) < 8.0 and 40.0 < hips[1] < 65.0
    told = "along 3.0 m" if command == "follow-path" else "key at 3 s: 0."
    assert told in said.out


def test_keys_that_hurry_a_walk_are_told(motionkit, tmp_path: Path) -> None:
    (tmp_path / "keys.json").write_text(json.dumps({"keys": [{"time": 2, "position": [0, 8]}]}))
    said = motionkit("synthesize", "--types", "walking:2", "--keys", "keys.json", "-o", "a.npz")
    assert said.code == 0 and "the key at 2 s asks walking for 4.00 m/s: 0." in said.err


def test_after_a_clip_the_first_key_is_not_measured_from_the_origin(motionkit, tmp_path: Path) -> None:
    walk = make_walk(60, speed=130.0, turn=0.0)
    away = replace(walk, root_positions=walk.root_positions + np.array([0.0, 0.0, 2000.0], np.float32))
    write_motion(tmp_path / "away.bvh", away)
    place = float(away.root_positions[-1, 2]) / 100.0 + 1.3
    (tmp_path / "keys.json").write_text(json.dumps({"keys": [{"time": 1, "position": [0, place]}]}))
    words = ("--types", "walking:2", "--keys", "keys.json", "--init", "away.bvh", "-o", "a.npz")
    said = motionkit("synthesize", *words)
    assert said.code == 0 and "asks walking" not in said.err


def test_a_rest_frame_before_the_motion_is_not_measured(motionkit, tmp_path: Path) -> None:
    (tmp_path / "keys.json").write_text(json.dumps({"keys": [{"time": 2, "position": [0, 2.4]}]}))
    words = ("synthesize", "--types", "walking:3", "--keys", "keys.json", "--rig", "@mixamo", "--json")
    plain, rested = (
        json.loads(motionkit(*words, "-o", f"{number}.bvh", *more).out)["motions"][0]["keys"][0]["cm"]
        for number, more in enumerate(((), ("--rest-frame",)))
    )
    assert rested == pytest.approx(plain, abs=0.1)
