"""Root-slip correction: feet that stand hold the root.

A frame says twice where its feet go over the ground: by the pose, and by the root's velocities. Both are drawn from
Gaussians of their own, and where a reference was recorded on another trajectory than the one asked for, they disagree:
feet slide. Part of that slide is subtracted from the root's velocities here, and so from the frame that the network
sees next. No joint is turned; foot locking does that afterwards, and holds the root by the same weights
(motion/leg_ik.py). frame_kernel.c and export/onnx_slip_correction.py do it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from motionkit.features.layout import feature_layout
from motionkit.motion.skeleton import FOOT_JOINTS

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
