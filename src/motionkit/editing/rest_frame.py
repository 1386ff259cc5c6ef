"""The rest pose of a written motion: as its first frame, by which older importers know a rig, or another one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motionkit.motion.bvh import motion_to_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    quat_between,
    quat_continuous,
    quat_identity,
    quat_inverse,
    quat_multiply,
    quat_rotate,
)
from motionkit.motion.skeleton import STANDING_HEIGHTS, canonical_skeleton
from motionkit.rig.rest_pose import SIDES, SourceRig, body_frame, is_standing
from motionkit.rig.retarget import to_local
from motionkit.rig.rig import Rig, make_rig, stance_part
from motionkit.rig.soles import read_soles
from motionkit.rig.standing_pose import standing_turns
from motionkit.rig.to_rig import carry, standing_height, to_rig
from motionkit.rig.up_axis import up_turn


def with_rest_frame(motion: Motion, rig: Rig | None = None, name: str = "file") -> Motion:
    """The motion with one more frame before it: the rest pose, standing where the motion begins.

    Args:
        motion: T frames on a human rig.
        rig: its rig, if known. If its rest pose is no standing human, the frame is a T-pose.
        name: "file" for the rest pose of the rig, or one of rig/standing_pose.py's ARMS.

    Returns:
        T + 1 frames.

    Raises:
        SkeletonError: the rig is not a human one.
    """
    rig = rig or make_rig(motion_to_bvh(motion), "the motion")
    pose = _rest_pose(rig, motion.fps) if name == "file" else _standing(name, rig, motion.fps)
    rest = _at(pose, motion.cut(0, 1), rig)
    moves = motion.local_positions
    assert rest.local_positions is not None
    return replace(
        motion,
        local_rotations=np.concatenate([rest.local_rotations, motion.local_rotations]),
        root_positions=np.concatenate([rest.root_positions, motion.root_positions]),
        local_positions=None if moves is None else np.concatenate([rest.local_positions, moves]),
    )


def with_rest_pose(motion: Motion, name: str, rig: Rig | None = None) -> Motion:
    """The same motion on joints whose rest pose, the one without rotations, is a standing pose.

    Args:
        motion: on a human rig.
        name: one of rig/standing_pose.py's ARMS.
        rig: its rig, if known.

    Raises:
        SkeletonError: the rig is not a human one.
    """
    rig = rig or make_rig(motion_to_bvh(motion), "the motion")
    skeleton, turns = motion.skeleton, motion_kinematics(_standing(name, rig, motion.fps))[0][0]
    parents = list(skeleton.parents)
    above = np.where(np.array(parents)[:, None] < 0, quat_identity(()), turns[parents])
    offsets = quat_rotate(above, skeleton.offsets)
    ends = {}
    for joint, end in skeleton.end_sites.items():
        x, y, z = quat_rotate(turns[joint], np.array(end, np.float32))
        ends[joint] = (float(x), float(y), float(z))
    with_final_rest = replace(skeleton, offsets=offsets, end_sites=ends)
    moves = motion.local_positions
    local = quat_multiply(quat_multiply(above, motion.local_rotations), quat_inverse(turns))
    return replace(
        motion,
        skeleton=with_final_rest,
        local_rotations=quat_continuous(local),
        local_positions=None
        if moves is None
        else quat_rotate(np.broadcast_to(above, (*moves.shape[:2], 4)), moves),
    )


def _standing(name: str, rig: Rig, fps: float) -> Motion:
    """One frame of a rig in a standing pose."""
    turns = to_local(standing_turns(name)[None])
    return to_rig(Motion(canonical_skeleton(), turns, np.zeros((1, 3), np.float32), fps), rig)


def _rest_pose(rig: Rig, fps: float) -> Motion:
    """One frame of the rest pose, or of a T-pose."""
    skeleton, source = rig.skeleton, SourceRig(rig.skeleton, rig.joints, rig.skeleton.rest_positions())
    frame = body_frame(source)
    if is_standing(source, frame):
        still = quat_identity((1, len(skeleton)))
        # The rest pose may stand along another axis than the motion.
        stood = quat_rotate(frame, np.array([0.0, 1.0, 0.0]))
        turn = quat_between(stood, rig.up.astype(np.float64))
        still[0, 0] = turn
        place = quat_rotate(turn, skeleton.offsets[:1].astype(np.float64))
        return Motion(skeleton, still, place.astype(np.float32), fps)
    return _standing("tpose", rig, fps)


def _at(rest: Motion, first: Motion, rig: Rig) -> Motion:
    """A pose moved so that its feet stand on the floor, below the hips of the first frame."""
    up = up_turn(rig.up)
    turns, places = motion_kinematics(rest)
    here, there = (quat_rotate(up, points[0]) for points in (places, motion_kinematics(first)[1]))
    hips, part = rig.joints.places["Hips"], stance_part(rig.joints)
    shift = there[hips] - here[hips]
    usual, soles = standing_height(rig, STANDING_HEIGHTS[part == "ToeBase"]), read_soles(rig)
    depths = [usual, usual] if soles is None else [sole.depth for sole in soles]
    feet = [rig.place(f"{side}{part}") for side in SIDES]
    lowest = [
        here[foot, 1] - depth / rig.scale
        for foot, depth in zip(feet, depths, strict=True)
        if foot is not None
    ]
    shift[1] = -min(lowest, default=0.0)
    shift = quat_rotate(quat_inverse(up), shift)
    moved = (
        np.repeat(rig.skeleton.offsets[None], 1, axis=0)
        if rest.local_positions is None
        else rest.local_positions
    )
    moved = moved.astype(np.float32).copy()
    moved[:, 0] = rest.root_positions
    carry(rig, moved, turns, shift[None])
    return replace(rest, root_positions=moved[:, 0], local_positions=moved)
