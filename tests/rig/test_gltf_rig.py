"""Rigs of .glb and .vrm files: nodes with rotations and scales, bone tables of avatars, and files that are refused."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motionkit.errors import MotionkitError
from motionkit.export.formats import write_motion
from motionkit.finish.on_rig import on_rig
from motionkit.motion.bvh import bvh_to_motion, read_bvh, write_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.rotations import quat_angle, quat_inverse, quat_multiply, quat_normalize, quat_rotate
from motionkit.motion.skeleton import JOINT_NAMES, PARENTS, canonical_skeleton
from motionkit.reading import reading
from motionkit.rig.on_rig import read_rig
from motionkit.rig.retarget import retarget
from motionkit.rig.to_rig import rig_bvh
from synthetic_motions import make_walk

VRM = {
    "Hips": "hips", "LowerBack": "spine", "Spine": "chest", "Spine1": "upperChest", "Neck": "neck", "Head": "head",
} | {
    f"{side}{ours}": f"{side.lower()}{theirs}"
    for side in ("Left", "Right")
    for ours, theirs in (
        ("UpLeg", "UpperLeg"), ("Leg", "LowerLeg"), ("Foot", "Foot"), ("ToeBase", "Toes"),
        ("Shoulder", "Shoulder"), ("Arm", "UpperArm"), ("ForeArm", "LowerArm"), ("Hand", "Hand"),
    )
}  # fmt: skip


def write_glb(path: Path, value: dict[str, Any]) -> None:
    text = json.dumps({"asset": {"version": "2.0"}} | value).encode()
    text += b" " * (-len(text) % 4)
    path.write_bytes(b"glTF" + struct.pack("<IIII", 2, 20 + len(text), len(text), 0x4E4F534A) + text)


def character(names: dict[str, str] | None = None, seed: int = 1) -> dict[str, Any]:
    """A character in metres: an armature scaled by 0.01, joints in cm with random rest rotations, toes 3 cm up."""
    offsets = canonical_skeleton().offsets
    turns = quat_normalize(np.random.default_rng(seed).standard_normal((len(JOINT_NAMES), 4)))
    nodes: list[dict[str, Any]] = [
        {"name": "Scene", "children": [1, len(JOINT_NAMES) + 2]},
        {"name": "Armature", "scale": [0.01] * 3, "children": [2]},
    ]
    lowest = float(canonical_skeleton().rest_positions()[:, 1].min())
    for joint, name in enumerate(JOINT_NAMES):
        parent = PARENTS[joint]
        outer = turns[parent] if parent >= 0 else np.array([1.0, 0.0, 0.0, 0.0])
        way = offsets[joint] if joint else np.array([0.0, 3.0 - lowest, 0.0])
        local, place = quat_multiply(quat_inverse(outer), turns[joint]), quat_rotate(quat_inverse(outer), way)
        node: dict[str, Any] = {"name": (names or {}).get(name, name)}
        node["translation"], node["rotation"] = place.tolist(), np.roll(local, -1).tolist()
        children = [child + 2 for child in canonical_skeleton().children(joint)]
        nodes.append(node | ({"children": children} if children else {}))
    nodes.append({"name": "Body", "mesh": 0, "skin": 0})
    return {
        "nodes": nodes,
        "skins": [{"joints": list(range(2, 2 + len(JOINT_NAMES)))}],
        "scenes": [{"nodes": [0]}],
    }


def test_a_character_with_rest_rotations_and_scales(tmp_path: Path) -> None:
    write_glb(tmp_path / "my.glb", character())
    rig = read_rig(tmp_path / "my.glb")
    assert rig.skeleton.names == JOINT_NAMES and rig.joints.missing() == ()
    rest = canonical_skeleton().rest_positions()
    places = rig.skeleton.rest_positions()
    assert np.abs((places - places[0]) * 100.0 - rest).max() < 1e-3
    assert rig.stance == pytest.approx(3.0, abs=0.01)
    source = make_walk(40)
    write_bvh(tmp_path / "out.bvh", rig_bvh(on_rig(source, rig, ik=False), rig))
    out = read_bvh(tmp_path / "out.bvh")
    assert out.skeleton.names == JOINT_NAMES and out.values.shape == (40, 6 + 3 * 22)
    back, report = retarget(out)
    assert report.scale == 100.0
    turns = [motion_kinematics(motion)[0] for motion in (source, back)]
    assert np.rad2deg(quat_angle(*turns)).max() < 0.01
    assert np.abs(back.root_positions - source.root_positions).max() < 0.01


def test_a_matrix_says_the_same_as_its_parts(tmp_path: Path) -> None:
    parts, matrix = character(), character()
    node = matrix["nodes"][1]
    del node["scale"]
    node["matrix"] = [0.01, 0, 0, 0, 0, 0.01, 0, 0, 0, 0, 0.01, 0, 0, 0, 0, 1]
    for name, value in (("parts", parts), ("matrix", matrix)):
        write_glb(tmp_path / f"{name}.glb", value)
    one, other = (read_rig(tmp_path / f"{name}.glb") for name in ("parts", "matrix"))
    assert np.allclose(one.skeleton.offsets, other.skeleton.offsets)


@pytest.mark.parametrize("version", ["0.x", "1.0"])
def test_the_bone_table_of_an_avatar(tmp_path: Path, version: str) -> None:
    """Names say nothing and shape is not asked: the avatar's own table counts."""
    value = character({name: f"J_{joint}" for joint, name in enumerate(JOINT_NAMES)})
    table = {bone: {"node": JOINT_NAMES.index(name) + 2} for name, bone in VRM.items()}
    if version == "1.0":
        value["extensions"] = {"VRMC_vrm": {"humanoid": {"humanBones": table}}}
    else:
        bones = [{"bone": bone, **entry} for bone, entry in table.items()]
        value["extensions"] = {"VRM": {"humanoid": {"humanBones": bones}}}
    write_glb(tmp_path / "my.vrm", value)
    rig = read_rig(tmp_path / "my.vrm")
    assert all(rig.joints.places[name] == JOINT_NAMES.index(name) for name in VRM)
    assert rig.joints.found("LeftLeg") == "VRM"


def test_hips_below_a_root_carry_the_way(tmp_path: Path) -> None:
    value = character()
    value["skins"][0]["joints"] += [1]
    value["extensions"] = {"VRMC_vrm": {"humanoid": {"humanBones": {
        bone: {"node": JOINT_NAMES.index(name) + 2} for name, bone in VRM.items()
    }}}}  # fmt: skip
    write_glb(tmp_path / "my.glb", value)
    rig = read_rig(tmp_path / "my.glb")
    assert rig.skeleton.names[0] == "Armature" and len(rig.channels[1]) == 6
    made = on_rig(make_walk(20), rig, ik=False)
    assert np.abs(made.root_positions).max() == 0.0
    hips = motion_kinematics(made)[1][:, 1] * rig.scale
    assert np.abs(hips - make_walk(20).root_positions).max() < 0.01


def test_motionkits_own_files_are_rigs(tmp_path: Path) -> None:
    """A .glb that motionkit wrote is a rig, and motion on it can be written as .glb again."""
    write_motion(tmp_path / "walk.glb", make_walk(10))
    rig = read_rig(tmp_path / "walk.glb")
    assert set(JOINT_NAMES) <= set(rig.skeleton.names) and rig.joints.missing() == ()
    write_motion(tmp_path / "again.glb", on_rig(make_walk(10), rig))
    assert (tmp_path / "again.glb").stat().st_size > 1000
    motion = bvh_to_motion(rig_bvh(on_rig(make_walk(10), rig), rig))
    assert len(motion) == 10


def mirrored(value: dict[str, Any]) -> None:
    value["nodes"][1]["scale"] = [-0.01, 0.01, 0.01]


def circular(value: dict[str, Any]) -> None:
    value["nodes"][5]["children"] = [2]
    value["nodes"][1]["children"] = []


def turned_over(value: dict[str, Any]) -> None:
    value["nodes"][2]["scale"] = [-1, 1, -1]


def stretched(value: dict[str, Any]) -> None:
    value["nodes"][1]["scale"] = [1, 1.2, 1]


def two_parents(value: dict[str, Any]) -> None:
    value["nodes"][0]["children"] = [1, 2]


def two_characters(value: dict[str, Any]) -> None:
    count = len(value["nodes"])
    for node in list(value["nodes"]):
        value["nodes"].append(node | {"children": [child + count for child in node.get("children", [])]})
    value["nodes"][count]["name"] = "Other"
    value["skins"].append({"joints": [joint + count for joint in value["skins"][0]["joints"]]})


def two_below_one(value: dict[str, Any]) -> None:
    count = len(value["nodes"])
    two_characters(value)
    value["nodes"].append({"name": "Sketch", "children": [0, count]})
    value["scenes"] = [{"nodes": [len(value["nodes"]) - 1]}]


def no_leg(value: dict[str, Any]) -> None:
    value["nodes"][2]["children"] = [child for child in value["nodes"][2]["children"] if child != 3]
    value["skins"][0]["joints"] = [joint for joint in value["skins"][0]["joints"] if not 3 <= joint <= 6]


def leg_apart(value: dict[str, Any]) -> None:
    value["nodes"][2]["children"] = [child for child in value["nodes"][2]["children"] if child != 3]


def short_rotation(value: dict[str, Any]) -> None:
    value["nodes"][7]["rotation"] = [0, 0, 0]


def bone_twice(value: dict[str, Any]) -> None:
    table = {"hips": {"node": 2}, "head": {"node": 2}}
    value["extensions"] = {"VRMC_vrm": {"humanoid": {"humanBones": table}}}


def bone_elsewhere(value: dict[str, Any]) -> None:
    value["nodes"].append({"name": "Lamp"})
    table = {"hips": {"node": 2}, "head": {"node": len(value["nodes"]) - 1}}
    value["extensions"] = {"VRMC_vrm": {"humanoid": {"humanBones": table}}}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (mirrored, "node Armature is mirrored or flat"),
        (turned_over, "node Hips is mirrored or flat"),
        (
            stretched,
            "node Armature, above the skeleton, is scaled unevenly .1.20 times as much along one axis",
        ),
        (circular, "node 2 has two parents|the nodes form a circle"),
        (two_parents, "node 2 has two parents"),
        (two_characters, "two skeletons, below Scene and Other; expected one character per file"),
        (two_below_one, "two skeletons, below Scene and Other; expected one character per file"),
        (no_leg, "no joint found for LeftUpLeg, LeftLeg"),
        (leg_apart, "a skin has joints in 2 trees, below Scene and LeftUpLeg; expected one skeleton"),
        (short_rotation, "expected 4 numbers as rotation of node"),
        (bone_elsewhere, "has a Head that is not part of its skeleton"),
        (bone_twice, "bone table names Hips twice"),
        (lambda value: value["nodes"][0].update(children=[99]), "expected node numbers below 26"),
        (lambda value: value.update(nodes=[]), "has no nodes"),
        (lambda value: value["skins"][0].update(joints="all"), "expected node numbers"),
    ],
)
def test_what_is_refused_in_one_line(tmp_path: Path, change: Any, said: str) -> None:
    value = character()
    change(value)
    write_glb(tmp_path / "my.glb", value)
    with pytest.raises(MotionkitError, match=said) as caught:
        read_rig(tmp_path / "my.glb")
    assert "\n" not in str(caught.value) and str(caught.value).startswith(f"{tmp_path / 'my.glb'}: ")


def test_skins_of_one_character_below_one_node(tmp_path: Path) -> None:
    """Each part of a character may have a skin of its own joints, and other things their own skeletons."""
    value, joints = character(), list(range(2, 25))
    legs = [joint for joint in joints if JOINT_NAMES[joint - 2].endswith(("Leg", "Foot", "ToeBase"))]
    value["skins"] = [{"joints": joints}, {"joints": legs}, {"joints": sorted(set(joints) - set(legs))}]
    count = len(value["nodes"])
    value["nodes"] += [{"name": f"tail{n}", "children": [count + n + 1]} for n in range(30)] + [{}]
    value["nodes"][0]["children"].append(count)
    value["skins"].append({"joints": list(range(count, count + 31))})
    write_glb(tmp_path / "my.glb", value)
    assert read_rig(tmp_path / "my.glb").joints.missing() == ()


@pytest.mark.parametrize("told", [False, True])
def test_a_mesh_that_will_not_move_is_told(tmp_path: Path, told: bool) -> None:
    value, notes = character(), []
    (body,) = (node for node in value["nodes"] if "mesh" in node)
    if told:
        del body["skin"]
    write_glb(tmp_path / "my.glb", value)
    with reading(on_note=notes.append):
        read_rig(tmp_path / "my.glb")
    assert any("will not move" in note for note in notes) == told


@pytest.mark.parametrize("data", [b"", b"glTF", b"HIERARCHY\nROOT Hips" * 3, b"glTF" + b"\xff" * 40])
def test_files_that_are_no_gltf(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "my.vrm").write_bytes(data)
    with pytest.raises(MotionkitError, match=r"my\.vrm: "):
        read_rig(tmp_path / "my.vrm")
