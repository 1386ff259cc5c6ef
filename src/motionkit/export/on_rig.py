"""Any motion on a user's rig, its feet on the floor: what --rig and `motionkit retarget` write."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import SkeletonError
from motionkit.features.contacts import foot_contacts
from motionkit.metrics.ground import floor_height, foot_positions
from motionkit.motion.bvh import BvhFile, bvh_to_motion, read_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion, resample
from motionkit.motion.retarget import RetargetReport, retarget
from motionkit.motion.rig import Rig
from motionkit.motion.skeleton import STANDING_HEIGHTS, canonical_skeleton, leg_length
from motionkit.motion.to_rig import rig_bvh, to_rig


def on_rig(motion: Motion, rig: Rig, ik: bool = True, clip: Motion | None = None) -> BvhFile:
    """A motion on a rig, as the contents of a BVH file with the rig's hierarchy, channels, unit and axes.

    Args:
        motion: on the canonical joints, in cm, the floor at height zero.
        rig: from read_rig.
        ik: hold the feet of the rig still while those of the motion touch the floor.
        clip: motion of the rig, whose other joints (fingers, props) move as they do there; from read_clip.

    Raises:
        SkeletonError: clip has other joints than the rig.
    """
    if clip is not None:
        clip = resample(clip, motion.fps)
    contacts = foot_contacts(_places(motion), motion.fps) if ik else None
    return rig_bvh(to_rig(motion, rig, contacts, clip), rig)


def read_clip(path: str | Path, rig: Rig) -> Motion:
    """The motion of a BVH file on a rig; raises SkeletonError if it has other joints."""
    motion = bvh_to_motion(read_bvh(path))
    if not motion.skeleton.same_hierarchy(rig.skeleton):
        raise SkeletonError(f"{path}: has other joints than the rig {rig.name}")
    return motion


def read_motion(
    path: str | Path, rig: Rig | None = None, scale: float | None = None
) -> tuple[Motion, RetargetReport]:
    """A BVH file of any human rig as a motion to put on a rig: canonical joints, its standing toes on the floor.

    Args:
        path: the file.
        rig: what is known of its rig; found by default.
        scale: cm per file unit; detected by default.

    Raises:
        BvhError, SkeletonError: the file cannot be read, or its rig is not a human one.
    """
    bvh = read_bvh(path)
    try:
        motion, report = retarget(bvh, scale, rig=rig)
    except SkeletonError as error:
        raise SkeletonError(f"{path}: {error}") from None
    floor = floor_height(foot_positions(_places(motion)), motion.fps)
    up = np.array([0.0, STANDING_HEIGHTS[1] - floor, 0.0], motion.root_positions.dtype)
    return replace(motion, root_positions=motion.root_positions + up), report


def read_on_any_rig(
    path: str | Path, target: Rig | None = None, scale: float | None = None
) -> tuple[Motion, RetargetReport]:
    """As read_motion; a file on the target rig itself is read with what is known of that rig."""
    own = target is not None and target.same_rest(read_bvh(path).skeleton)
    return read_motion(path, target if own else None, scale)


def _places(motion: Motion) -> Array:
    """Joint positions (T, 23, 3) of a motion whose lengths are scaled to canonical legs."""
    share = leg_length(canonical_skeleton()) / leg_length(motion.skeleton)
    return motion_kinematics(motion)[1] * share
