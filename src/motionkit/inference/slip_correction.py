"""Root-slip correction: feet that stand hold the root.

A frame says twice where its feet go over the ground: by the pose, and by the root's velocities. Both are drawn from
Gaussians of their own, and where a reference was recorded on another trajectory than the one asked for, they disagree:
feet slide. Part of that slide is subtracted from the root's velocities here, and so from the frame that the network
sees next. No joint is turned; foot locking does that afterwards, and holds the root by the same weights
(motion/leg_ik.py). frame_kernel.c and export/onnx_slip_correction.py do the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import Floats
from motionkit.features.layout import feature_layout
from motionkit.motion.leg_ik import FOOT_SHARES, foot_weights
from motionkit.motion.skeleton import FOOT_JOINTS

Doubles = NDArray[np.float64]

# Foot joints hold where they are low: fully at FLOOR cm, not at all so many cm higher; in the order of FOOT_JOINTS.
FLOOR = 2.2
REACHES = (10.85, 1.55, 10.85, 1.55)
STIFFNESS = 60.0  # cm^2; the farther apart what holds is beside its root, the more it turns the body
# cm in a frame of which only half is taken out, and ever less of more: what is so far off is a step.
LIMIT = 0.5


def foot_columns(layout: str) -> NDArray[np.intp]:
    """Columns (4, 3) of the positions of the foot joints."""
    columns = {(c.block, c.joint, c.component): i for i, c in enumerate(feature_layout(layout).columns)}
    return np.array([[columns["joint_positions", joint, k] for k in range(3)] for joint in FOOT_JOINTS])


def standing_move(feet: Floats, before: Floats, turn: Floats, step: Floats) -> tuple[Doubles, Doubles]:
    """What to add to the turn (B,) and the step (B, 2) of the root, so that feet on the ground stay there.

    In double precision, so that it gives what frame_kernel.c gives.

    Args:
        feet, before: (B, 4, 3) foot joints of a frame and of the one before, each in its heading frame, cm.
        turn: (B,) of the heading since then, radians.
        step: (B, 2) of the root along x and z of the later heading frame, cm.
    """
    (x, y, z), (x_before, _, z_before) = (np.moveaxis(a.astype(np.float64), -1, 0) for a in (feet, before))
    sine, cosine = (f(turn.astype(np.float64))[:, None] for f in (np.sin, np.cos))
    # How far each has moved over the ground, and how a turn of the body would move it.
    move_x = x + step[:, :1].astype(np.float64) - (cosine * x_before - sine * z_before)
    move_z = z + step[:, 1:].astype(np.float64) - (cosine * z_before + sine * x_before)
    low = 1.0 - np.clip((y - FLOOR) / np.array(REACHES), 0.0, 1.0)
    weight, holds = foot_weights(np.array(FOOT_SHARES) * low, np.sqrt(move_x * move_x + move_z * move_z))
    mean_x, mean_z, arm_x, arm_z = ((weight * v).sum(axis=1) for v in (move_x, move_z, z, -x))
    off_x, off_z = move_x - mean_x[:, None], move_z - mean_z[:, None]
    about_x, about_z = z - arm_x[:, None], -x - arm_z[:, None]
    turned = (weight * (off_x * about_x + off_z * about_z)).sum(axis=1)
    spread = (weight * (about_x * about_x + about_z * about_z)).sum(axis=1)
    angle = -turned / (spread + STIFFNESS)
    back_x, back_z = -mean_x - angle * arm_x, -mean_z - angle * arm_z
    holds = holds / (1.0 + np.sqrt(back_x * back_x + back_z * back_z) / LIMIT)
    return holds * angle, np.stack([holds * back_x, holds * back_z], axis=1)
