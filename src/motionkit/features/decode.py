"""The 276 numbers back to Motion: rotations as predicted, the root integrated from its velocities."""

from __future__ import annotations

import torch
from torch import Tensor

from motionkit.features.encode import identity_references
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
from motionkit.motion.skeleton import Skeleton


def decode_rotations(
    features: Tensor, references: Tensor | None = None, layout: str = DEFAULT_LAYOUT
) -> Tensor:
    """Local rotations (..., 23, 4) of features (..., 276), the root's relative to its heading."""
    references = identity_references() if references is None else references
    blocks = feature_layout(layout).blocks
    root = features[..., blocks["root_rotation"]]
    root = sixd_to_quat(root) if layout.startswith("sixd") else expmap_to_quat(root)
    expmaps = features[..., blocks["joint_rotations"]]
    joints = expmap_to_quat(expmaps.reshape(*expmaps.shape[:-1], -1, 3))
    joints = quat_multiply(references[1:].to(joints), joints)
    return torch.cat([root[..., None, :], joints], dim=-2)


def root_height(features: Tensor, layout: str = DEFAULT_LAYOUT) -> Tensor:
    """Height (...) in cm of the root above the floor."""
    block = feature_layout(layout).blocks["joint_positions"]
    return features[..., block.start + (0 if layout.startswith("sixd") else 1)]


def integrate_ground(features: Tensor, start: Tensor, fps: float, layout: str = DEFAULT_LAYOUT) -> Tensor:
    """Root x, z and heading (..., T, 3) over time, from velocities and the place (..., 3) of the first frame.

    Velocities are those of encode_motion: to the frame before, in the later frame's heading.
    """
    blocks = feature_layout(layout).blocks
    yaw_steps = features[..., blocks["root_yaw_velocity"]].double()[..., 1:, 0] / fps
    yaw = start[..., None, 2].double() + torch.nn.functional.pad(torch.cumsum(yaw_steps, -1), (1, 0))
    steps = rotate_ground(yaw[..., 1:], features[..., 1:, blocks["root_xz_velocity"]].double() / fps)
    xz = start[..., None, :2].double() + torch.nn.functional.pad(torch.cumsum(steps, -2), (0, 0, 1, 0))
    return torch.cat([xz, yaw[..., None]], dim=-1)


def decode_motion(
    features: Tensor,
    skeleton: Skeleton,
    fps: float,
    start: Tensor | None = None,
    references: Tensor | None = None,
    layout: str = DEFAULT_LAYOUT,
) -> Motion:
    """The motion that features (T, 276) describe, on a skeleton with the canonical joints.

    Args:
        start: (3,) root x, z and heading of the first frame; the origin facing +Z if not given.
        references: (23, 4) as given to encode_motion.
    """
    start = torch.zeros(3) if start is None else start
    ground = integrate_ground(features, start, fps, layout)
    rotations = decode_rotations(features, references, layout).double()
    root = quat_multiply(quat_from_yaw(ground[:, 2]), rotations[:, 0])
    rotations = torch.cat([root[:, None], rotations[:, 1:]], dim=1)
    positions = torch.stack([ground[:, 0], root_height(features, layout).double(), ground[:, 1]], dim=-1)
    return Motion(skeleton, quat_continuous(rotations).float(), positions.float(), fps)
