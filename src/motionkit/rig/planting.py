"""Puts feet where a source body has them, because a leg of other proportions slides where that one stands.

Retargeting copies directions of bones. Where hips are wider or feet longer than those of the source, a foot that
stands there moves here, up to twice as far. Only the way over the ground is corrected; heights are those of the legs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motionkit.arrays import Array, length
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.leg_ik import ANKLES, TOES, move_feet
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_identity, quat_normalize, quat_to_matrix

MAX_SHIFT = 15.0  # cm; feet further from those of the source are moved by this much only


def plant_feet(motion: Motion, part: str, places: Array) -> Motion:
    """Move the feet of a motion over the ground to given places.

    Args:
        motion: T frames on the canonical joints, in cm.
        part: "ToeBase" or "Foot", the joint whose places are given.
        places: (T, 2, 3) where the left and the right one are to be, in cm; heights are not used.

    Returns:
        The motion with changed leg rotations.
    """
    turns, positions = motion_kinematics(motion)
    shifts = places - positions[:, TOES if part == "ToeBase" else ANKLES]
    shifts[..., 1] = 0.0
    far = length(shifts)[..., None]
    shifts = shifts * np.minimum(1.0, MAX_SHIFT / np.maximum(far, 1e-6))
    rotations = motion.local_rotations.copy()
    level = quat_identity((len(motion), 2))  # the feet keep their own pitch
    move_feet(rotations, positions, quat_to_matrix(turns), level, shifts.astype(positions.dtype))
    return replace(motion, local_rotations=quat_normalize(rotations))
