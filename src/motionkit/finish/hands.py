"""Bends wrists so that fingers lie on the ground: hands that bear the body would stick through it.

The network's joints end at the wrists, and recordings turn hands hardly at all. Characters have fingers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motionkit.arrays import Array, cross, smoothed, spans
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    expmap_to_quat,
    quat_inverse,
    quat_multiply,
    quat_normalize,
    quat_rotate,
    wrap_angle,
)
from motionkit.motion.skeleton import JOINT_NAMES, PARENTS

HANDS = tuple(JOINT_NAMES.index(name) for name in ("LeftHand", "RightHand"))
FINGERS = 2.25  # distance from wrist to finger tips, relative to the end site of the hand joint; measured
THICKNESS = 1.5  # cm; height of finger tips that lie on the ground; chosen
FURTHEST = np.radians(100.0)  # largest bend; wrists bend by about 80 degrees, and fingers by the rest; chosen
SMOOTH_FRAMES = 3  # frames to both sides over which a bend is averaged; chosen
BACK = 1.5  # a bend towards the palm costs so many times as much as one towards the back of the hand; chosen


def fingers_above(motion: Motion) -> Motion:
    """Bend the wrists of hands whose fingers would be below the ground, by the smallest angle that lifts them out.

    Args:
        motion: T frames on the canonical joints, in cm, the ground at height zero.
    """
    turns, positions = motion_kinematics(motion)
    rotations = motion.local_rotations.copy()
    for hand in HANDS:
        end = np.array(motion.skeleton.end_sites.get(hand, (0.0, 0.0, 0.0)))
        size = float(np.linalg.norm(end)) * FINGERS
        if not size:
            continue
        turned = turns[:, hand].astype(np.float64)
        along = quat_rotate(turned, end / np.linalg.norm(end))
        across = cross(along, quat_rotate(turned, np.array([0.0, 1.0, 0.0])))
        across /= np.linalg.norm(across, axis=-1, keepdims=True)
        back = cross(across, along)
        angles = _bends(along[:, 1], back[:, 1], (positions[:, hand, 1] - THICKNESS) / size)
        if not angles.any():
            continue
        bent = quat_multiply(expmap_to_quat(angles[:, None] * across), turned)
        above = turns[:, PARENTS[hand]].astype(np.float64)
        local = quat_normalize(quat_multiply(quat_inverse(above), bent))
        rotations[:, hand] = np.where(angles[:, None], local, rotations[:, hand])
    return replace(motion, local_rotations=rotations)


def _bends(along: Array, back: Array, height: Array) -> Array:
    """Angles (T,) towards the back of the hand at which fingers just reach the ground; 0 where they are above it.

    A hand bends one way for as long as it is near the ground.

    Args:
        along, back: (T,) vertical components of the directions of the fingers and of the back of the hand.
        height: (T,) height of the wrist above the place of finger tips on the ground, relative to the fingers' length.
    """
    reach = np.hypot(along, back)
    to_back = np.arctan2(back, along)  # angle at which the fingers point up most
    slope = np.arccos(np.clip(-np.maximum(height, 0.0) / np.maximum(reach, 1e-6), -1.0, 1.0))
    below = along < -np.maximum(height, 0.0)
    angles = np.zeros(len(along))
    for start, end in spans(below):
        # The fingers are level where their angle is `slope` to one or the other side of straight up.
        turns = [wrap_angle(to_back[start:end] + side * slope[start:end]) for side in (-1.0, 1.0)]
        costs = [np.where(turn >= 0.0, turn, -BACK * turn).sum() for turn in turns]
        angles[start:end] = turns[int(np.argmin(costs))]
    return smoothed(np.clip(angles, -FURTHEST, FURTHEST)[:, None], SMOOTH_FRAMES)[:, 0]
