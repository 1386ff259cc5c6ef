"""Forward kinematics: from rotations in the parent's space to rotations and positions in the world."""

from __future__ import annotations

import torch
from torch import Tensor

from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_multiply, quat_rotate


def forward_kinematics(
    local_rotations: Tensor,
    root_positions: Tensor,
    offsets: Tensor,
    parents: tuple[int, ...],
    local_positions: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Global rotations (..., J, 4) and global positions (..., J, 3).

    Args:
        local_rotations: (..., J, 4) quaternions in the parent's space.
        root_positions: (..., 3) the root in the world.
        offsets: (J, 3) or (..., J, 3) positions relative to the parent.
        parents: J parent indices, parents first; the root's is -1.
        local_positions: (..., J, 3) to use in place of offsets, for rigs whose joints translate.
    """
    places = offsets if local_positions is None else local_positions
    rotations = [local_rotations[..., 0, :]]
    positions = [root_positions]
    for joint in range(1, len(parents)):
        parent = parents[joint]
        rotations.append(quat_multiply(rotations[parent], local_rotations[..., joint, :]))
        positions.append(positions[parent] + quat_rotate(rotations[parent], places[..., joint, :]))
    return torch.stack(rotations, dim=-2), torch.stack(positions, dim=-2)


def motion_kinematics(motion: Motion) -> tuple[Tensor, Tensor]:
    """Global rotations (T, J, 4) and global positions (T, J, 3) of a motion."""
    return forward_kinematics(
        motion.local_rotations,
        motion.root_positions,
        motion.skeleton.offsets.to(motion.local_rotations.dtype),
        motion.skeleton.parents,
        motion.local_positions,
    )
