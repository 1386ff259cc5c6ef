"""Motion written into a user's .glb or .vrm, checked by what glTF says and not by motionkit's own kinematics."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.editing.rest_frame import with_rest_frame
from motionkit.editing.root_motion import in_place, with_ground_root
from motionkit.errors import MotionkitError
from motionkit.export.clip import rig_clip
from motionkit.export.formats import read_clip, write_motion
from motionkit.finish.on_rig import on_rig
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_angle
from motionkit.motion.skeleton import JOINT_NAMES
from motionkit.rig.on_rig import read_rig
from motionkit.rig.soles import read_soles
from rig.test_gltf_rig import VRM, character
from synthetic_characters import CHARACTERS, skinned
from synthetic_motions import make_walk

LEGS = np.float32([[0.1, 0.2, 0.3], [0.0, 1.0, 2.0]])


def parts(path: Path) -> tuple[str, dict[str, Any], bytes]:
    """The JSON text, its value and the binary chunk of a file."""
    data = path.read_bytes()
    magic, version, size, length = struct.unpack_from("<4sIII", data)
    assert (magic, version, size) == (b"glTF", 2, len(data)) and length % 4 == 0
    text = data[20 : 20 + length].decode()
    return text, json.loads(text), data[28 + length :]


def write(path: Path, value: dict[str, Any], data: bytes = b"") -> None:
    """A file with indented JSON, which no program writes just so."""
    text = json.dumps({"asset": {"version": "2.0"}} | value, indent=1).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(data), b"BIN\0") + data if data else b""
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def numbers(value: dict[str, Any], data: bytes, index: int) -> Array:
    """An accessor of floats that lie one behind the other."""
    accessor = value["accessors"][index]
    view = value["bufferViews"][accessor["bufferView"]]
    if uri := value["buffers"][view["buffer"]].get("uri"):
        data = base64.b64decode(uri.split(",")[1])
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
    assert accessor["componentType"] == 5126 and (view["byteOffset"] % 4, view["byteLength"]) == (
        0,
        4 * width * accessor["count"],
    )
    return np.frombuffer(data, "<f4", width * accessor["count"], view["byteOffset"]).reshape(-1, width)


def worlds(path: Path, number: int = -1) -> dict[str, Array]:
    """World transforms (T, 4, 4) of the nodes by name, while an animation plays."""
    _, value, data = parts(path)
    animation = value["animations"][number]
    over: dict[tuple[int, str], Array] = {}
    for channel in animation["channels"]:
        target, sampler = channel["target"], animation["samplers"][channel["sampler"]]
        over[target["node"], target["path"]] = numbers(value, data, sampler["output"]).astype(float)
    frames = len(numbers(value, data, animation["samplers"][0]["input"]))
    above = {c: node for node, entry in enumerate(value["nodes"]) for c in entry.get("children", [])}

    def world(node: int) -> Array:
        entry = value["nodes"][node]
        local = np.broadcast_to(np.eye(4), (frames, 4, 4)).copy()
        x, y, z, w = np.broadcast_to(
            over.get((node, "rotation"), np.array(entry.get("rotation", [0, 0, 0, 1]), float)), (frames, 4)
        ).T
        local[:, :3, :3] = np.moveaxis(
            np.array([
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]), -1, 0,
        )  # fmt: skip
        local[:, :3, :3] *= np.array(entry.get("scale", [1, 1, 1]))
        local[:, :3, 3] = over.get(
            (node, "translation"), np.array(entry.get("translation", [0, 0, 0]), float)
        )
        if "matrix" in entry:
            assert not any((node, path) in over for path in ("rotation", "translation", "scale"))
            local = np.broadcast_to(np.array(entry["matrix"], float).reshape(4, 4).T, local.shape)
        return world(above[node]) @ local if node in above else local

    return {entry["name"]: world(node) for node, entry in enumerate(value["nodes"])}


def plain(value: dict[str, Any]) -> bytes:
    return b""


def with_bytes(value: dict[str, Any]) -> bytes:
    """A buffer of an odd length, an accessor, and what the writer knows nothing of."""
    value["buffers"] = [{"extras": {"byteLength": 7}, "byteLength": 25}]
    value["bufferViews"] = [{"buffer": 0, "byteLength": 24, "byteOffset": 0}]
    value["accessors"] = [{"bufferView": 0, "componentType": 5126, "count": 2, "type": "VEC3"}]
    value["extras"] = {"animations": ["} ]", 1e-7, 1.0], "é": None}
    value["cameras"] = [{"type": "perspective", "perspective": {"yfov": 0.70, "znear": 1}}]
    return LEGS.tobytes() + b"!\0\0\0"


def elsewhere(value: dict[str, Any]) -> bytes:
    """A buffer in the JSON itself, so that the bytes of the animation need another one."""
    with_bytes(value)
    uri = "data:application/octet-stream;base64," + base64.b64encode(LEGS.tobytes()).decode()
    value["buffers"] = [{"byteLength": 24, "uri": uri}]
    return b""


def matrices(value: dict[str, Any]) -> bytes:
    """The armature, which is not animated, and the hips, which are, as matrices."""
    turned = [0, 0, 0.01, 0, 0, 0.01, 0, 0, -0.01, 0, 0, 0, 3, 0, 1, 1]
    value["nodes"][1] = {"name": "Armature", "children": [2], "matrix": turned}
    hips = value["nodes"][2]
    del hips["rotation"]
    hips["matrix"] = [0, 0, 2, 0, 0, 2, 0, 0, -2, 0, 0, 0, *hips.pop("translation"), 1]
    return b""


@pytest.fixture
def walk() -> Motion:
    return make_walk(90)


@pytest.mark.parametrize("change", [plain, with_bytes, elsewhere, matrices])
def test_the_users_file_with_an_animation(
    tmp_path: Path, walk: Motion, change: Callable[[dict[str, Any]], bytes]
) -> None:
    """Nothing but additions differs, and the nodes go where the motion on the rig has its joints."""
    value = character()
    data = change(value)
    write(tmp_path / "hero.glb", value, data)
    rig = read_rig(tmp_path / "hero.glb")
    made = on_rig(walk, rig)
    write_motion(tmp_path / "out.glb", rig_clip(made, rig, "out", [("walking", 1.5)]))
    old, _, _ = parts(tmp_path / "hero.glb")
    _, new, written = parts(tmp_path / "out.glb")
    assert written.startswith(data) and [one["name"] for one in new["animations"]] == ["walking"]
    count = len(value.get("accessors", []))
    assert new.pop("accessors")[:count] == value.pop("accessors", [])
    assert new.pop("bufferViews")[:count] == value.pop("bufferViews", [])
    del new["animations"], new["asset"]
    assert new.pop("buffers")[0].get("extras") == value.pop("buffers", [{}])[0].get("extras")
    if change is matrices:
        assert "matrix" not in new["nodes"][2] and new["nodes"][2].pop("scale") == pytest.approx([2] * 3)
        value["nodes"][2] = new["nodes"][2]
    assert new == value
    for line in old.splitlines():  # the letters too: "0.70" is no "0.7"
        assert (
            change is matrices
            or "byteLength" in line
            or line.rstrip("} ]\n,") in parts(tmp_path / "out.glb")[0]
        )
    found, names = worlds(tmp_path / "out.glb"), rig.skeleton.names
    places = motion_kinematics(made)[1]
    for joint, name in enumerate(names):
        assert np.abs(found[name][:, :3, 3] - places[:, joint]).max() < 3e-6, name


def ground_speed(places: Array) -> Array:
    """The way over the ground of (T, 3) from frame to frame."""
    return np.linalg.norm(np.diff(places[:, [0, 2]], axis=0), axis=-1)


@pytest.mark.parametrize("seed", [1, 2])
def test_the_characters_own_feet_stand(tmp_path: Path, walk: Motion, seed: int) -> None:
    """Toes that stand in the motion are at their height in the file, 3 cm, within 0.5 cm, and do not slide."""
    write(tmp_path / "hero.glb", character(seed=seed))
    rig = read_rig(tmp_path / "hero.glb")
    write_motion(tmp_path / "out.glb", rig_clip(on_rig(walk, rig), rig, "out"))
    found, there = worlds(tmp_path / "out.glb"), motion_kinematics(walk)[1]
    for side in ("Left", "Right"):
        toe = found[f"{side}ToeBase"][:, :3, 3]
        low = toe[:, 1] < toe[:, 1].min() + 0.005
        assert 0.0295 < toe[low, 1].min() and toe[low, 1].max() < 0.0345 and low.sum() > 6
        planted = low[1:] & low[:-1] & (ground_speed(there[:, JOINT_NAMES.index(f"{side}ToeBase")]) < 0.55)
        assert planted.sum() > 2 and ground_speed(toe)[planted].max() < 1e-5
    # The turn of every bone from its rest is that of the canonical joint: a limb points where the walk has it.
    shin = found["LeftFoot"][:, :3, 3] - found["LeftLeg"][:, :3, 3]
    names = [JOINT_NAMES.index(name) for name in ("LeftFoot", "LeftLeg")]
    wanted = there[:, names[0]] - there[:, names[1]]
    cosine = (shin * wanted).sum(-1) / np.linalg.norm(shin, axis=-1) / np.linalg.norm(wanted, axis=-1)
    assert np.rad2deg(np.arccos(np.clip(cosine, -1, 1))).mean() < 1.6


def test_read_back_and_write_again(tmp_path: Path, walk: Motion) -> None:
    value = character()
    write(tmp_path / "hero.glb", value, with_bytes(value))
    rig = read_rig(tmp_path / "hero.glb")
    made = on_rig(walk, rig)
    write_motion(tmp_path / "a.glb", rig_clip(made, rig, "first"))
    clip = read_clip(tmp_path / "a.glb")
    assert clip.name == "first" and clip.motion.fps == 60.0
    assert float(quat_angle(clip.motion.local_rotations, made.local_rotations).max()) < 1e-6
    assert np.abs(clip.motion.root_positions - made.root_positions * 100.0).max() < 1e-4
    assert np.abs(clip.in_file().root_positions - made.root_positions).max() < 1e-6
    write_motion(tmp_path / "b.glb", clip.with_motion(clip.motion.cut(10, 40)))
    assert [one["name"] for one in parts(tmp_path / "b.glb")[1]["animations"]] == ["first", "first_2"]
    first, second = worlds(tmp_path / "b.glb", 0), worlds(tmp_path / "b.glb", 1)
    assert all(
        np.abs(second[name] - first[name][10:40]).max() < 1e-6 for name in first if len(first[name]) > 1
    )
    write_motion(tmp_path / "c.glb", replace(clip, name="only", alone=True))
    assert [one["name"] for one in parts(tmp_path / "c.glb")[1]["animations"]] == ["only"]


def test_joints_in_between_and_beside_keep_their_rest(tmp_path: Path, walk: Motion) -> None:
    """A root above the hips and a prop in the hand get no track; the hips have the way."""
    value = character()
    value["nodes"] += [{"name": "sword", "translation": [0, 9, 0], "rotation": [0.6, 0, 0, 0.8]}]
    value["nodes"][JOINT_NAMES.index("RightHand") + 2]["children"] = [len(value["nodes"]) - 1]
    value["skins"].append({"joints": [1, len(value["nodes"]) - 1]})
    write(tmp_path / "hero.glb", value)
    rig = read_rig(tmp_path / "hero.glb")
    write_motion(tmp_path / "out.glb", rig_clip(on_rig(walk, rig), rig, "out"))
    channels = parts(tmp_path / "out.glb")[1]["animations"][0]["channels"]
    moved = [
        value["nodes"][c["target"]["node"]]["name"] for c in channels if c["target"]["path"] == "translation"
    ]
    turned = {value["nodes"][c["target"]["node"]]["name"] for c in channels}
    assert moved == ["Hips"] and not {"sword", "Scene"} & turned


def test_a_root_bone_that_is_there_takes_the_way(tmp_path: Path, walk: Motion) -> None:
    """Or stays, if the motion is in place; the body is where it was, and no joint is added."""
    value = character()
    value["nodes"][1]["name"] = "rig|Root_"
    value["skins"][0]["joints"] += [1]
    write(tmp_path / "hero.glb", value)
    rig = read_rig(tmp_path / "hero.glb")
    made = on_rig(walk, rig)
    for name, change in (("plain", lambda m: m), ("root", with_ground_root), ("still", in_place)):
        write_motion(tmp_path / f"{name}.glb", rig_clip(change(made), rig, name))
    plain, root, still = (worlds(tmp_path / f"{name}.glb") for name in ("plain", "root", "still"))
    assert np.abs(root["LeftHand"] - plain["LeftHand"]).max() < 1e-6
    way = root["rig|Root_"][:, :3, 3]
    assert np.ptp(plain["rig|Root_"][:, :3, 3], axis=0).max() == 0.0
    assert np.abs(way - plain["Hips"][:, :3, 3])[:, [0, 2]].max() < 0.11 and np.ptp(way[:, 1]) < 1e-6
    assert np.ptp(still["rig|Root_"][:, :3, 3], axis=0).max() < 1e-6
    assert np.ptp(still["Hips"][:, [0, 2], 3], axis=0).max() < 0.044 < 1.6 < np.ptp(way[:, 2])
    write(tmp_path / "bare.glb", character())
    bare = read_rig(tmp_path / "bare.glb")
    with pytest.raises(MotionkitError, match=r"adds the joint .* to those of .*bare\.glb; --root ground"):
        write_motion(tmp_path / "b.glb", rig_clip(with_ground_root(on_rig(walk, bare)), bare, "walk"))


@pytest.mark.parametrize("bound", [True, False])
def test_skin_of_the_root_bone_goes_along(tmp_path: Path, walk: Motion, bound: bool) -> None:
    """The root bone travels if vertices are bound to it, as by some percent heels may be; else the hips travel."""
    value = character()
    value["nodes"][1]["name"] = "Root"
    with_root = value["skins"][0]["joints"] + [1]
    value["skins"][0]["joints"] = with_root if bound else with_root[:-1]
    (tmp_path / "hero.glb").write_bytes(
        skinned(value, lambda whole: whole["skins"][0].update(joints=with_root))
    )
    rig = read_rig(tmp_path / "hero.glb")
    made = on_rig(walk, rig)
    write_motion(tmp_path / "out.glb", rig_clip(made, rig, "out"))
    found, hips = worlds(tmp_path / "out.glb"), rig.skeleton.names.index("Hips")
    assert np.abs(found["Hips"][:, :3, 3] - motion_kinematics(made)[1][:, hips]).max() < 1e-6
    way = np.ptp(found["Root"][:, 2, 3])
    assert way > 1.7 if bound else way == 0.0


@pytest.mark.parametrize("key", ["heels on root", "belt on root"])
def test_a_root_bone_goes_down_with_the_hips_only_for_other_skin_than_feet(
    tmp_path: Path, walk: Motion, key: str
) -> None:
    """Some percent of a heel may hang on the root: in a crouch it would press the heel through the floor."""
    (tmp_path / "hero.glb").write_bytes(skinned(CHARACTERS[key]()))
    rig = read_rig(tmp_path / "hero.glb")
    jumps = np.sin(np.linspace(0.0, 2.0 * np.pi, len(walk)), dtype=np.float32)[:, None] * [0.0, 30.0, 0.0]
    moved = replace(walk, root_positions=walk.root_positions + jumps.astype(np.float32))
    made = on_rig(moved, rig, ik=False)
    first = with_rest_frame(made, rig)
    write_motion(tmp_path / "out.glb", rig_clip(first, rig, "out"))
    found, hips = worlds(tmp_path / "out.glb"), rig.skeleton.names.index("Hips")
    root, body = (found[name][:, :3, 3] for name in ("Root", "Hips"))
    assert np.abs(body - motion_kinematics(first)[1][:, hips]).max() < 1e-5
    assert np.abs((body - root)[:, [0, 2]] - (body - root)[0, [0, 2]]).max() < 1e-5
    assert root[:, 1].max() > 0.2 and np.ptp(body[:, 1]) > 0.5
    assert (root[:, 1].min() < -0.2) == (key == "belt on root") and (
        root[:, 1].min() > -0.01
    ) == rig.character.under


@pytest.mark.filterwarnings("error")
def test_weights_of_any_size_are_shares(tmp_path: Path) -> None:
    data = bytearray(skinned(CHARACTERS["heels on root"]()))
    (tmp_path / "hero.glb").write_bytes(data)
    _, value, binary = parts(tmp_path / "hero.glb")
    first = len(data) - len(binary) + value["bufferViews"][value["accessors"][2]["bufferView"]]["byteOffset"]
    struct.pack_into("<4f", data, first, *[3e38] * 4)
    (tmp_path / "hero.glb").write_bytes(data)
    rig = read_rig(tmp_path / "hero.glb")
    assert read_soles(rig) is not None and rig.character.under


@pytest.mark.parametrize("where", ["beside", "along"])
def test_twist_is_spread(tmp_path: Path, walk: Motion, where: str) -> None:
    """Half-way along the upper arm there is half its twist; nothing else moves for it."""
    axis, angle = np.array([1.0, 0.0, 0.0]), 1.2
    value = character()
    arm, fore = (JOINT_NAMES.index(name) + 2 for name in ("LeftArm", "LeftForeArm"))
    half = (0.5 * np.array(value["nodes"][fore]["translation"])).tolist()
    value["nodes"].append({"name": "LeftArmTwist", "translation": half})
    if where == "along":
        value["nodes"][-1]["children"], value["nodes"][arm]["children"] = [fore], []
        value["nodes"][fore]["translation"] = half
    value["nodes"][arm]["children"].append(len(value["nodes"]) - 1)
    value["skins"][0]["joints"].append(len(value["nodes"]) - 1)
    write(tmp_path / "hero.glb", value)
    rig = read_rig(tmp_path / "hero.glb")
    rotations = walk.local_rotations.copy()
    rotations[:, JOINT_NAMES.index("LeftArm")] = np.float32([np.cos(angle / 2), *(np.sin(angle / 2) * axis)])
    made = on_rig(replace(walk, local_rotations=rotations), rig, ik=False)
    names = rig.skeleton.names
    turns, places = motion_kinematics(made)
    upper, twisted = (turns[:, names.index(n)] for n in ("LeftArm", "LeftArmTwist"))
    base, shares = turns[:, names.index("LeftShoulder")], (1.0, 0.5) if where == "beside" else (0.0, 1.0)
    for found, share in zip((upper, twisted), shares, strict=True):
        assert np.abs(quat_angle(base, found) - share * angle).max() < 3e-6
    write(tmp_path / "plain.glb", character())
    bare = on_rig(replace(walk, local_rotations=rotations), read_rig(tmp_path / "plain.glb"), ik=False)
    for name in ("LeftForeArm", "LeftHand"):
        found = motion_kinematics(bare)
        joint, own = bare.skeleton.names.index(name), names.index(name)
        assert float(quat_angle(turns[:, own], found[0][:, joint]).max()) < 1e-6
        assert np.abs(places[:, own] - found[1][:, joint]).max() < 1e-6


@pytest.mark.parametrize("version", ["0.x", "1.0"])
def test_avatars(tmp_path: Path, walk: Motion, version: str) -> None:
    value, table = character(), {bone: {"node": JOINT_NAMES.index(name) + 2} for name, bone in VRM.items()}
    value["extensions"] = {"VRMC_vrm": {"humanoid": {"humanBones": table}}}
    if version == "0.x":
        bones = [{"bone": bone, **entry} for bone, entry in table.items()]
        value["extensions"] = {"VRM": {"humanoid": {"humanBones": bones}}}
    write(tmp_path / "hero.vrm", value)
    rig = read_rig(tmp_path / "hero.vrm")
    clip = rig_clip(on_rig(walk, rig), rig, "walk")
    for name in ("out.vrm", "out.glb"):
        write_motion(tmp_path / name, clip)
        assert parts(tmp_path / name)[1]["extensions"] == value["extensions"]
        assert len(read_clip(tmp_path / name).motion) == 90
    with pytest.raises(MotionkitError, match=r"a \.vrm is an avatar"):
        write_motion(tmp_path / "none.vrm", walk)
    write(tmp_path / "hero.glb", character())
    rig = read_rig(tmp_path / "hero.glb")
    with pytest.raises(MotionkitError, match="has no humanoid part"):
        write_motion(tmp_path / "none.vrm", rig_clip(on_rig(walk, rig), rig, "walk"))
    assert not (tmp_path / "none.vrm").exists()


def away(value: dict[str, Any]) -> bytes:
    value["buffers"] = [{"byteLength": 24, "uri": "mesh.bin"}]
    return b""


def short(value: dict[str, Any]) -> bytes:
    value["buffers"] = [{"byteLength": 2400}]
    return LEGS.tobytes()


def endless(value: dict[str, Any]) -> bytes:
    value["buffers"] = [{}]
    return LEGS.tobytes()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (away, "another file, 'mesh.bin'"),
        (short, "has 24 bytes, expected 2,400"),
        (endless, "byteLength is -1"),
    ],
)
def test_what_cannot_be_added_to(
    tmp_path: Path, walk: Motion, change: Callable[[dict[str, Any]], bytes], said: str
) -> None:
    value = character()
    write(tmp_path / "hero.glb", value, change(value))
    rig = read_rig(tmp_path / "hero.glb")
    with pytest.raises(MotionkitError, match=said):
        write_motion(tmp_path / "out.glb", rig_clip(on_rig(walk, rig), rig, "walk"))
    assert not (tmp_path / "out.glb").exists()
