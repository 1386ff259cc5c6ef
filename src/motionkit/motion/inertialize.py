"""Continues one motion with another: differences in pose and velocity decay (inertialization, Bollo 2018)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motionkit.arrays import Array
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    expmap_to_quat,
    quat_from_yaw,
    quat_inverse,
    quat_multiply,
    quat_to_expmap,
    rotate_ground,
)


def continued(before: Motion, i: int, after: Motion, j: int, turn: Array, decay: int) -> Motion:
    """Frames j + 1 onwards of a motion, moved and turned over the ground so that they continue frame i of another.

    Args:
        before, after: motions on the same joints, at the same rate, with Y up; frames i and j are not their first.
        turn: radians by which `after` is turned about Y.
        decay: frames over which the difference in pose and velocity decays.
    """
    yaw = quat_from_yaw(turn)
    rotations = after.local_rotations.copy()
    rotations[:, 0] = quat_multiply(yaw, rotations[:, 0])
    root = after.root_positions.copy()
    root[:, [0, 2]] = (
        rotate_ground(turn, root[:, [0, 2]] - root[j, [0, 2]]) + before.root_positions[i, [0, 2]]
    )
    time = np.arange(1, len(after) - j, dtype=np.float32)
    offset_weight, velocity_weight = decay_curves(time, float(decay))
    here, there = before.local_rotations[i], rotations[j]
    offset = quat_to_expmap(quat_multiply(here, quat_inverse(there)))
    speed_a = quat_to_expmap(quat_multiply(here, quat_inverse(before.local_rotations[i - 1])))
    speed_b = quat_to_expmap(quat_multiply(there, quat_inverse(rotations[j - 1])))
    correction = offset_weight[:, None, None] * offset + velocity_weight[:, None, None] * (speed_a - speed_b)

    def eased(mine: Array, others: Array) -> Array:
        """Values (T, ...) from frame j + 1 on, which start where others (T, ...) are at frame i."""
        apart = others[i] - mine[j]
        speed = (others[i] - others[i - 1]) - (mine[j] - mine[j - 1])
        shape = (-1, *[1] * (mine.ndim - 1))
        return mine[j + 1 :] + offset_weight.reshape(shape) * apart + velocity_weight.reshape(shape) * speed

    places = before.local_positions, after.local_positions
    return replace(
        after,
        local_rotations=quat_multiply(expmap_to_quat(correction), rotations[j + 1 :]),
        root_positions=eased(root, before.root_positions),
        local_positions=None if places[0] is None or places[1] is None else eased(places[1], places[0]),
    )


def decay_curves(time: Array, decay: float) -> tuple[Array, Array]:
    """Weights (T,) of the differences in pose and velocity; weights and slopes reach zero after `decay` frames."""
    x = np.minimum(time / decay, 1.0)
    offset = 1.0 - x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    velocity = decay * (x - x**3 * (6.0 - 8.0 * x + 3.0 * x**2))
    return offset, velocity
