"""Reads rigs, their motions, and motions to put on them, from files of any kind."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import SkeletonError, naming
from motionkit.motion.bvh import BvhFile, bvh_to_motion
from motionkit.motion.floor import floor_height, foot_positions
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import STANDING_HEIGHTS, canonical_skeleton, leg_length
from motionkit.reading import report_notes
from motionkit.rig.built_in import rig_file, rig_rate
from motionkit.rig.character import Character, read_character
from motionkit.rig.map_file import read_rig_map
from motionkit.rig.names import RigMap
from motionkit.rig.pose import map_file
from motionkit.rig.read_file import is_gltf, read_file
from motionkit.rig.rest_pose import SIDES
from motionkit.rig.retarget import RetargetReport, retarget, retarget_file
from motionkit.rig.rig import Rig, make_rig, top_joint
from motionkit.rig.to_rig import rig_bvh


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
    if not is_gltf(path):
        bvh = read_file(path)
        joints = None if map_path is None else read_rig_map(map_path, bvh.skeleton)
        with naming(path):
            return replace(make_rig(bvh, path.name, joints), fps=rig_rate(path))
    found = read_character(path)
    joints = None if map_path is None else read_rig_map(map_path, found.skeleton)
    with naming(path):
        joints = joints or map_file(found.bvh({0}))
        if found.tree.unmoved(found.nodes[joints.places["Hips"]]):
            report_notes(path, ("meshes that no skin binds to its bones, so they will not move",))
        whole, under = _along(found, joints)
        bvh = found.bvh({0} if whole else {0, top_joint(found.skeleton, joints)})
        return replace(make_rig(bvh, path.name, joints), character=replace(found, under=under))


def _along(found: Character, joints: RigMap) -> tuple[bool, bool]:
    """Whether the first joint goes wherever the hips go, and whether it goes along under them (Character.under).

    Skin of the root bone, or of a prop below it, would stay behind if the hips alone moved. If it is skin of feet, as
    some percent of a heel may be by mistake, a root that sinks with the hips would press it through the floor.
    """
    skeleton, top = found.skeleton, top_joint(found.skeleton, joints)
    ankles = [joint for side in SIDES if (joint := joints.places.get(f"{side}Foot")) is not None]
    beside, feet = (
        {node for joint, node in enumerate(found.nodes) if is_one(joint)}
        for is_one in (
            lambda joint: not skeleton.descends(joint, top),
            lambda joint: any(skeleton.descends(joint, ankle) for ankle in ankles),
        )
    )
    shares = found.tree.shares(beside, feet)
    of_feet = shares[shares[:, 0] > 0.0, 1] > 0.5
    return bool(len(of_feet)) and not of_feet.all(), bool(len(of_feet)) and bool(of_feet.all())


def from_rig(motion: Motion, rig: Rig) -> Motion:
    """Convert a motion on a rig (from finish/on_rig.py) back to the canonical joints, in cm."""
    return retarget(rig_bvh(motion, rig), rig=rig)[0]


def read_clip(path: str | Path, rig: Rig) -> Motion:
    """Read the motion of a file on a rig, in its unit; raises SkeletonError if it has other joints."""
    motion = bvh_to_motion(read_file(path))
    if not motion.skeleton.same_hierarchy(rig.skeleton):
        raise SkeletonError(f"{path}: has other joints than the rig {rig.name}")
    return motion


def canonical_on_floor(bvh: BvhFile, rig: Rig | None = None) -> tuple[Motion, RetargetReport]:
    """The motion of a file of any human rig on the canonical joints, with standing toes on the floor.

    The rig is found if it is not known. Raises SkeletonError if it is not a human one, or has other joints than the
    file.
    """
    motion, report = retarget(bvh, rig=rig)
    return on_the_floor(motion), report


def file_on_floor(path: str | Path, clip: str | None = None) -> Motion:
    """The motion of a file of any human rig on the canonical joints, with standing toes on the floor.

    Raises MotionkitError for a file that cannot be used; clip as for read_file.
    """
    return on_the_floor(retarget_file(path, clip=clip)[0])


def on_the_floor(motion: Motion) -> Motion:
    """A motion on the canonical joints, moved up or down so that its standing toes are at their height."""
    floor = floor_height(foot_positions(canonical_places(motion)), motion.fps)
    up = np.array([0.0, STANDING_HEIGHTS[1] - floor, 0.0], motion.root_positions.dtype)
    return replace(motion, root_positions=motion.root_positions + up)


def canonical_for(bvh: BvhFile, target: Rig | None) -> tuple[Motion, RetargetReport]:
    """Like canonical_on_floor; a file on the target rig is read with that rig's joint map, up axis and rest pose."""
    same_rest = target is not None and target.same_rest(bvh.skeleton)
    return canonical_on_floor(bvh, target if same_rest else None)


def canonical_places(motion: Motion) -> Array:
    """Joint positions (T, 23, 3) of a motion, scaled to canonical leg length."""
    share = leg_length(canonical_skeleton()) / leg_length(motion.skeleton)
    return motion_kinematics(motion)[1] * share
