"""Forward kinematics: global rotations and positions from local rotations."""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Array
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_multiply, quat_rotate


def forward_kinematics(
    local_rotations: Array,
    root_positions: Array,
    offsets: Array,
    parents: tuple[int, ...],
    local_positions: Array | None = None,
) -> tuple[Array, Array]:
    """Global rotations (..., J, 4) and global positions (..., J, 3).

    Args:
        local_rotations: (..., J, 4) quaternions w, x, y, z in parent space.
        root_positions: (..., 3) root position in the world.
        offsets: (J, 3) or (..., J, 3) positions relative to the parent.
        parents: J parent indices, parents before children; the root's is -1.
        local_positions: (..., J, 3) used instead of offsets, for rigs whose joints translate.
    """
    places = offsets if local_positions is None else local_positions
    rotations = [local_rotations[..., 0, :]]
    positions = [root_positions]
    for joint in range(1, len(parents)):
        parent = parents[joint]
        rotations.append(quat_multiply(rotations[parent], local_rotations[..., joint, :]))
        positions.append(positions[parent] + quat_rotate(rotations[parent], places[..., joint, :]))
    return np.stack(rotations, axis=-2), np.stack(positions, axis=-2)


def motion_kinematics(motion: Motion) -> tuple[Array, Array]:
    """Global rotations (T, J, 4) and global positions (T, J, 3) of a motion."""
    return forward_kinematics(
        motion.local_rotations,
        motion.root_positions,
        motion.skeleton.offsets.astype(motion.local_rotations.dtype),
        motion.skeleton.parents,
        motion.local_positions,
    )
