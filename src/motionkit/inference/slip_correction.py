"""Settings of the root-slip correction, which subtracts the sliding of standing feet from the root's velocity.

A frame gives the movement of its feet over the ground twice: by the pose, and by the root's velocity. Each is drawn
from its own Gaussian. Where a reference was recorded on another trajectory than requested, they disagree and the
feet slide. Part of that sliding is subtracted from the root's velocity in the frame that the network sees next. The
correction turns no joint. Foot locking turns joints afterwards, and weighs the feet in the same way (motion/leg_ik.py).
frame_kernel.c and export/onnx_slip_correction.py compute it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from motionkit.features.layout import feature_layout
from motionkit.motion.skeleton import FOOT_JOINTS

# Weights of foot joints fall from 1 at a height of FLOOR cm to 0 at REACHES cm above it, in the order of FOOT_JOINTS.
FLOOR = 2.2
REACHES = (10.85, 1.55, 10.85, 1.55)
STIFFNESS = 60.0  # cm^2, added to the spread of standing joints: close together they turn the body little
LIMIT = 0.5  # sliding (cm per frame) at which the correction halves; a larger movement is a step


def foot_columns(layout: str) -> NDArray[np.intp]:
    """Columns (4, 3) of the positions of the foot joints."""
    columns = {(c.block, c.joint, c.component): i for i, c in enumerate(feature_layout(layout).columns)}
    return np.array([[columns["joint_positions", joint, k] for k in range(3)] for joint in FOOT_JOINTS])
