"""Reads rigs, their motions, and motions to put on them, from files of any kind."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import SkeletonError
from motionkit.motion.bvh import bvh_to_motion
from motionkit.motion.floor import floor_height, foot_positions
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import STANDING_HEIGHTS, canonical_skeleton, leg_length
from motionkit.reading import tell
from motionkit.rig.built_in import rig_file
from motionkit.rig.character import read_character
from motionkit.rig.map_file import read_rig_map
from motionkit.rig.pose import map_file
from motionkit.rig.read_file import is_gltf, read_file
from motionkit.rig.retarget import RetargetReport, retarget
from motionkit.rig.rig import Rig, make_rig, read_joints_rig, top_joint
from motionkit.rig.to_rig import rig_bvh

NO_RIGS = (".vrma", ".gltf", ".usd", ".usda", ".usdc", ".usdz")  # known, but not read


def read_rig(path: str | Path, map_path: str | Path | None = None) -> Rig:
    """Read a rig from any file that holds one (rig/read_file.py).

    Args:
        path: the file, or @NAME for a built-in rig. If the rest pose of a BVH file does not stand, one of its frames
            must.
        map_path: bone map (rig/map_file.py); by default an avatar's bone table, or names and shape.

    Raises:
        MotionkitError: the file or the map cannot be used, or the rig is not a human one.
    """
    path = rig_file(path)
    ending = path.suffix.lower()
    if ending in NO_RIGS:
        raise SkeletonError(f"{path}: expected a rig, such as a .bvh, .glb or .vrm file, found {ending}")
    if not is_gltf(path):
        return read_joints_rig(path, map_path)
    found = read_character(path)
    joints = None if map_path is None else read_rig_map(map_path, found.skeleton)
    try:
        joints = joints or map_file(found.bvh({0}))
        if found.tree.unmoved(found.nodes[joints.places["Hips"]]):
            tell(path, ("meshes that no skin binds to its bones, so they will not move",))
        bvh = found.bvh({0, top_joint(found.skeleton, joints)})
        return replace(make_rig(bvh, Path(path).name, joints), character=found)
    except SkeletonError as error:
        raise SkeletonError(f"{path}: {error}") from None


def from_rig(motion: Motion, rig: Rig) -> Motion:
    """Convert a motion on a rig (from finish/on_rig.py) back to the canonical joints, in cm."""
    return retarget(rig_bvh(motion, rig), rig=rig)[0]


def read_clip(path: str | Path, rig: Rig) -> Motion:
    """Read the motion of a file on a rig, in its unit; raises SkeletonError if it has other joints."""
    motion = bvh_to_motion(read_file(path))
    if not motion.skeleton.same_hierarchy(rig.skeleton):
        raise SkeletonError(f"{path}: has other joints than the rig {rig.name}")
    return motion


def read_motion(
    path: str | Path, rig: Rig | None = None, scale: float | None = None
) -> tuple[Motion, RetargetReport]:
    """Read a file of any human rig as a motion on the canonical joints, with standing toes on the floor.

    Args:
        path: the file.
        rig: its rig, if known; found by default.
        scale: cm per file unit; detected by default.

    Raises:
        BvhError, SkeletonError: the file cannot be read, or its rig is not a human one.
    """
    bvh = read_file(path)
    try:
        motion, report = retarget(bvh, scale, rig=rig)
    except SkeletonError as error:
        raise SkeletonError(f"{path}: {error}") from None
    return on_the_floor(motion), report


def on_the_floor(motion: Motion) -> Motion:
    """A motion on the canonical joints, moved up or down so that its standing toes are at their height."""
    floor = floor_height(foot_positions(canonical_places(motion)), motion.fps)
    up = np.array([0.0, STANDING_HEIGHTS[1] - floor, 0.0], motion.root_positions.dtype)
    return replace(motion, root_positions=motion.root_positions + up)


def read_on_any_rig(
    path: str | Path, target: Rig | None = None, scale: float | None = None
) -> tuple[Motion, RetargetReport]:
    """Like read_motion; a file on the target rig is read with that rig's joint map, up axis and rest pose."""
    own = target is not None and target.same_rest(read_file(path).skeleton)
    return read_motion(path, target if own else None, scale)


def canonical_places(motion: Motion) -> Array:
    """Joint positions (T, 23, 3) of a motion, scaled to canonical leg length."""
    share = leg_length(canonical_skeleton()) / leg_length(motion.skeleton)
    return motion_kinematics(motion)[1] * share
