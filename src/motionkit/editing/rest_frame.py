"""Begins a motion with its rig's rest pose, by which Second Life and older importers know a rig."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motionkit.motion.bvh import motion_to_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_identity, quat_inverse, quat_rotate
from motionkit.motion.skeleton import JOINT_NAMES, STANDING_HEIGHTS, canonical_skeleton
from motionkit.rig.rest_pose import SIDES, SourceRig, body_frame, stands
from motionkit.rig.rig import Rig, make_rig, mover, stance_part
from motionkit.rig.to_rig import standing_height, to_rig
from motionkit.rig.up_axis import up_turn


def with_rest_frame(motion: Motion, rig: Rig | None = None) -> Motion:
    """The motion with one more frame before it: the rest pose, standing where the motion begins.

    Args:
        motion: T frames on a human rig.
        rig: its rig, if known. If its rest pose is no standing human, the frame is a T-pose.

    Returns:
        T + 1 frames.

    Raises:
        SkeletonError: the rig is not a human one.
    """
    rig = rig or make_rig(motion_to_bvh(motion), "the motion")
    rest = _at(_rest_pose(rig, motion.fps), motion.cut(0, 1), rig)
    moves = motion.local_positions
    assert rest.local_positions is not None
    return replace(
        motion,
        local_rotations=np.concatenate([rest.local_rotations, motion.local_rotations]),
        root_positions=np.concatenate([rest.root_positions, motion.root_positions]),
        local_positions=None if moves is None else np.concatenate([rest.local_positions, moves]),
    )


def _rest_pose(rig: Rig, fps: float) -> Motion:
    """One frame of the rest pose, or of a T-pose."""
    skeleton, source = rig.skeleton, SourceRig(rig.skeleton, rig.joints, rig.skeleton.rest_positions())
    if stands(source, body_frame(source)):
        still = quat_identity((1, len(skeleton)))
        return Motion(skeleton, still, skeleton.offsets[:1].astype(np.float32), fps)
    pose = Motion(
        canonical_skeleton(), quat_identity((1, len(JOINT_NAMES))), np.zeros((1, 3), np.float32), fps
    )
    return to_rig(pose, rig)


def _at(rest: Motion, first: Motion, rig: Rig) -> Motion:
    """A pose moved so that its feet stand on the floor, below the hips of the first frame."""
    up = up_turn(rig.up)
    turns, places = motion_kinematics(rest)
    here, there = (quat_rotate(up, points[0]) for points in (places, motion_kinematics(first)[1]))
    hips, part = rig.joints.places["Hips"], stance_part(rig.joints)
    shift = there[hips] - here[hips]
    feet = [joint for side in SIDES if (joint := rig.place(f"{side}{part}")) is not None]
    usual = STANDING_HEIGHTS[part == "ToeBase"]
    shift[1] = standing_height(rig, usual) / rig.scale - min(here[feet, 1], default=0.0)
    shift = quat_rotate(quat_inverse(up), shift)
    joint = mover(rig.skeleton, rig.channels, rig.joints) or 0
    above = rig.skeleton.parents[joint]
    moved = (
        np.repeat(rig.skeleton.offsets[None], 1, axis=0)
        if rest.local_positions is None
        else rest.local_positions
    )
    moved = moved.astype(np.float32).copy()
    moved[:, 0] = rest.root_positions
    moved[:, joint] += shift if above < 0 else quat_rotate(quat_inverse(turns[0, above]), shift)
    return replace(rest, root_positions=moved[:, 0], local_positions=moved)
