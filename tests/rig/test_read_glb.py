"""Animations of foreign glTF files: what accessors and samplers may be, several animations, names, and limits."""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.export.formats import read_clip, read_motion, write_motion
from motionkit.motion.bvh import read_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.rotations import quat_angle
from motionkit.motion.skeleton import JOINT_NAMES, canonical_skeleton
from motionkit.reading import reading
from motionkit.rig.on_rig import read_rig
from motionkit.rig.retarget import retarget_file
from rig.test_character import write
from rig.test_gltf_rig import character

HALF = np.sqrt(0.5)
TIMES = np.float32([0.0, 0.5, 1.0])
TURNS = np.float32([[0, 0, 0, 1], [0, HALF, 0, HALF], [0, 0, 0, 1]])  # a quarter about Y and back


class Maker:
    """A character whose LeftArm turns, written with accessors of a kind."""

    def __init__(self) -> None:
        self.value, self.data = character(), bytearray()
        self.value |= {"accessors": [], "bufferViews": [], "animations": []}
        places = canonical_skeleton().offsets.astype(float)
        places[0, 1] = 3.0 - canonical_skeleton().rest_positions()[:, 1].min()
        for node, place in zip(self.value["nodes"][2:], places, strict=False):
            node["translation"] = place.tolist()
            del node["rotation"]

    def view(self, data: bytes, **more: Any) -> int:
        self.value["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)} | more
        )
        self.data += data + b"\0" * (-len(data) % 4)
        return len(self.value["bufferViews"]) - 1

    def accessor(self, count: int, kind: str, component: int = 5126, **more: Any) -> int:
        self.value["accessors"].append({"componentType": component, "count": count, "type": kind} | more)
        return len(self.value["accessors"]) - 1

    def floats(self, values: Array, kind: str, **more: Any) -> int:
        return self.accessor(len(values), kind, bufferView=self.view(values.astype("<f4").tobytes()), **more)

    def clip(self, name: str, output: int, how: str = "LINEAR", times: Array = TIMES) -> None:
        """An animation of the left arm."""
        given = self.floats(times, "SCALAR", max=[float(times[-1])], min=[0.0])
        target = {"node": self.node("LeftArm"), "path": "rotation"}
        sampler = {"input": given, "output": output, "interpolation": how}
        self.value["animations"].append(
            {"name": name, "samplers": [sampler], "channels": [{"sampler": 0, "target": target}]}
        )

    def node(self, name: str) -> int:
        return JOINT_NAMES.index(name) + 2

    def write(self, path: Path) -> Path:
        self.value["buffers"] = [{"byteLength": len(self.data)}]
        write(path, self.value, bytes(self.data))
        return path


def plain(maker: Maker) -> int:
    return maker.floats(TURNS, "VEC4")


def interleaved(maker: Maker) -> int:
    wide = np.zeros((3, 7), "<f4")
    wide[:, 2:6] = TURNS
    return maker.accessor(3, "VEC4", bufferView=maker.view(wide.tobytes(), byteStride=28), byteOffset=8)


def shorts(maker: Maker) -> int:
    values = np.round(TURNS * 32767).astype("<i2")
    return maker.accessor(3, "VEC4", 5122, bufferView=maker.view(values.tobytes()), normalized=True)


def sparse(maker: Maker) -> int:
    """All at rest but the second key, the last of which is a key of zeros without a buffer view elsewhere."""
    rest = np.tile(np.float32([0, 0, 0, 1]), (3, 1))
    index = {"bufferView": maker.view(np.uint16([1]).tobytes()), "componentType": 5123}
    one = {"bufferView": maker.view(TURNS[1:2].tobytes())}
    return maker.floats(rest, "VEC4", sparse={"count": 1, "indices": index, "values": one})


def spline(maker: Maker) -> int:
    still = np.zeros_like(TURNS)
    return maker.floats(np.stack([still, TURNS, still], axis=1).reshape(9, 4), "VEC4")


@pytest.mark.parametrize("output", [plain, interleaved, shorts, sparse, spline])
def test_accessors_of_every_kind(tmp_path: Path, output: Callable[[Maker], int]) -> None:
    maker = Maker()
    maker.clip("turn", output(maker), "CUBICSPLINE" if output is spline else "LINEAR")
    motion = read_motion(maker.write(tmp_path / "a.glb"))
    arm = motion.skeleton.names.index("LeftArm")
    # Between so few keys a spline is a curve, which takes more frames.
    frames = 30 if output is spline else 1
    assert (len(motion), motion.fps) == (2 * frames + 1, 2.0 * frames)
    for frame in range(3):
        wanted = np.roll(TURNS[frame], 1)
        assert float(quat_angle(motion.local_rotations[frame * frames, arm], wanted)) < 1e-3
    rest = read_rig(tmp_path / "a.glb").skeleton
    assert np.abs(motion.skeleton.offsets - rest.offsets * 100.0).max() < 1e-3


@pytest.mark.parametrize("how", ["LINEAR", "CUBICSPLINE"])
def test_keys_without_a_number_are_filled(tmp_path: Path, how: str) -> None:
    turns = TURNS.copy()
    turns[1, 2] = np.nan
    turns[2] *= -1.0  # the same turn
    still = np.zeros_like(turns)
    spline = np.stack([still, np.abs(turns), still], axis=1).reshape(9, 4)
    maker = Maker()
    maker.clip("turn", maker.floats(spline if how == "CUBICSPLINE" else turns, "VEC4"), how)
    path, notes = maker.write(tmp_path / "a.glb"), list[str]()
    with reading(on_note=notes.append):
        motion = read_motion(path)
    filled = 1 if how == "CUBICSPLINE" else 4  # or the quaternion as a whole
    words = "value" if filled == 1 else "values"
    assert notes == [f"a.glb: read with {filled} {words} without a number filled from neighbouring frames"]
    arm = motion.skeleton.names.index("LeftArm")
    wanted = [[HALF, 0, HALF, 0], [1, 0, 0, 0]][how == "LINEAR"]
    middle = motion.local_rotations[len(motion) // 2, arm]
    assert float(quat_angle(middle, np.float32(wanted))) < 1e-3
    with reading(strict=True), pytest.raises(MotionkitError, match="not finite"):
        read_motion(path)


def test_which_animation_is_never_guessed(tmp_path: Path) -> None:
    maker = Maker()
    for name in ("wave", "point"):
        maker.clip(name, plain(maker), times=TIMES * (1 + (name == "point")))
    path = maker.write(tmp_path / "a.glb")
    with pytest.raises(MotionkitError, match=r"2 animations.*--clip: wave \(1\.00 s\), point \(2\.00 s\)"):
        read_motion(path)
    with pytest.raises(MotionkitError, match="no animation called jump; it has: wave"):
        read_clip(path, "jump")
    assert len(read_clip(path, "point").motion) == 3
    with reading(animation="point"):
        assert read_motion(path).seconds == pytest.approx(3.0)
        assert retarget_file(path)[0].seconds == pytest.approx(3.0)


def test_animations_of_one_name_are_numbered(tmp_path: Path) -> None:
    maker = Maker()
    for times in (TIMES, 2 * TIMES):
        maker.clip("mixamo.com", plain(maker), times=times)
    path = maker.write(tmp_path / "a.glb")
    with pytest.raises(MotionkitError, match=r"mixamo.com \(1\.00 s\), mixamo.com_2 \(2\.00 s\)"):
        read_motion(path)
    assert read_clip(path, "mixamo.com_2").motion.fps == 1.0


def test_keys_between_those_of_another_track_are_kept(tmp_path: Path) -> None:
    maker = Maker()
    maker.clip("turn", plain(maker))
    (animation,) = maker.value["animations"]
    times = maker.floats(np.float32([0.0, 0.25, 1.0]), "SCALAR", max=[1.0], min=[0.0])
    animation["samplers"].append({"input": times, "output": plain(maker)})
    animation["channels"].append({"sampler": 1, "target": {"node": maker.node("Head"), "path": "rotation"}})
    motion = read_motion(maker.write(tmp_path / "a.glb"))
    assert (len(motion), motion.fps) == (61, 60.0)
    for frame, name in ((15, "Head"), (30, "LeftArm")):
        turned = motion.local_rotations[frame, motion.skeleton.names.index(name)]
        assert float(quat_angle(turned, np.roll(TURNS[1], 1))) < 1e-3


@pytest.mark.parametrize(("times", "told", "fps"), [
    (TIMES, None, 2.0), (TIMES * (2 / 62.5), None, 62.5), (TIMES[:1], 24.0, 24.0), (TIMES, 30.0, 2.0),
])  # fmt: skip
def test_the_rate_is_that_of_the_keys_or_told(
    tmp_path: Path, times: Array, told: float | None, fps: float
) -> None:
    maker = Maker()
    maker.clip("turn", maker.floats(TURNS[: len(times)], "VEC4"), times=times)
    maker.value["animations"][0] |= {"extras": {"fps": told}} if told else {}
    assert read_motion(maker.write(tmp_path / "a.glb")).fps == pytest.approx(fps, rel=1e-5)


def test_what_a_motion_does_not_hold_is_told(tmp_path: Path) -> None:
    maker, notes = Maker(), list[str]()
    maker.clip("turn", plain(maker))
    maker.value["nodes"].append({"name": "Sword"})
    maker.value["nodes"][0]["children"].append(len(maker.value["nodes"]) - 1)
    for node, path in ((len(maker.value["nodes"]) - 1, "rotation"), (maker.node("Head"), "weights")):
        maker.value["animations"][0]["channels"].append(
            {"sampler": 0, "target": {"node": node, "path": path}}
        )
    with reading(on_note=notes.append):
        read_motion(maker.write(tmp_path / "a.glb"))
    assert notes == [
        "a.glb: read with moving nodes outside the skeleton left out: Sword; changing shapes left out: Head"
    ]


def test_nodes_above_the_skeleton_carry_it(tmp_path: Path) -> None:
    """The armature, which no skin has, turns and travels: the body goes with it."""
    maker = Maker()
    maker.clip("go", plain(maker))
    animation = maker.value["animations"][0]
    for path, values in (("rotation", TURNS), ("translation", np.float32([[0, 0, 0], [0, 0, 2], [0, 0, 4]]))):
        output = maker.floats(values, f"VEC{values.shape[1]}")
        animation["samplers"].append({"input": animation["samplers"][0]["input"], "output": output})
        animation["channels"].append(
            {"sampler": len(animation["samplers"]) - 1, "target": {"node": 1, "path": path}}
        )
    motion = read_motion(maker.write(tmp_path / "a.glb"))
    places, rest = motion_kinematics(motion)[1], motion_kinematics(motion.cut(0, 1))[1][0]
    feet = [motion.skeleton.names.index(name) for name in ("LeftFoot", "RightFoot")]
    assert places[2, feet] == pytest.approx(rest[feet] + np.float32([0, 0, 400]), abs=0.01)
    x, y, z = rest[feet].T
    assert places[1, feet] == pytest.approx(np.stack([z, y, 200 - x], axis=-1), abs=0.01)


def test_names_are_cleaned_once_for_every_reader(tmp_path: Path) -> None:
    """Names that would write a hierarchy of their own, move a cursor, or be one name."""
    maker = Maker()
    names = ["a b}\nJOINT {x", "\x1b[2Jc\u202e", "", "same", "same", 5, None, "same_2", "n" * 500]
    for node, name in zip(maker.value["nodes"][12:], names, strict=False):
        node["name"] = name
    maker.clip("turn", plain(maker))
    path = maker.write(tmp_path / "a.glb")
    found = read_motion(path).skeleton.names
    assert len(set(found)) == len(found) and all(name.isprintable() for name in found)
    assert (
        not any(letter in name for name in found for letter in " {}\n\x1b\u202e")
        and max(map(len, found)) <= 200
    )
    write_motion(tmp_path / "a.bvh", read_motion(path))
    assert read_bvh(tmp_path / "a.bvh").skeleton.names == found


@pytest.mark.parametrize(("stretched", "refused"), [(1, False), (1000, True)])
def test_a_few_keys_are_no_long_animation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stretched: int, refused: bool
) -> None:
    maker = Maker()
    maker.clip("some", plain(maker), times=TIMES * np.float32(stretched))
    monkeypatch.setattr("motionkit.rig.read_glb.MOST_POSES", 1)
    expected = pytest.raises(MotionkitError, match=r"between \d+ keys, expected at most 0 frames")
    with expected if refused else nullcontext():
        read_motion(maker.write(tmp_path / "a.glb"))


def test_long_animations_and_large_trees_are_refused_or_quick(tmp_path: Path) -> None:
    maker = Maker()
    maker.clip("long", plain(maker), times=TIMES * np.float32(8333))
    with pytest.raises(MotionkitError, match="lasts 8,333 s, expected at most 3,600"):
        read_motion(maker.write(tmp_path / "a.glb"))
    start = time.perf_counter()
    chain = [{"name": "same", "children": [node + 1]} for node in range(15_000)] + [{"name": "same"}]
    write(tmp_path / "b.glb", {"nodes": chain, "skins": [{"joints": [0, 15_000]}]})
    with pytest.raises(MotionkitError, match="15001 joints, expected at most 2000"):
        read_rig(tmp_path / "b.glb")
    write(tmp_path / "c.glb", {"nodes": [*chain[:1900], {"name": "same"}], "skins": [{"joints": [0, 1900]}]})
    with pytest.raises(MotionkitError, match=r"c\.glb"):
        read_rig(tmp_path / "c.glb")
    assert time.perf_counter() - start < 20.0


@pytest.mark.parametrize("what", ["skeleton", "mesh"])
def test_files_without_motion_or_skeleton_say_so(tmp_path: Path, what: str) -> None:
    value = character() if what == "skeleton" else {"nodes": [{"mesh": 0}], "meshes": [{"primitives": []}]}
    write(tmp_path / "a.glb", value)
    said = (
        "has no animation; as a rig it can be given with --rig"
        if what == "skeleton"
        else "only meshes; rig it first"
    )
    with pytest.raises(MotionkitError, match=said):
        read_motion(tmp_path / "a.glb")
    assert struct.unpack_from("<I", (tmp_path / "a.glb").read_bytes(), 4) == (2,) and json.dumps(value)
