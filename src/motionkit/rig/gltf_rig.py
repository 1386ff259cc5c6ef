"""Reads the rig of a binary glTF file (.glb) or an avatar (.vrm) as a BVH file of one frame, its rest pose.

Nodes may have any rest rotations, but a BVH file has none. So the joints get the axes of the world, as when Blender
writes an armature to BVH. Lengths are in metres and Y is up, as in every glTF file.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.arrays import Doubles
from motionkit.motion.bvh import POSITION_CHANNELS, ROTATION_ORDER, BvhFile
from motionkit.motion.bvh_text import MAX_JOINTS, MAX_NAME
from motionkit.motion.rotations import quat_to_matrix
from motionkit.motion.skeleton import Skeleton
from motionkit.rig.gltf import GltfFile

_FRAME_TIME = 1.0 / 60.0
# VRM names of limb bones and their canonical joints, without the side. Spine and collars are found between the limbs.
_VRM_LIMBS = {
    "UpperLeg": "UpLeg", "LowerLeg": "Leg", "Foot": "Foot", "Toes": "ToeBase",
    "UpperArm": "Arm", "LowerArm": "ForeArm", "Hand": "Hand",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class GltfRig:
    """The rig of a glTF file.

    Attributes:
        bvh: its joints in the rest pose, in metres.
        humanoid: canonical limb joints, hips and head to joint indices, if an avatar's bone table names them.
    """

    bvh: BvhFile
    humanoid: dict[str, int]


def read_gltf_rig(path: str | Path) -> GltfRig:
    """Read the rig of a .glb or .vrm file; raises MotionkitError, naming the file, if it has no usable rig."""
    tree = _Nodes(GltfFile(path))
    humanoid = tree.humanoid()
    joints = tree.joints(set(humanoid.values()))
    index = {node: joint for joint, node in enumerate(joints)}
    places = np.stack([tree.places[node] for node in joints])
    parents = tuple(index.get(tree.parents[node], -1) for node in joints)
    offsets = places - np.stack([places[parent] if parent >= 0 else np.zeros(3) for parent in parents])
    skeleton = Skeleton(tree.names(joints), parents, offsets.astype(np.float32))
    turns = tuple(f"{axis}rotation" for axis in ROTATION_ORDER)
    hips = index.get(humanoid.get("Hips", -1), 0)
    movers = {0, hips}
    channels = tuple(POSITION_CHANNELS + turns if joint in movers else turns for joint in range(len(joints)))
    values = [
        offsets[joint, "XYZ".index(name[0])] if name.endswith("position") else 0.0
        for joint, names in enumerate(channels)
        for name in names
    ]
    bvh = BvhFile(skeleton, channels, np.array([values]), _FRAME_TIME)
    return GltfRig(bvh, {name: index[node] for name, node in humanoid.items()})


class _Nodes:
    """The nodes of a file, their parents, and their world positions in the rest pose."""

    def __init__(self, file: GltfFile) -> None:
        self.file, self.fault = file, file.fault
        self.nodes = file.items("nodes")
        if not self.nodes:
            raise self.fault("has no nodes, expected a rigged character")
        self.parents = [-1] * len(self.nodes)
        for node, entry in enumerate(self.nodes):
            for child in self._indices(entry.get("children", []), f"children of node {node}"):
                if self.parents[child] >= 0 or child == node:
                    raise self.fault(f"node {child} has two parents")
                self.parents[child] = node
        self.order = self._top_down()
        self.transforms: list[Doubles] = [np.eye(4)] * len(self.nodes)
        for node in self.order:
            own, parent = self._transform(node), self.parents[node]
            self.transforms[node] = self.transforms[parent] @ own if parent >= 0 else own
        self.places = [transform[:3, 3] for transform in self.transforms]

    def name(self, node: int) -> str:
        name = self.nodes[node].get("name")
        return name if isinstance(name, str) and name.strip() else f"node{node}"

    def _indices(self, value: Any, what: str) -> list[int]:
        good = isinstance(value, list) and all(isinstance(i, int) and 0 <= i < len(self.nodes) for i in value)
        if not good:
            raise self.fault(f"expected node numbers below {len(self.nodes)} as {what}")
        return list(value)

    def _top_down(self) -> list[int]:
        """All nodes, parents before children, in the order of the file."""
        order: list[int] = []
        waiting = [node for node in range(len(self.nodes) - 1, -1, -1) if self.parents[node] < 0]
        while waiting:
            node = waiting.pop()
            order.append(node)
            waiting.extend(reversed(self.nodes[node].get("children", [])))
        if len(order) < len(self.nodes):
            raise self.fault("the nodes form a circle")
        return order

    def _transform(self, node: int) -> Doubles:
        """The transform (4, 4) of a node relative to its parent."""
        entry = self.nodes[node]
        if "matrix" in entry:
            matrix = self._numbers(entry["matrix"], 16, node, "matrix").reshape(4, 4).T
        else:
            x, y, z, w = self._numbers(entry.get("rotation", [0.0, 0.0, 0.0, 1.0]), 4, node, "rotation")
            size = math.sqrt(x * x + y * y + z * z + w * w)
            if size < 1e-6:
                raise self.fault(f"node {self.name(node)} has a rotation of length zero")
            matrix = np.eye(4)
            matrix[:3, :3] = quat_to_matrix(np.array([w, x, y, z]) / size)
            matrix[:3, :3] *= self._numbers(entry.get("scale", [1.0, 1.0, 1.0]), 3, node, "scale")
            matrix[:3, 3] = self._numbers(entry.get("translation", [0.0, 0.0, 0.0]), 3, node, "translation")
        if float(np.linalg.det(matrix[:3, :3])) < 0.0:
            raise self.fault(
                f"node {self.name(node)} has a negative scale; apply the scale in the program it is from"
            )
        return matrix

    def _numbers(self, value: Any, count: int, node: int, what: str) -> Doubles:
        good = isinstance(value, list) and len(value) == count
        if not good or not all(isinstance(v, (int, float)) and abs(v) < 1e6 for v in value):
            raise self.fault(f"expected {count} numbers as {what} of node {self.name(node)}")
        return np.array(value, np.float64)

    def humanoid(self) -> dict[str, int]:
        """Map canonical limb joints, hips and head to nodes by the bone table of VRM 0.x or 1.0; empty without one."""
        extensions = self.file.json.get("extensions")
        extensions = extensions if isinstance(extensions, dict) else {}
        table: dict[str, Any] = {}
        for key in ("VRMC_vrm", "VRM"):
            human = extensions.get(key)
            bones = human.get("humanoid") if isinstance(human, dict) else None
            bones = bones.get("humanBones") if isinstance(bones, dict) else None
            if isinstance(bones, dict):
                table = {bone: entry.get("node") for bone, entry in bones.items() if isinstance(entry, dict)}
            elif isinstance(bones, list):
                table = {
                    str(entry.get("bone")): entry.get("node") for entry in bones if isinstance(entry, dict)
                }
        wanted = {"hips": "Hips", "head": "Head"}
        for side in ("Left", "Right"):
            wanted |= {f"{side.lower()}{part}": f"{side}{ours}" for part, ours in _VRM_LIMBS.items()}
        found = {ours: table[bone] for bone, ours in wanted.items() if table.get(bone) is not None}
        nodes = self._indices(list(found.values()), "bones of the avatar")
        twice = [self.name(node) for node, count in Counter(nodes).items() if count > 1]
        if twice:
            raise self.fault(f"the avatar's bone table names {twice[0]} twice")
        return found

    def joints(self, humanoid: set[int]) -> list[int]:
        """The nodes of the rig, parents first: those of skins and avatar, and all between them and the rig's root."""
        wanted = set(humanoid)
        for skin in self.file.items("skins"):
            wanted |= set(self._indices(skin.get("joints", []), "joints of a skin"))
        if not wanted:
            wanted = {node for node in self.order if "mesh" not in self.nodes[node]}
        roots = Counter(self._paths(node)[0] for node in wanted)
        top = self._common([node for node in wanted if self._paths(node)[0] == self._main(roots)])
        inside = set()
        for node in wanted:
            path = self._paths(node)
            if top in path:
                inside |= set(path[path.index(top) :])
        if len(inside) > MAX_JOINTS:
            raise self.fault(f"more than {MAX_JOINTS} joints")
        return [node for node in self.order if node in inside]

    def _main(self, roots: Counter[int]) -> int:
        """The top node above the most joints; raises MotionkitError if another one has at least half as many."""
        (first, count), *others = roots.most_common()
        if others and 2 * others[0][1] >= count:
            names = f"{self.name(first)} and {self.name(others[0][0])}"
            raise self.fault(f"two skeletons, below {names}; expected one character per file")
        return first

    def _paths(self, node: int) -> list[int]:
        """The nodes from a top node to a node, both included."""
        path = [node]
        while self.parents[path[-1]] >= 0:
            path.append(self.parents[path[-1]])
        return path[::-1]

    def _common(self, nodes: list[int]) -> int:
        """The deepest common ancestor of some nodes, which may be one of them."""
        paths = [self._paths(node) for node in nodes]
        return [steps[0] for steps in zip(*paths, strict=False) if len(set(steps)) == 1][-1]

    def names(self, nodes: list[int]) -> tuple[str, ...]:
        """Unique names that a BVH file can hold."""
        out: list[str] = []
        for node in nodes:
            name = re.sub(r"[\s{}]+", "_", self.name(node).strip())[: MAX_NAME - 8]
            number, free = 2, name
            while free in out:
                free, number = f"{name}_{number}", number + 1
            out.append(free)
        return tuple(out)
