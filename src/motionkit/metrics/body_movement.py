"""Body movement (BM): how far all joints rotate from frame to frame.

Rotations are local, (T, J, 4), as quaternions w, x, y, z.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.metrics.value import FRAME_RATE, MetricValue, need
from motionkit.motion.rotations import quat_angle, quat_to_euler, wrap_angle

EULER_ORDER = "ZYX"  # the order of the CMU files and of motionkit's own files


def euler_movement(local_rotations: Array) -> Array:
    """Sum (T - 1, J) of the absolute changes of each joint's three Euler angles in degrees, wrapped to +-180.

    Angles are ZYX with the middle one within +-90. Near +-90 their rates grow without bound, and the root's value
    depends on the world axes. geodesic_movement has neither problem.
    """
    angles = quat_to_euler(local_rotations.astype(np.float64), EULER_ORDER)
    return np.rad2deg(np.abs(wrap_angle(np.diff(angles, axis=0))).sum(-1))


def geodesic_movement(local_rotations: Array) -> Array:
    """Angle (T - 1, J) in degrees of each joint's rotation from one frame to the next."""
    quat = local_rotations.astype(np.float64)
    return np.rad2deg(quat_angle(quat[:-1], quat[1:]))


def body_movement(local_rotations: Array, kind: str = "euler") -> MetricValue:
    """BM in degrees per frame: movement summed over joints, averaged over frames.

    Args:
        local_rotations: at 60 fps.
        kind: "euler" (the paper's, id bm-euler) or "geodesic" (id bm-geodesic).

    Raises:
        MotionkitError: there are fewer than two frames, or the kind is unknown.
    """
    if kind not in ("euler", "geodesic"):
        raise MotionkitError(f"unknown kind of body movement {kind!r}, expected 'euler' or 'geodesic'")
    need(len(local_rotations), 2, "body movement needs")
    movement = (euler_movement if kind == "euler" else geodesic_movement)(local_rotations)
    parameters: dict[str, float | str] = {"fps": FRAME_RATE, "joints": float(movement.shape[1])}
    if kind == "euler":
        parameters["order"] = EULER_ORDER
    return MetricValue(f"bm-{kind}", float(movement.sum(-1).mean()), "deg/frame", parameters)


def angular_speed(local_rotations: Array, joints: Sequence[int], fps: float = FRAME_RATE) -> float:
    """Mean angular speed in rad/s of some joints, given by index, relative to their parents."""
    return float(np.deg2rad(geodesic_movement(local_rotations[:, list(joints)]).mean()) * fps)
