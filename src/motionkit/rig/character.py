"""A user's character, a .glb or .vrm file with its joints: converts between its own axes and those of a Motion.

The skeleton of a character has identity rotations in its rest pose, as BVH needs, and its joints where the nodes are,
in metres with Y up. Nodes have any rest rotations, and scaled nodes above them: a local rotation of the motion is
turned into the axes of the node's parent, and applied to the rest rotation of the node.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.arrays import Array, Doubles
from motionkit.motion.bvh import POSITION_CHANNELS, ROTATION_ORDER, BvhFile
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    matrix_to_quat,
    quat_continuous,
    quat_inverse,
    quat_multiply,
    quat_normalize,
)
from motionkit.motion.skeleton import Skeleton
from motionkit.rig.fbx import ENDING as FBX
from motionkit.rig.gltf import GltfFile
from motionkit.rig.gltf_nodes import GltfNodes

_SAME = 1e-3  # share of its size by which a skeleton may differ from that of the character
_STILL = 2e-6  # radians, and metres, within which a joint counts as in its rest pose


@dataclass(frozen=True, eq=False)
class Character:
    """A .glb or .vrm file and the joints of its character.

    Attributes:
        tree: the file and its nodes.
        nodes: the node of each joint.
        skeleton: the joints, in metres; the root's offset is its place in the world.
        under: whether the first joint of a rig goes along under the hips: over the ground, and up with them but not
            down.
    """

    tree: GltfNodes
    nodes: tuple[int, ...]
    skeleton: Skeleton
    under: bool = False

    @property
    def has_mesh(self) -> bool:
        """Whether there is a mesh to see."""
        return bool(self.tree.file.items("meshes"))

    @cached_property
    def outer(self) -> Doubles:
        """(J, 4, 4) rest transforms of the parents of the joints' nodes."""
        parents = [self.tree.parents[node] for node in self.nodes]
        return np.stack([self.tree.rest_world[parent] if parent >= 0 else np.eye(4) for parent in parents])

    @cached_property
    def axes(self) -> Doubles:
        """(J, 4) rest rotations of the parents of the joints' nodes, from their axes to those of the world."""
        return matrix_to_quat(nearest_rotations(self.outer[:, :3, :3]))

    @cached_property
    def rest(self) -> tuple[Doubles, Doubles]:
        """Rest rotations (J, 4) and translations (J, 3) of the nodes."""
        return self._local(self.tree.rest_local)

    @property
    def posed(self) -> bool:
        """Whether the file was saved in another pose than the one its skin is bound in."""
        return self.tree.rest_local is not self.tree.local

    @cached_property
    def pose(self) -> tuple[Doubles, Doubles]:
        """Rotations (J, 4) and translations (J, 3) that the nodes have in the file, where no animation moves them."""
        return self._local(self.tree.local)

    def _local(self, transforms: list[Doubles]) -> tuple[Doubles, Doubles]:
        local = np.stack([transforms[node] for node in self.nodes])
        return matrix_to_quat(nearest_rotations(local[:, :3, :3])), local[:, :3, 3]

    @cached_property
    def turns(self) -> Doubles:
        """(J, 4) rest rotations of the joints' nodes in the world; a node turns as its joint times this."""
        return quat_multiply(self.axes, self.rest[0])

    def bvh(self, movers: set[int]) -> BvhFile:
        """The joints in the rest pose, in metres, as a file of one frame; some joints have position channels."""
        turns, offsets = tuple(f"{axis}rotation" for axis in ROTATION_ORDER), self.skeleton.offsets
        channels = tuple(POSITION_CHANNELS + turns if j in movers else turns for j in range(len(offsets)))
        values = [
            offsets[joint, "XYZ".index(name[0])] if name.endswith("position") else 0.0
            for joint, names in enumerate(channels)
            for name in names
        ]
        return BvhFile(self.skeleton, channels, np.array([values], np.float64), 1.0 / 60.0)

    def motion(self, rotations: Array, translations: dict[int, Array], fps: float) -> Motion:
        """The motion, in metres, of local rotations (T, J, 4) and translations (T, 3) of nodes, by joint."""
        still, axes = self.rest[0], self.axes
        for joint in range(len(self.nodes)):
            turned = quat_multiply(rotations[:, joint], quat_inverse(still[joint]))
            turned = quat_multiply(quat_multiply(axes[joint], turned), quat_inverse(axes[joint]))
            rotations[:, joint] = quat_continuous(quat_normalize(turned))
        places = {joint: values @ self.outer[joint, :3, :3].T for joint, values in translations.items()}
        offsets = self.skeleton.offsets
        root = np.broadcast_to(offsets[0], (len(rotations), 3)).astype(np.float32)
        if 0 in places:
            root = (places.pop(0) + self.outer[0, :3, 3]).astype(np.float32)
        moving = {j: place for j, place in places.items() if np.abs(place - offsets[j]).max() > 1e-5}
        local = None
        if moving:
            local = np.broadcast_to(offsets, (len(rotations), *offsets.shape)).copy()
            local[:, 0] = root
            for joint, place in moving.items():
                local[:, joint] = place
        return Motion(self.skeleton, rotations, root, fps, local)

    def holds(self, motion: Motion) -> bool:
        """Whether a motion is on this skeleton, in any unit."""
        skeleton, other = self.skeleton, motion.skeleton
        if skeleton.names != other.names or skeleton.parents != other.parents:
            return False
        near = _SAME * float(np.abs(skeleton.offsets[1:]).max(initial=1e-9))
        return bool(
            np.abs(other.offsets[1:] * self.metres(motion) - skeleton.offsets[1:]).max(initial=0.0) <= near
        )

    def metres(self, motion: Motion) -> float:
        """Metres, as the file has them, per unit of a motion on this skeleton."""
        ours, theirs = (float(np.abs(s.offsets[1:]).sum()) for s in (self.skeleton, motion.skeleton))
        return ours / theirs if theirs else 1.0

    def tracks(self, motion: Motion) -> list[tuple[int, str, Array]]:
        """Node, path, values (T, 3) or x, y, z, w (T, 4) of all that leaves the file's pose, for a motion it holds."""
        unit = self.metres(motion)
        motion = motion if abs(unit - 1.0) < 1e-6 else motion.scaled(unit)
        out: list[tuple[int, str, Array]] = []
        (turns, rest), (posed, places), frames = self.rest, self.pose, len(motion)
        for joint, node in enumerate(self.nodes):
            outer = self.outer[joint, :3, :3]
            moved = np.tile(rest[joint] @ outer.T, (frames, 1)) if self.posed else None
            if joint == 0:
                moved = motion.root_positions - self.outer[0, :3, 3]
            elif motion.local_positions is not None:
                moved = motion.local_positions[:, joint]
            if moved is not None:
                moved = moved.astype(np.float64) @ np.linalg.inv(outer).T
                if np.abs((moved - places[joint]) @ outer.T).max() > _STILL:
                    out.append((node, "translation", moved))
            turned = motion.local_rotations[:, joint].astype(np.float64)
            still = (
                float(np.abs(quat_multiply(posed[joint], quat_inverse(turns[joint]))[1:]).max()) <= _STILL / 2
            )
            if joint == 0 or not still or np.abs(turned[:, 1:]).max() > _STILL / 2:
                there = quat_inverse(self.axes[joint])
                turned = quat_multiply(quat_multiply(there, quat_normalize(turned)), self.axes[joint])
                turned = quat_continuous(quat_normalize(quat_multiply(turned, turns[joint])))
                out.append((node, "rotation", np.roll(turned, -1, axis=-1)))
        return out

    def parts(self, nodes: set[int]) -> dict[int, dict[str, Any]]:
        """Translation, rotation and scale of those of some nodes that have a matrix."""
        out = {}
        for node in sorted(nodes):
            if "matrix" not in self.tree.nodes[node]:
                continue
            local = self.tree.local[node]
            turn = nearest_rotations(local[None, :3, :3])[0]
            stretch = turn.T @ local[:3, :3]
            if not np.allclose(stretch, np.diag(np.diag(stretch)), atol=1e-4 * np.abs(stretch).max()):
                raise self.tree.fault(
                    f"the matrix of {self.tree.name(node)} shears, which cannot be animated"
                )
            out[node] = {
                "translation": local[:3, 3].tolist(),
                "rotation": np.roll(matrix_to_quat(turn), -1).tolist(),
                "scale": np.diag(stretch).tolist(),
            }
        return out


def read_character(path: str | Path) -> Character:
    """Read the character of a .glb or .vrm file; raises MotionkitError, naming the file, if it has no usable one."""
    tree = GltfNodes(GltfFile(path))
    table = tree.humanoid()
    nodes = tree.joints(set(table.values()))
    index = {node: joint for joint, node in enumerate(nodes)}
    apart = [name for name, node in table.items() if node not in index]
    if apart:
        raise tree.fault(f"the avatar's bone table has a {apart[0]} that is not part of its skeleton")
    parents = tuple(index.get(tree.parents[node], -1) for node in nodes)
    places = np.stack([tree.rest_world[node][:3, 3] for node in nodes])
    offsets = places - np.stack([places[parent] if parent >= 0 else np.zeros(3) for parent in parents])
    # Units of FBX files are often wrong.
    cm = None if Path(path).suffix.lower() == FBX else 100.0
    ends = _ends(tree, nodes, parents)
    humanoid = {name: index[node] for name, node in table.items()}
    skeleton = Skeleton(tree.names(nodes), parents, offsets.astype(np.float32), ends, cm, "+Y", humanoid)
    return Character(tree, tuple(nodes), skeleton)


def _ends(
    tree: GltfNodes, nodes: list[int], parents: tuple[int, ...]
) -> dict[int, tuple[float, float, float]]:
    """The ends of the last joints, where motionkit wrote them into the file."""
    ends = {}
    for joint in set(range(len(nodes))) - set(parents):
        extras = tree.nodes[nodes[joint]].get("extras")
        end = extras.get("end_site") if isinstance(extras, dict) else None
        if (
            isinstance(end, list)
            and len(end) == 3
            and all(type(v) in (int, float) and abs(v) < 1e6 for v in end)
        ):
            x, y, z = tree.rest_world[nodes[joint]][:3, :3] @ np.array(end, np.float64)
            ends[joint] = (float(x), float(y), float(z))
    return ends


def nearest_rotations(matrices: Array) -> Doubles:
    """The rotations (..., 3, 3) nearest to matrices with a positive determinant: without their scale and shear."""
    left, _, right = np.linalg.svd(matrices.astype(np.float64))
    return left @ right
