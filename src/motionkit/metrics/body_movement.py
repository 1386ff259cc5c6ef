"""Body movement (BM): how much all joints turn from frame to frame."""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.metrics.value import FRAME_RATE, MetricValue
from motionkit.motion.rotations import quat_angle, quat_to_euler, wrap_angle

EULER_ORDER = "ZYX"  # the order of the CMU files, and of what motionkit writes


def euler_movement(local_rotations: Array) -> Array:
    """Degrees (T - 1, J): the L1 change of each joint's Euler angles, each change folded into +-180.

    Angles are ZYX with the middle one within +-90. Their rates grow without bound near the pole, and the
    root's depend on which way the world's axes point; geodesic_movement has neither trait.

    Args:
        local_rotations: (T, J, 4) quaternions in the parent's space.
    """
    angles = quat_to_euler(local_rotations.astype(np.float64), EULER_ORDER)
    return np.rad2deg(np.abs(wrap_angle(np.diff(angles, axis=0))).sum(-1))


def geodesic_movement(local_rotations: Array) -> Array:
    """Degrees (T - 1, J): the angle of the rotation from each frame to the next.

    Args:
        local_rotations: (T, J, 4) quaternions in the parent's space.
    """
    quat = local_rotations.astype(np.float64)
    return np.rad2deg(quat_angle(quat[:-1], quat[1:]))


def body_movement(local_rotations: Array, kind: str = "euler") -> MetricValue:
    """BM in degrees per frame: the movement of a frame summed over joints, averaged over time.

    Args:
        local_rotations: (T, J, 4) quaternions in the parent's space, at 60 fps.
        kind: "euler" (the paper's, id bm-euler) or "geodesic" (id bm-geodesic).

    Raises MotionkitError for fewer than two frames or an unknown kind.
    """
    if kind not in ("euler", "geodesic"):
        raise MotionkitError(f"unknown kind of body movement {kind!r}, expected 'euler' or 'geodesic'")
    if len(local_rotations) < 2:
        raise MotionkitError(f"body movement needs at least 2 frames, found {len(local_rotations)}")
    movement = (euler_movement if kind == "euler" else geodesic_movement)(local_rotations)
    parameters: dict[str, float | str] = {"fps": FRAME_RATE, "joints": float(movement.shape[1])}
    if kind == "euler":
        parameters["order"] = EULER_ORDER
    return MetricValue(f"bm-{kind}", float(movement.sum(-1).mean()), "deg/frame", parameters)
