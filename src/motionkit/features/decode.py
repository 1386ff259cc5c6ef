"""Turns features back into a motion: rotations as predicted, the root's path integrated from its velocities."""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Array
from motionkit.features.encode import identity_reference_rotations
from motionkit.features.layout import DEFAULT_LAYOUT, feature_layout
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    expmap_to_quat,
    quat_continuous,
    quat_from_yaw,
    quat_multiply,
    rotate_ground,
    sixd_to_quat,
)
from motionkit.motion.skeleton import JOINT_COUNT, Skeleton


def decode_rotations(
    features: Array, reference_rotations: Array | None = None, layout: str = DEFAULT_LAYOUT
) -> Array:
    """Local rotations (..., 23, 4) of unnormalised features (..., 276); the root's is relative to its heading.

    reference_rotations (23, 4) are those given to encode_motion, the identity by default.
    """
    reference_rotations = (
        identity_reference_rotations() if reference_rotations is None else reference_rotations
    )
    columns = feature_layout(layout)
    root = features[..., columns.blocks["root_rotation"]]
    root = (sixd_to_quat if columns.root_is_sixd else expmap_to_quat)(root)
    expmaps = features[..., columns.blocks["joint_rotations"]]
    joints = expmap_to_quat(expmaps.reshape(*expmaps.shape[:-1], -1, 3))
    joints = quat_multiply(reference_rotations[1:].astype(joints.dtype), joints)
    return np.concatenate([root[..., None, :], joints], axis=-2)


def root_height(features: Array, layout: str = DEFAULT_LAYOUT) -> Array:
    """Height (...) of the root above the floor in cm, from unnormalised features (..., 276)."""
    return features[..., feature_layout(layout).root_height]


def joint_positions(features: Array, layout: str = DEFAULT_LAYOUT) -> Array:
    """Joint positions (T, 23, 3) in cm, in the heading frame, of unnormalised features (T, 276); root x, z are zero."""
    columns = feature_layout(layout)
    out = np.zeros((len(features), JOINT_COUNT, 3), features.dtype)
    for index in range(*columns.blocks["joint_positions"].indices(len(columns.columns))):
        column = columns.columns[index]
        out[:, column.joint, column.component] = features[:, index]
    return out


def integrate_ground(features: Array, start: Array, fps: float, layout: str = DEFAULT_LAYOUT) -> Array:
    """Ground track (..., T, 3), x and z in cm and heading in radians, integrated from the velocities in the features.

    As in encode_motion, a velocity leads from the previous frame and is in the later frame's heading frame.

    Args:
        features: (..., T, 276) unnormalised.
        start: (..., 3) x, z (cm) and heading (radians) of the first frame.
        fps: frames per second.
        layout: version of the columns.
    """
    blocks = feature_layout(layout).blocks
    yaw_steps = features[..., blocks["root_yaw_velocity"]].astype(np.float64)[..., 1:, 0] / fps
    zero = [(0, 0)] * (features.ndim - 2)
    yaw = start[..., None, 2].astype(np.float64) + np.pad(np.cumsum(yaw_steps, -1), [*zero, (1, 0)])
    steps = rotate_ground(
        yaw[..., 1:], features[..., 1:, blocks["root_xz_velocity"]].astype(np.float64) / fps
    )
    xz = start[..., None, :2].astype(np.float64) + np.pad(np.cumsum(steps, -2), [*zero, (1, 0), (0, 0)])
    return np.concatenate([xz, yaw[..., None]], axis=-1)


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
        features: (T, 276) unnormalised.
        skeleton: body with the canonical joints, cm.
        fps: frames per second.
        start: (3,) root x, z and heading of the first frame; the origin, facing +Z, by default.
        reference_rotations: (23, 4) as given to encode_motion; identity by default.
        layout: version of the columns.
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
