"""A frame as a body in numpy, in place of pose_frames of frame_kernel.c."""

from __future__ import annotations

from itertools import product

import numpy as np

from motionkit.arrays import Floats, normalized
from motionkit.features.decode import decode_rotations, root_height
from motionkit.inference.frame_arrays import BodyArrays
from motionkit.motion.ankles import FEET, rolled_back
from motionkit.motion.kinematics import forward_kinematics
from motionkit.motion.rotations import quat_from_yaw, quat_multiply, quat_to_matrix
from motionkit.motion.skeleton import PARENTS
from oracle.foot_lock import lock_feet
from oracle.height_correction import follow


def decode(
    features: Floats, ground: Floats, reference_rotations: Floats, layout: str
) -> tuple[Floats, Floats]:
    """Local rotations (N, 23, 4) and root positions (N, 3) of frames (N, 276) at ground (N, 3)."""
    rotations = decode_rotations(features, reference_rotations, layout)
    rotations[:, 0] = quat_multiply(quat_from_yaw(ground[:, 2]), rotations[:, 0])
    height = root_height(features, layout)
    return rotations.astype(np.float32), np.stack([ground[:, 0], height, ground[:, 1]], axis=1)


def world_transforms(rotations: Floats, root_positions: Floats, offsets: Floats) -> Floats:
    """World transforms (N, 23, 4, 4) of local rotations (N, 23, 4), for bodies with offsets (N, 23, 3).

    The root is added last, which keeps digits far from the origin.
    """
    origin = np.zeros_like(root_positions)
    turns, positions = forward_kinematics(rotations, origin, offsets, PARENTS)
    world = np.zeros((*positions.shape[:2], 4, 4), np.float32)
    world[..., :3, :3], world[..., 3, 3] = quat_to_matrix(turns), 1.0
    world[..., :3, 3] = positions + root_positions[:, None]
    return world


class NumpyPose:
    """What PoseKernel is to CharacterStream."""

    def __init__(self, layout: str, reference_rotations: Floats, body: BodyArrays) -> None:
        self.layout, self.reference_rotations, self.body = layout, reference_rotations, body

    def pose(self, features: Floats, contacts: Floats, ground: Floats) -> tuple[Floats, Floats, Floats]:
        """Local rotations (N, 23, 4), root positions (N, 3) and positions (N, 23, 3) of a frame."""
        body, scale = self.body, self.body.scale
        rotations, root = decode(features, ground, self.reference_rotations, self.layout)
        root *= scale[:, None]
        if body.feet is not None:
            for row, (ankle, toe) in product(range(len(rotations)), FEET):
                length = normalized(body.offsets[row, toe])
                rotations[row, ankle] = rolled_back(rotations[row, None, ankle], length)[0]
        world = world_transforms(rotations, root, body.offsets)
        rise = scale * follow(self.layout, body.rise, features, world[..., 1, 3] / scale[:, None])
        root[:, 1] += rise
        world[..., 1, 3] += rise[:, None]
        if body.feet is None:
            return rotations, root, world[..., :3, 3].copy()
        return rotations, root, lock_feet(body.feet, rotations, root, world, contacts, scale)
