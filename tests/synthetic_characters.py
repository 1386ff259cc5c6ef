"""Characters with meshes as .glb and .vrm files: rigs of test_gltf_rig by other names, with twist bones, as avatars."""

from __future__ import annotations

import base64
import functools
import json
import struct
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np

from motionkit.motion.rotations import quat_multiply, quat_to_matrix
from motionkit.motion.skeleton import JOINT_NAMES
from rig.test_gltf_rig import VRM, character
from synthetic_rigs import FAMILIES

# Of the triangle at each joint in the rest pose, in metres: the soles are 2.5 cm below the toes.
CORNERS = np.array([[0, 0, 0], [0.1, 0, 0], [0, -0.025, 0]], np.float32)


PIXEL = b"\x89PNG\r\n\x1a\n" + b"".join(
    struct.pack(">I", len(part) - 4) + part + struct.pack(">I", zlib.crc32(part))
    for part in (
        b"IHDR" + struct.pack(">IIBBBBB", 1, 1, 8, 2, 0, 0, 0),
        b"IDAT" + zlib.compress(b"\0\x80\x80\xff"),
        b"IEND",
    )
)


def worlds_of(nodes: list[dict[str, Any]]) -> dict[int, np.ndarray]:
    """The world matrix (4, 4) of each node."""
    out: dict[int, np.ndarray] = {}

    def visit(node: int, above: np.ndarray) -> None:
        one, local = nodes[node], np.eye(4)
        turn = np.roll(one.get("rotation", [0.0, 0.0, 0.0, 1.0]), 1)
        local[:3, :3] = quat_to_matrix(turn) * one.get("scale", [1.0] * 3)
        local[:3, 3] = one.get("translation", [0.0] * 3)
        out[node] = above @ local
        for child in one.get("children", []):
            visit(child, out[node])

    below = {child for one in nodes for child in one.get("children", [])}
    for node in set(range(len(nodes))) - below:
        visit(node, np.eye(4))
    return out


def skinned(value: dict[str, Any], change: Callable[[dict[str, Any]], object] = id) -> bytes:
    """A character of test_gltf_rig with a mesh: a triangle below each joint, weighted to it alone; then changed."""
    joints, hung = value["skins"][0]["joints"], value.pop("hung", {})
    worlds = np.stack([worlds_of(value["nodes"])[joint] for joint in joints])
    count = len(joints) - bool(hung)
    points = (worlds[:count, None, :3, 3] + CORNERS).reshape(-1, 3).astype(np.float32)
    which = np.zeros((len(points), 4), np.uint16)
    which[:, 0] = np.arange(count).repeat(3)
    weights = np.zeros((len(points), 4), np.float32)
    weights[:, 0] = 1.0
    for name, share in hung.items():
        first = 3 * JOINT_NAMES.index(name)
        which[first : first + 3, 1] = count
        weights[first : first + 3, :2] = 1.0 - share, share
    inverses = np.linalg.inv(worlds).swapaxes(1, 2).reshape(-1, 16).astype(np.float32)
    data, views, accessors = b"", [], []
    for array, kind, component in (
        (points, "VEC3", 5126), (which, "VEC4", 5123), (weights, "VEC4", 5126), (inverses, "MAT4", 5126),
    ):  # fmt: skip
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": array.nbytes})
        entry = {"bufferView": len(views) - 1, "componentType": component, "count": len(array), "type": kind}
        if kind == "VEC3":
            entry |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        accessors.append(entry)
        data += array.tobytes()
    value["skins"][0]["inverseBindMatrices"] = 3
    attributes = {"POSITION": 0, "JOINTS_0": 1, "WEIGHTS_0": 2}
    value |= {
        "asset": {"version": "2.0"}, "scene": 0, "meshes": [{"primitives": [{"attributes": attributes}]}],
        "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(data)}],
    }  # fmt: skip
    change(value)
    text = json.dumps(value).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


# Half angles about x, y and z, by joint.
POSE = {
    "Hips": (0.1, 0.2, 0.0),
    "LeftArm": (0.0, 0.0, 0.6),
    "RightUpLeg": (0.4, 0.0, 0.0),
    "LeftFoot": (0.3, 0.0, 0.2),
}


def posed(value: dict[str, Any]) -> None:
    """Turn some joints and lower the hips, as of a character that was saved in the middle of a movement."""
    for joint, half in POSE.items():
        node = value["nodes"][JOINT_NAMES.index(joint) + 2]
        turn = np.array([1.0, *half]) / np.linalg.norm([1.0, *half])
        rest = np.roll(node.get("rotation", [0.0, 0.0, 0.0, 1.0]), 1)
        node["rotation"] = np.roll(quat_multiply(rest, turn), -1).tolist()
    value["nodes"][2]["translation"][1] -= 9.0


def avatar(version: str) -> dict[str, Any]:
    """A character whose names say nothing, with the bone table of a VRM, and a spring bone on its head."""
    value = character({name: f"J_{joint}" for joint, name in enumerate(JOINT_NAMES)})
    head = JOINT_NAMES.index("Head") + 2
    value["nodes"] += [{"name": "hair", "translation": [0, 5, -5], "children": [len(value["nodes"]) + 1]}]
    value["nodes"] += [{"name": "tip", "translation": [0, -10, 0]}]
    hair = len(value["nodes"]) - 2
    value["nodes"][head].setdefault("children", []).append(hair)
    bones = {bone: JOINT_NAMES.index(name) + 2 for name, bone in VRM.items()} | {"spine": 4, "head": head}
    told = {bone: {"node": node} for bone, node in bones.items()}
    if version == "1.0":
        meta = {"name": "a", "authors": ["b"], "licenseUrl": "https://vrm.dev/licenses/1.0/"}
        springs = [{"joints": [{"node": hair, "stiffness": 0.2}, {"node": hair + 1}]}]
        value["extensions"] = {
            "VRMC_vrm": {"specVersion": "1.0", "meta": meta, "humanoid": {"humanBones": told}},
            "VRMC_springBone": {"specVersion": "1.0", "springs": springs},
        }
    else:
        listed = [{"bone": bone, **entry} for bone, entry in told.items()]
        group = {"stiffiness": 0.2, "gravityPower": 0.0, "dragForce": 0.4, "hitRadius": 0.0, "bones": [hair]}
        value["extensions"] = {
            "VRM": {"specVersion": "0.0", "meta": {"title": "a"}, "humanoid": {"humanBones": listed},
                    "secondaryAnimation": {"boneGroups": [group]}, "blendShapeMaster": {"blendShapeGroups": []},
                    "firstPerson": {}, "materialProperties": []}
        }  # fmt: skip
    value["extensionsUsed"] = list(value["extensions"])
    return value


def toon(value: dict[str, Any]) -> None:
    """Shade a skinned avatar of VRM 1.0 as cartoons are, with a normal map and tangents."""
    count, arrays = value["accessors"][0]["count"], {"NORMAL": 3, "TANGENT": 4, "TEXCOORD_0": 2}
    data = b"".join(
        np.tile(np.eye(width, dtype=np.float32)[-1], (count, 1)).tobytes() for width in arrays.values()
    )
    value["buffers"].append(
        {"byteLength": len(data), "uri": "data:;base64," + base64.b64encode(data).decode()}
    )
    attributes, first = value["meshes"][0]["primitives"][0]["attributes"], 0
    for name, width in arrays.items():
        view = {"buffer": 1, "byteOffset": first, "byteLength": 4 * width * count}
        value["bufferViews"].append(view)
        first += view["byteLength"]
        entry = {"bufferView": len(value["bufferViews"]) - 1, "componentType": 5126, "count": count}
        value["accessors"].append(entry | {"type": f"VEC{width}"})
        attributes[name] = len(value["accessors"]) - 1
    value["images"] = [{"uri": "data:image/png;base64," + base64.b64encode(PIXEL).decode()}]
    value["textures"] = [{"source": 0}]
    shading = {"VRMC_materials_mtoon": {"specVersion": "1.0"}}
    value["materials"] = [{"normalTexture": {"index": 0}, "extensions": shading}]
    value["meshes"][0]["primitives"][0]["material"] = 0
    value["extensionsUsed"].append("VRMC_materials_mtoon")


def turned_back(value: dict[str, Any]) -> dict[str, Any]:
    """The character faces -Z, as VRM 0.x."""
    value["nodes"][1]["rotation"] = [0.0, 1.0, 0.0, 0.0]
    return value


def with_root(value: dict[str, Any], **hung: float) -> dict[str, Any]:
    """A root bone on the floor, on which hang shares of the skin of some joints, by name."""
    value["nodes"][1]["name"] = "Root"
    value["skins"][0]["joints"] += [1]
    return value | {"hung": hung}


def with_twists(value: dict[str, Any]) -> dict[str, Any]:
    """A twist bone beside each forearm and upper arm, half way along."""
    for name, below in (("LeftArm", "LeftForeArm"), ("RightForeArm", "RightHand")):
        node, end = (value["nodes"][JOINT_NAMES.index(one) + 2] for one in (name, below))
        node["children"].append(len(value["nodes"]))
        value["skins"][0]["joints"].append(len(value["nodes"]))
        half = (0.5 * np.array(end["translation"])).tolist()
        value["nodes"].append({"name": f"{name}_twist", "translation": half})
    return value


CHARACTERS: dict[str, Callable[[], dict[str, Any]]] = {
    "plain": character,
    "twists": lambda: with_twists(character()),
    "heels on root": lambda: with_root(character(), LeftFoot=0.1, RightToeBase=0.1),
    "belt on root": lambda: with_root(character(), LeftFoot=0.1, Hips=0.3),
    "backwards": lambda: turned_back(character()),
    "vrm0": lambda: turned_back(avatar("0.x")),
    "vrm1": lambda: avatar("1.0"),
    **{key: functools.partial(character, names) for key, names in FAMILIES.items()},
}
