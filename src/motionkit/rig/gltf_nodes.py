"""The nodes of a glTF file: their tree, names and rest transforms, and which of them are the joints of a character."""

from __future__ import annotations

import contextlib
import math
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np

from motionkit.arrays import Array, Doubles
from motionkit.errors import MotionkitError
from motionkit.motion.bvh_text import MAX_JOINTS, MAX_NAME
from motionkit.motion.rotations import quat_to_matrix
from motionkit.names import joint_names, visible
from motionkit.rig.gltf import GltfFile
from motionkit.rig.names import LIMBS, limb

# VRM names of bones and their canonical joints; limbs without the side. Spine and collars are found between the limbs.
_VRM_LIMBS = {
    "UpperLeg": "UpLeg", "LowerLeg": "Leg", "Foot": "Foot", "Toes": "ToeBase",
    "UpperArm": "Arm", "LowerArm": "ForeArm", "Hand": "Hand",
}  # fmt: skip


VRM_BONES = {"hips": "Hips", "head": "Head"} | {
    f"{side.lower()}{bone}": f"{side}{ours}"
    for side in ("Left", "Right")
    for bone, ours in _VRM_LIMBS.items()
}

# Degrees, and share of the skin's size, by which a joint of a posed character is away from its bind pose.
POSED = (5.0, 0.02)
MOST_TURNED = 45.0  # degrees by which the top joint of a posed character is turned away from its bind pose
UNEVEN = (
    1.02  # ratio of scales along the axes of a node above the skeleton; rotations below it shear the body
)


class GltfNodes:
    """The nodes of a file: parents (-1 for none), an order with parents first, and their transforms.

    local and world are the transforms (4, 4) that the nodes have. rest_local and rest_world are those in which the
    skins are bound; they are the same lists unless the file was saved in another pose.
    """

    def __init__(self, file: GltfFile) -> None:
        """Read the nodes; raises MotionkitError, naming the file, if they are no tree of valid transforms."""
        self.file, self.fault = file, file.fault
        self.nodes = file.items("nodes")
        if not self.nodes:
            raise self.fault("has no nodes, expected a rigged character")
        self.parents = [-1] * len(self.nodes)
        for node, entry in enumerate(self.nodes):
            for child in self.indices(entry.get("children", []), f"children of node {node}"):
                if self.parents[child] >= 0 or child == node:
                    raise self.fault(f"node {child} has two parents")
                self.parents[child] = node
        self.order = self._top_down()
        self.local: list[Doubles] = [self._transform(node) for node in range(len(self.nodes))]
        self.world = self._worlds({})
        bound: dict[int, Doubles] = {}
        # Our own bodies are bound in a pose of their own.
        for skin in [] if self.file.by_motionkit() else self.file.items("skins"):
            # Without readable matrices the nodes' own pose is at rest.
            with contextlib.suppress(MotionkitError, np.linalg.LinAlgError):
                bound = self._bound(skin) | bound
        self.rest_world = self._worlds(bound) if bound else self.world
        self.rest_local = self._locals(self.rest_world) if bound else self.local

    def name(self, node: int) -> str:
        """The name of a node in messages and, made unique, of its joint."""
        name = self.nodes[node].get("name")
        return visible(name) if isinstance(name, str) and name.strip() else f"node{node}"

    def indices(self, value: Any, what: str) -> list[int]:
        """A list of node numbers."""
        good = isinstance(value, list) and all(type(i) is int and 0 <= i < len(self.nodes) for i in value)
        if not good:
            raise self.fault(f"expected node numbers below {len(self.nodes)} as {what}")
        return list(value)

    def _worlds(self, known: dict[int, Doubles]) -> list[Doubles]:
        """Global transforms of all nodes; some may be known, and move those below them."""
        out = list(self.local)
        for node in self.order:
            if node in known:
                out[node] = known[node]
            elif self.parents[node] >= 0:
                out[node] = out[self.parents[node]] @ self.local[node]
        return out

    def _locals(self, world: list[Doubles]) -> list[Doubles]:
        """Transforms relative to the parents; those below a parent of no size, as of hidden props, stay as they are."""
        out = list(self.local)
        for node, parent in enumerate(self.parents):
            if parent < 0:
                out[node] = world[node]
            elif np.linalg.det(world[parent]) != 0.0:
                out[node] = np.linalg.inv(world[parent]) @ world[node]
        return out

    def _bound(self, skin: dict[str, Any]) -> dict[int, Doubles]:
        """The global transforms in which the joints of a skin are bound to its vertices; none if they have these.

        None either if a bone has another scale than it was bound with, as by sliders for proportions: animations keep
        that scale, so the body of the file is the one to move.

        A joint's transform times its inverse bind matrix leads from the space of the mesh to the scene. In the bind
        pose it is the same for all joints. In another pose it is taken to be none, or that of the node above the
        skeleton, whichever is nearer to that of the top joint, which may be posed, too.

        Raises:
            MotionkitError: the matrices cannot be read.
        """
        joints = self.indices(skin.get("joints"), "joints of a skin")
        binds = self.file.array(skin.get("inverseBindMatrices"), 16).reshape(-1, 4, 4).swapaxes(1, 2)
        if not joints or len(binds) < len(joints):
            return {}
        inverse = np.linalg.inv(binds[: len(joints)].astype(np.float64))
        spaces = np.stack([self.world[joint] for joint in joints]) @ np.linalg.inv(inverse)
        top = joints.index(next(node for node in self.order if node in joints))
        reach = float(np.ptp(inverse[:, :3, 3], axis=0).max())
        apart = [_apart(spaces[top], space) for space in spaces]
        if max(turn for turn, _ in apart) < POSED[0] and max(away for _, away in apart) < POSED[1] * reach:
            return {}
        if any(math.isinf(turn) for turn, _ in apart):
            return {}
        above = self.parents[joints[top]]
        usual = [np.eye(4), *([self.world[above]] if above >= 0 else [])]
        turns = [_apart(space, spaces[top])[0] for space in usual]
        space = usual[int(np.argmin(turns))] if min(turns) < MOST_TURNED else spaces[top]
        return {joint: space @ own for joint, own in zip(joints, inverse, strict=True)}

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
        return matrix

    def _numbers(self, value: Any, count: int, node: int, what: str) -> Doubles:
        good = isinstance(value, list) and len(value) == count
        if not good or not all(type(v) in (int, float) and abs(v) < 1e6 for v in value):
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
        found = {ours: table[bone] for bone, ours in VRM_BONES.items() if table.get(bone) is not None}
        nodes = self.indices(list(found.values()), "bones of the avatar")
        twice = [self.name(node) for node, count in Counter(nodes).items() if count > 1]
        if twice:
            raise self.fault(f"the avatar's bone table names {twice[0]} twice")
        return found

    def joints(self, humanoid: set[int]) -> list[int]:
        """The nodes of the character, parents first: those of skins and avatar, and all between them and their top."""
        needed = set(humanoid)
        for skin in self.file.items("skins"):
            needed |= set(self.indices(skin.get("joints", []), "joints of a skin"))
        if not needed:
            needed = {node for node in self.order if "mesh" not in self.nodes[node]}
        if not needed:
            raise self.fault("has no skeleton, only meshes; rig it first (in Blender, Mixamo or Mesh2Motion)")
        needed = self._main(needed)
        below = [0] * len(self.nodes)  # how many needed nodes are at or below each node
        for node in reversed(self.order):
            below[node] += node in needed
            if self.parents[node] >= 0:
                below[self.parents[node]] += below[node]
        top = [node for node in self.order if below[node] == len(needed)][-1]
        inside, out = {top}, [top]
        for node in self.order:
            if below[node] and self.parents[node] in inside:
                inside.add(node)
                out.append(node)
        if len(out) > MAX_JOINTS:
            raise self.fault(f"{len(out)} joints, expected at most {MAX_JOINTS}")
        self._check_scales(top, out)
        return out

    def _check_scales(self, top: int, joints: list[int]) -> None:
        """Raise MotionkitError for scales with which rotations are no rotations of the body."""
        above = [self.parents[top]] if self.parents[top] >= 0 else []
        for node in [*above, *joints]:
            negative = node in joints and min(self.nodes[node].get("scale", [1.0])) < 0.0
            if negative or float(np.linalg.det(self.world[node][:3, :3])) <= 0.0:
                raise self.fault(
                    f"node {self.name(node)} is mirrored or flat (negative scale or zero); "
                    "apply the scale in the program it is from"
                )
        for node in above:
            sizes = np.linalg.svd(self.world[node][:3, :3], compute_uv=False)
            if sizes[0] > UNEVEN * sizes[-1]:
                raise self.fault(
                    f"node {self.name(node)}, above the skeleton, is scaled unevenly ({sizes[0] / sizes[-1]:.2f} "
                    "times as much along one axis); apply the scale in the program it is from"
                )

    def _main(self, needed: set[int]) -> set[int]:
        """Those of some nodes below the top node with the most; another top node must have less than half as many."""
        tops = list(range(len(self.nodes)))
        for node in self.order:
            if self.parents[node] >= 0:
                tops[node] = tops[self.parents[node]]
        for skin in self.file.items("skins"):
            apart = sorted({tops[node] for node in skin.get("joints", [])})
            if len(apart) > 1:
                names = " and ".join(map(self.name, apart[:2]))
                raise self.fault(
                    f"a skin has joints in {len(apart)} trees, below {names}; expected one skeleton"
                )
        (first, count), *others = Counter(tops[node] for node in needed).most_common()
        if others and 2 * others[0][1] >= count:
            raise self._two(first, others[0][0])
        self._check_skins()
        return {node for node in needed if tops[node] == first}

    def _check_skins(self) -> None:
        """Raise MotionkitError for two skins of different people, by the names of their limbs, below one node."""
        people: list[list[int]] = []  # the nodes down to the lowest that has all joints of a skin
        for skin in self.file.items("skins"):
            paths = [self._path(joint) for joint in skin.get("joints", [])]
            if not LIMBS <= {limb(self.name(path[-1])) for path in paths}:
                continue
            shared = [nodes[0] for nodes in zip(*paths, strict=False) if len(set(nodes)) == 1]
            for other in people:
                apart = next((pair for pair in zip(shared, other, strict=False) if pair[0] != pair[1]), None)
                if apart:
                    raise self._two(*sorted(apart))
            people.append(shared)

    def _path(self, node: int) -> list[int]:
        """The nodes from the top down to a node."""
        path = [node]
        while self.parents[path[-1]] >= 0:
            path.append(self.parents[path[-1]])
        return path[::-1]

    def _two(self, first: int, second: int) -> MotionkitError:
        names = f"{self.name(first)} and {self.name(second)}"
        return self.fault(f"two skeletons, below {names}; expected one character per file")

    def unmoved(self, hips: int) -> bool:
        """Whether there are meshes, and none of them moves with the hips, by a skin or as a part below them."""
        moved = {hips}
        for node in self.order:
            if self.parents[node] in moved:
                moved.add(node)
        with_mesh = [node for node, entry in enumerate(self.nodes) if "mesh" in entry]
        return bool(with_mesh) and not any("skin" in self.nodes[node] or node in moved for node in with_mesh)

    def vertices(self) -> Iterator[tuple[dict[str, Any], Array, Array, Array]]:
        """Of each part of a mesh with a skin: the skin, places (N, 3), which of its joints (N, 4), and weights (N, 4).

        Raises:
            MotionkitError: they are compressed, or damaged where an animation does not need them.
        """
        for entry in self.nodes:
            if "mesh" not in entry or "skin" not in entry:
                continue
            skin, mesh = self.file.item("skins", entry["skin"]), self.file.item("meshes", entry["mesh"])
            joints, parts = self.indices(skin.get("joints"), "joints of a skin"), mesh.get("primitives")
            for part in parts if isinstance(parts, list) else []:
                attributes = part.get("attributes") if isinstance(part, dict) else None
                if not isinstance(attributes, dict):
                    raise self.fault("a mesh has a part without attributes")
                places, weights = (
                    self.file.array(attributes.get(name), width)
                    for name, width in (("POSITION", 3), ("WEIGHTS_0", 4))
                )
                which = self.file.whole_numbers(attributes.get("JOINTS_0"), 4)
                if len({len(places), len(weights), len(which)}) > 1 or which.max() >= len(joints):
                    raise self.fault("a mesh whose vertices are bound to joints that its skin does not have")
                yield (
                    skin,
                    places,
                    which,
                    weights.astype(np.float64),
                )  # whose sum is finite, however large they are

    def shares(self, *groups: set[int]) -> Doubles:
        """The shares (N, G) of groups of nodes in how each vertex moves, as far as meshes can be read."""
        out = [np.zeros((0, len(groups)))]
        with contextlib.suppress(MotionkitError):
            for skin, _, which, weights in self.vertices():
                nodes = np.array(skin["joints"])[which]
                parts = [(weights * np.isin(nodes, list(group))).sum(axis=1) for group in groups]
                whole = np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)
                out.append(np.stack(parts, axis=1) / whole)
        return np.concatenate(out)

    def names(self, nodes: list[int]) -> tuple[str, ...]:
        """Unique names of joints that a BVH file can hold."""
        return joint_names(map(self.name, nodes), MAX_NAME)


def _apart(one: Doubles, other: Doubles) -> tuple[float, float]:
    """Degrees and distance between two transforms; the degrees are infinite where their scales differ."""
    change = np.linalg.inv(one) @ other
    size = float(abs(np.linalg.det(change[:3, :3]))) ** (1.0 / 3.0)
    if not 0.98 < size < 1.02:
        return math.inf, math.inf
    turn = math.degrees(math.acos(min(1.0, max(-1.0, (float(np.trace(change[:3, :3])) / size - 1.0) / 2.0))))
    return turn, float(np.linalg.norm(change[:3, 3]))
