"""The 276 numbers back to Motion: rotations as predicted, the root integrated from its velocities."""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Array
from motionkit.features.encode import identity_reference_rotations
from motionkit.features.layout import DEFAULT_LAYOUT, feature_layout, root_height_column
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    expmap_to_quat,
    quat_continuous,
    quat_from_yaw,
    quat_multiply,
    rotate_ground,
    sixd_to_quat,
)
from motionkit.motion.skeleton import Skeleton


def decode_rotations(
    features: Array, reference_rotations: Array | None = None, layout: str = DEFAULT_LAYOUT
) -> Array:
    """Local rotations (..., 23, 4) of features (..., 276), the root's relative to its heading."""
    reference_rotations = (
        identity_reference_rotations() if reference_rotations is None else reference_rotations
    )
    blocks = feature_layout(layout).blocks
    root = features[..., blocks["root_rotation"]]
    root = sixd_to_quat(root) if layout.startswith("sixd") else expmap_to_quat(root)
    expmaps = features[..., blocks["joint_rotations"]]
    joints = expmap_to_quat(expmaps.reshape(*expmaps.shape[:-1], -1, 3))
    joints = quat_multiply(reference_rotations[1:].astype(joints.dtype), joints)
    return np.concatenate([root[..., None, :], joints], axis=-2)


def root_height(features: Array, layout: str = DEFAULT_LAYOUT) -> Array:
    """Height (...) in cm of the root above the floor."""
    return features[..., root_height_column(layout)]


def integrate_ground(features: Array, start: Array, fps: float, layout: str = DEFAULT_LAYOUT) -> Array:
    """Root x, z and heading (..., T, 3) over time, from velocities and the place (..., 3) of the first frame.

    Velocities are those of encode_motion: to the frame before, in the later frame's heading.
    """
    blocks = feature_layout(layout).blocks
    yaw_steps = features[..., blocks["root_yaw_velocity"]].astype(np.float64)[..., 1:, 0] / fps
    yaw = start[..., None, 2].astype(np.float64) + _after_zero(np.cumsum(yaw_steps, -1), -1)
    steps = rotate_ground(
        yaw[..., 1:], features[..., 1:, blocks["root_xz_velocity"]].astype(np.float64) / fps
    )
    xz = start[..., None, :2].astype(np.float64) + _after_zero(np.cumsum(steps, -2), -2)
    return np.concatenate([xz, yaw[..., None]], axis=-1)


def _after_zero(values: Array, axis: int) -> Array:
    """The values with one zero before them along an axis."""
    zero = np.zeros_like(np.take(values, [0], axis=axis))
    return np.concatenate([zero, values], axis=axis)


def decode_motion(
    features: Array,
    skeleton: Skeleton,
    fps: float,
    start: Array | None = None,
    reference_rotations: Array | None = None,
    layout: str = DEFAULT_LAYOUT,
) -> Motion:
    """The motion that features (T, 276) describe, on a skeleton with the canonical joints.

    Args:
        start: (3,) root x, z and heading of the first frame; the origin facing +Z if not given.
        reference_rotations: (23, 4) as given to encode_motion.
    """
    start = np.zeros(3, np.float32) if start is None else start
    ground = integrate_ground(features, start, fps, layout)
    rotations = decode_rotations(features, reference_rotations, layout).astype(np.float64)
    root = quat_multiply(quat_from_yaw(ground[:, 2]), rotations[:, 0])
    rotations = np.concatenate([root[:, None], rotations[:, 1:]], axis=1)
    positions = np.stack(
        [ground[:, 0], root_height(features, layout).astype(np.float64), ground[:, 1]], axis=-1
    )
    return Motion(skeleton, quat_continuous(rotations).astype(np.float32), positions.astype(np.float32), fps)
