"""Moves feet after retargeting to where the source has them, because legs of other proportions slide.

Retargeting copies the directions of bones. If hips are wider or feet longer than on the source, a foot that stands
there slides here. Only the position over the ground is corrected; heights stay.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motionkit.arrays import Array, length
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.leg_ik import ANKLES, TOES, move_feet
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_identity, quat_normalize, quat_to_matrix

MAX_SHIFT = 15.0  # cm; largest shift of a foot


def plant_feet(motion: Motion, part: str, places: Array) -> Motion:
    """Move the feet of a motion on the canonical joints, in cm, over the ground to given places.

    part is the joint to move, "ToeBase" or "Foot", places (T, 2, 3) the targets of the left and the right one in cm,
    whose heights are not used. Only rotations of the legs change.
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
