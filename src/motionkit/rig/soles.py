"""The soles of a character, from the vertices of its own meshes: what of its feet touches the floor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array, Doubles
from motionkit.errors import MotionkitError
from motionkit.motion.rotations import quat_inverse, quat_rotate
from motionkit.motion.skeleton import JOINT_NAMES
from motionkit.rig.character import Character
from motionkit.rig.gltf_nodes import GltfNodes
from motionkit.rig.rest_pose import SIDES
from motionkit.rig.rig import PLAUSIBLE_STANCE, Rig, stance_part

_PITCHES, _ROLLS = np.radians(np.arange(-60.0, 61.0, 5.0)), np.radians(np.arange(-45.0, 46.0, 5.0))
_MARGIN = 0.5  # cm by which the least depth of a sole below its joint is lower than a plausible stance


@dataclass(frozen=True, eq=False)
class Sole:
    """The lowest points of a foot at any tilt, relative to its toe joint, in cm and axes of the rig's body.

    Attributes:
        foot: (N, 3) points that turn with the foot.
        toe: (M, 3) points that turn with the toes; none if the rig has no toes, and relative to the ankle then.
        depth: how far the sole is below the joint in the rest pose.
    """

    foot: Array
    toe: Array
    depth: float


def read_soles(rig: Rig) -> tuple[Sole, Sole] | None:
    """The left and right sole of a rig; None if it has no character, or its file does not show them.

    Meshes may be compressed, or be no feet (a robe); then the joints alone tell where the floor is.
    """
    if rig.character is None:
        return None
    part = stance_part(rig.joints)
    try:
        soles = [_sole(rig, rig.character, side, part) for side in SIDES]
    except MotionkitError:  # compressed, or damaged where an animation does not need it
        return None
    left, right = soles
    return None if left is None or right is None else (left, right)


def _sole(rig: Rig, character: Character, side: str, part: str) -> Sole | None:
    ankle, anchor = rig.place(f"{side}Foot"), rig.place(f"{side}{part}")
    if ankle is None or anchor is None:
        return None
    skeleton, nodes = rig.skeleton, character.nodes
    joints = [joint for joint in range(len(skeleton)) if skeleton.descends(joint, ankle)]
    toes = [joint for joint in joints if part == "ToeBase" and skeleton.descends(joint, anchor)]
    points, shares = _vertices(character.tree, [nodes[j] for j in joints], [nodes[j] for j in toes])
    if not len(points):
        return None
    points = (points - character.tree.world[nodes[anchor]][:3, 3]) * rig.scale
    upright, flat = (
        quat_inverse(rig.differences[JOINT_NAMES.index(name)]).astype(np.float64)
        for name in ("Hips", f"{side}Foot")
    )
    depth = -float(quat_rotate(upright, points)[:, 1].min())
    low, high = PLAUSIBLE_STANCE[part]
    if not low - _MARGIN <= depth <= high:
        return None
    points, moving = quat_rotate(flat, points), shares >= 0.5
    return Sole(_outermost(points[~moving]), _outermost(points[moving]), depth)


def _outermost(points: Doubles) -> Array:
    """Those of some points (N, 3) that are the lowest at any tilt of a foot."""
    if not len(points):
        return np.zeros((0, 3), np.float32)
    pitch, roll = np.meshgrid(_PITCHES, _ROLLS, indexing="ij")
    down = np.stack([np.sin(roll), np.cos(roll) * np.cos(pitch), np.cos(roll) * np.sin(pitch)], axis=-1)
    lowest = np.unique((points @ down.reshape(-1, 3).T).argmin(axis=0))
    return points[lowest].astype(np.float32)


def _vertices(tree: GltfNodes, feet: list[int], toes: list[int]) -> tuple[Doubles, Doubles]:
    """The vertices (N, 3) of a file's skins, in its rest pose, of which more than half moves with nodes of a foot.

    Returns:
        The vertices, and the share (N,) of the nodes of the toes in how they move.
    """
    file, points, shares = tree.file, [np.zeros((0, 3))], [np.zeros(0)]
    for entry in tree.nodes:
        if "mesh" not in entry or "skin" not in entry:
            continue
        skin = file.item("skins", entry["skin"])
        joints = np.array(tree.indices(skin.get("joints", []), "joints of a skin"))
        moved = np.stack([tree.world[joint] for joint in joints])
        if "inverseBindMatrices" in skin:
            binds = file.array(skin["inverseBindMatrices"], 16).reshape(-1, 4, 4).swapaxes(1, 2)
            moved = moved[: len(binds)] @ binds[: len(moved)]
        for primitive in file.item("meshes", entry["mesh"]).get("primitives", []):
            own = primitive["attributes"]
            places, weights = file.array(own["POSITION"], 3), file.array(own["WEIGHTS_0"], 4)
            which = file.whole_numbers(own["JOINTS_0"], 4)
            if len(which) != len(places) or len(weights) != len(places) or which.max() >= len(moved):
                raise tree.fault("a mesh whose vertices are bound to joints that its skin does not have")
            mine = (weights * np.isin(joints[which], feet)).sum(axis=1) > 0.5 * weights.sum(axis=1)
            places, weights, which = places[mine].astype(np.float64), weights[mine], which[mine]
            weights = weights / weights.sum(axis=1, keepdims=True)
            turned = np.einsum("vjab,vb->vja", moved[which, :3, :3], places) + moved[which, :3, 3]
            points.append(np.einsum("vj,vja->va", weights, turned))
            shares.append((weights * np.isin(joints[which], toes)).sum(axis=1))
    return np.concatenate(points), np.concatenate(shares)
