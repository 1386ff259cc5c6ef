"""Grip: the root goes where feet that stand let it.

A frame says twice where its feet go over the ground: by the pose, and by the root's velocities. Both are drawn
from Gaussians of their own, and where a reference was recorded on another way than the one asked for they are at odds:
feet slide. Here part of that is taken out of the root's velocities, and with it out of the frame the network sees
next. No joint is turned, as foot locking does. frame_kernel.c and export/onnx_network.py do the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import Floats
from motionkit.features.layout import feature_layout
from motionkit.motion.skeleton import FOOT_JOINTS

Doubles = NDArray[np.float64]

# Foot joints hold where they are low: fully at FLOOR cm, not at all so many cm higher; in the order of FOOT_JOINTS.
FLOOR = 2.2
REACHES = (10.85, 1.55, 10.85, 1.55)
SHARES = (0.5, 1.0, 0.5, 1.0)  # of ankles, which a foot rolls under, and of toes
EASE = 0.3  # cm; the less a foot moves in a frame beside this, the more it counts
STIFFNESS = 60.0  # cm^2; the farther apart what holds is beside its root, the more it turns the body
ENOUGH = 0.5  # of a foot joint on the ground holds as well as all four
LIMIT = (
    0.5  # cm in a frame that only half is taken out of, and ever less of more: what is so far off is a step
)


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
    low = low * np.array(SHARES)
    weight = low / (np.sqrt(move_x * move_x + move_z * move_z) + EASE)
    weight = weight / (weight.sum(axis=1, keepdims=True) + 1e-9)
    mean_x, mean_z, arm_x, arm_z = ((weight * v).sum(axis=1) for v in (move_x, move_z, z, -x))
    off_x, off_z = move_x - mean_x[:, None], move_z - mean_z[:, None]
    about_x, about_z = z - arm_x[:, None], -x - arm_z[:, None]
    turned = (weight * (off_x * about_x + off_z * about_z)).sum(axis=1)
    spread = (weight * (about_x * about_x + about_z * about_z)).sum(axis=1)
    holds = np.minimum(low.sum(axis=1) / ENOUGH, 1.0)
    angle = -turned / (spread + STIFFNESS)
    back_x, back_z = -mean_x - angle * arm_x, -mean_z - angle * arm_z
    holds = holds / (1.0 + np.sqrt(back_x * back_x + back_z * back_z) / LIMIT)
    return holds * angle, np.stack([holds * back_x, holds * back_z], axis=1)
