"""The soles of a character, from the vertices of its own meshes: what of its feet touches the floor."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

import numpy as np

from motionkit.arrays import Array, Doubles
from motionkit.errors import MotionkitError
from motionkit.motion.rotations import quat_inverse, quat_rotate
from motionkit.motion.skeleton import JOINT_NAMES, STANDING_HEIGHTS, Skeleton, canonical_skeleton, leg_length
from motionkit.rig.character import Character
from motionkit.rig.gltf_nodes import GltfNodes
from motionkit.rig.rest_pose import SIDES
from motionkit.rig.rig import PLAUSIBLE_STANCE, Rig, stance_part
from motionkit.rig.to_rig import rig_body

_PITCHES, _ROLLS = np.radians(np.arange(-60.0, 61.0, 5.0)), np.radians(np.arange(-45.0, 46.0, 5.0))
MOST_POINTS = len(_PITCHES) * len(_ROLLS)  # most points of a part of a sole
_BODY = Path(__file__).parents[1] / "assets/bodies/soles.json"  # written by docs/make_body.py
_MARGIN = 0.5  # cm by which the least depth of a sole below its joint is lower than a plausible stance


@dataclass(frozen=True, eq=False)
class Sole:
    """The lowest points of a foot at any tilt, in cm and axes of the rig's body.

    They are relative to the toe joint; to the ankle if no vertices move with toes.

    Attributes:
        foot: (N, 3) points that turn with the foot.
        toe: (M, 3) points that turn with the toes.
        depth: how far the sole is below the joint in the rest pose.
        toe_height: height of the toe joint of a standing foot over the floor.
    """

    foot: Array
    toe: Array
    depth: float
    toe_height: float

    def scaled(self, factor: float) -> Sole:
        """The same sole with every length multiplied by a factor."""
        return Sole(self.foot * factor, self.toe * factor, self.depth * factor, self.toe_height * factor)


@dataclass(frozen=True, eq=False)
class LiveSoles:
    """The soles of a live character, and the height in cm of the floor that they stand on in the kernels' world."""

    left: Sole
    right: Sole
    floor: float


def body_soles(skeleton: Skeleton) -> tuple[Sole, Sole]:
    """The left and right sole of the body that motionkit shows on the canonical joints, for legs of a skeleton."""
    size = leg_length(skeleton) / leg_length(canonical_skeleton())
    left, right = _stored_soles()
    return left.scaled(size), right.scaled(size)


@cache
def _stored_soles() -> tuple[Sole, Sole]:
    stored = json.loads(_BODY.read_text())
    foot, toe = (np.array(stored[part], np.float32) for part in ("foot", "toe"))
    mirror = np.array([-1.0, 1.0, 1.0], np.float32)
    heights = stored["depth"], STANDING_HEIGHTS[1]  # toes of the body swing as high as recorded ones
    return Sole(foot, toe, *heights), Sole(foot * mirror, toe * mirror, *heights)


@lru_cache(maxsize=4)  # every motion of a rig asks, to be finished and to be measured
def read_soles(rig: Rig) -> tuple[Sole, Sole] | None:
    """The left and right sole of a rig; None if it has no character, or its file does not show them.

    Meshes may be compressed, or be no feet (a robe); then the joints alone give the floor.
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
    points = (points - character.tree.rest_world[nodes[anchor]][:3, 3]) * rig.scale
    upright, flat = (
        quat_inverse(rig.differences[JOINT_NAMES.index(name)]).astype(np.float64)
        for name in ("Hips", f"{side}Foot")
    )
    depth = -float(quat_rotate(upright, points)[:, 1].min())
    low, high = PLAUSIBLE_STANCE[part]
    if not low - _MARGIN <= depth <= high:
        return None
    toe_height = depth
    if part == "Foot":
        toe = rig_body(rig).offsets[JOINT_NAMES.index(f"{side}ToeBase")].astype(np.float64)
        toe_height += float(quat_rotate(upright, quat_rotate(quat_inverse(flat), toe))[1])
    moving = shares >= 0.5
    if not moving.any():
        points += (character.tree.rest_world[nodes[anchor]] - character.tree.rest_world[nodes[ankle]])[
            :3, 3
        ] * rig.scale
    points = quat_rotate(flat, points)
    return Sole(outermost(points[~moving]), outermost(points[moving]), depth, toe_height)


def outermost(points: Doubles) -> Array:
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
    points, shares = [np.zeros((0, 3))], [np.zeros(0)]
    for skin, places, which, weights in tree.vertices():
        joints = np.array(skin["joints"])
        moved = np.stack([tree.rest_world[joint] for joint in joints])
        if "inverseBindMatrices" in skin:
            binds = tree.file.array(skin["inverseBindMatrices"], 16).reshape(-1, 4, 4).swapaxes(1, 2)
            if len(binds) < len(moved):
                raise tree.fault(f"a skin has {len(binds)} matrices for {len(moved)} joints")
            moved = moved @ binds[: len(moved)]
        mine = (weights * np.isin(joints[which], feet)).sum(axis=1) > 0.5 * weights.sum(axis=1)
        places, weights, which = places[mine].astype(np.float64), weights[mine], which[mine]
        weights = weights / weights.sum(axis=1, keepdims=True)
        turned = np.einsum("vjab,vb->vja", moved[which, :3, :3], places) + moved[which, :3, 3]
        points.append(np.einsum("vj,vja->va", weights, turned))
        shares.append((weights * np.isin(joints[which], toes)).sum(axis=1))
    return np.concatenate(points), np.concatenate(shares)
