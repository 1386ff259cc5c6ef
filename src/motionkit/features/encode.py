"""Turns a motion into the 276 features of every frame (paper section 3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import SkeletonError
from motionkit.features.heading import heading_angles
from motionkit.features.layout import DEFAULT_LAYOUT, feature_layout
from motionkit.motion.contacts import foot_contacts
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    quat_from_yaw,
    quat_identity,
    quat_inverse,
    quat_multiply,
    quat_rotate,
    quat_to_expmap,
    quat_to_sixd,
    rotate_ground,
)
from motionkit.motion.skeleton import JOINT_COUNT, JOINT_NAMES

# Largest angle (radians) of an exponential map; beyond it, the shorter equivalent is used. Angles above pi keep dances
# continuous. Angles up to 2 pi would give one pose two encodings.
FOLD_ANGLE = 1.4 * np.pi


@dataclass(frozen=True, eq=False)
class EncodedMotion:
    """A motion as features, with its track on the ground.

    Attributes:
        features: (T, 276) unnormalised, columns as in the layout.
        contacts: (T, 4) left foot, left toe, right foot, right toe.
        ground: (T, 3) root x, root z (cm) and heading (radians) in the world, from which trajectories are made.
    """

    features: Array
    contacts: Array
    ground: Array


def identity_reference_rotations() -> Array:
    """Reference rotations (23, 4) of the paper: the identity, so exponential maps are relative to the rest pose."""
    return quat_identity((JOINT_COUNT,))


def encode_motion(
    motion: Motion,
    reference_rotations: Array | None = None,
    layout: str = DEFAULT_LAYOUT,
) -> EncodedMotion:
    """Features, contacts and ground track of a motion on the canonical joints.

    Velocities are differences from the previous frame, per second, in the heading frame of the later frame. The first
    frame repeats the velocities of the second.

    Args:
        motion: T >= 2 frames on the 23 canonical joints, cm.
        reference_rotations: (23, 4) that exponential maps are relative to; identity by default.
        layout: version of the columns.

    Raises:
        SkeletonError: the joints are not the canonical ones, or there are fewer than two frames.
    """
    if motion.skeleton.names != JOINT_NAMES:
        raise SkeletonError(
            f"expected the {JOINT_COUNT} canonical joints; map the motion with motionkit.rig.retarget first"
        )
    if len(motion) < 2:
        raise SkeletonError(f"expected at least 2 frames for velocities, found {len(motion)}")
    references = identity_reference_rotations() if reference_rotations is None else reference_rotations
    _, positions = motion_kinematics(motion)
    yaw = heading_angles(positions, motion.fps)
    to_heading = quat_from_yaw(-yaw)
    root_xz = positions[:, 0, [0, 2]]
    ground = np.concatenate([root_xz, yaw[:, None]], axis=-1)

    origin = np.stack([root_xz[:, 0], np.zeros_like(yaw), root_xz[:, 1]], axis=-1)
    facing_positions = quat_rotate(to_heading[:, None], positions - origin[:, None])
    velocities = _backward(positions, motion.fps)
    facing_velocities = quat_rotate(to_heading[:, None], velocities)
    root_rotation = quat_multiply(to_heading, motion.local_rotations[:, 0])
    turns = quat_multiply(quat_inverse(motion.local_rotations[:-1]), motion.local_rotations[1:])
    angular = quat_to_expmap(turns) * motion.fps
    angular = np.concatenate([angular[:1], angular])

    frames = len(motion)
    columns = feature_layout(layout)
    parts = {
        "root_yaw_velocity": _backward(yaw[:, None], motion.fps),
        "root_xz_velocity": rotate_ground(-yaw, velocities[:, 0, [0, 2]]),
        "root_rotation": (quat_to_sixd if columns.root_is_sixd else quat_to_expmap)(root_rotation),
        "joint_rotations": relative_expmaps(motion.local_rotations[:, 1:], references[1:]).reshape(
            frames, -1
        ),
        "joint_angular_velocities": angular[:, 1:].reshape(frames, -1),
        "joint_positions": facing_positions.reshape(frames, -1),
        "joint_velocities": facing_velocities.reshape(frames, -1),
    }
    if columns.root_is_sixd:  # drop the root's x, z and sideways velocity
        parts["joint_positions"] = np.delete(parts["joint_positions"], (0, 2), axis=-1)
        parts["joint_velocities"] = parts["joint_velocities"][:, 1:]
    features = np.concatenate([parts[name] for name in columns.blocks], axis=-1)
    return EncodedMotion(features, foot_contacts(positions, motion.fps), ground)


def _backward(values: Array, fps: float) -> Array:
    """Differences (T, ...) from the previous frame, per second; the first repeats the second."""
    steps = np.diff(values, axis=0) * fps
    return np.concatenate([steps[:1], steps])


def relative_expmaps(rotations: Array, reference_rotations: Array) -> Array:
    """Exponential maps (T, J, 3) of rotations (T, J, 4) relative to reference_rotations (J, 4).

    They stay continuous where a rotation passes through pi, up to FOLD_ANGLE.
    """
    relative = quat_multiply(quat_inverse(reference_rotations), rotations)
    quats = relative.copy()
    fold = np.cos(0.5 * FOLD_ANGLE)
    quats[0] *= np.where(quats[0, :, :1] < 0, -1.0, 1.0)
    agree = np.einsum("tjk,tjk->tj", quats[1:], quats[:-1])
    previous_sign = np.ones(quats.shape[1], dtype=quats.dtype)
    for t in range(1, len(quats)):
        sign = np.where(agree[t - 1] * previous_sign < 0, -1.0, 1.0).astype(quats.dtype)
        sign = np.where(sign * quats[t, :, 0] < fold, -sign, sign)
        quats[t] *= sign[:, None]
        previous_sign = sign
    return _expmap_any_branch(quats)


def _expmap_any_branch(quat: Array) -> Array:
    """Exponential maps (..., 3) with angles up to 2 pi; the quaternion's sign decides which way it turns."""
    sine = np.linalg.norm(quat[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, quat[..., :1])
    scale = np.where(sine < 1e-6, np.full_like(sine, 2.0), angle / np.maximum(sine, 1e-6))
    return scale * quat[..., 1:]
