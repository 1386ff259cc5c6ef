from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from motionkit.motion.motion import Motion
from motionkit.motion.rotations import expmap_to_quat, quat_from_yaw, quat_multiply, quat_rotate
from motionkit.motion.skeleton import JOINT_COUNT, canonical_skeleton


def swaying(frames: int = 120, fps: float = 60.0, seed: int = 0, speed: float = 100.0) -> Motion:
    """A body that sways smoothly in all joints while its root goes along +Z at speed (cm/s)."""
    draw = torch.Generator().manual_seed(seed)
    size = torch.rand(JOINT_COUNT, 3, generator=draw, dtype=torch.float64) * 0.3
    rate = 0.3 + torch.rand(JOINT_COUNT, 3, generator=draw, dtype=torch.float64)
    phase = 6 * torch.rand(JOINT_COUNT, 3, generator=draw, dtype=torch.float64)
    time = torch.arange(frames, dtype=torch.float64)[:, None, None] / fps
    expmaps = size * torch.sin(2 * math.pi * rate * time + phase)
    places = torch.zeros(frames, 3, dtype=torch.float64)
    places[:, 1] = 92.0
    places[:, 2] = speed * time[:, 0, 0]
    return Motion(canonical_skeleton(), expmap_to_quat(expmaps), places, fps)


def placed(motion: Motion, yaw: float = 0.0, move: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Motion:
    """The motion turned about Y through the origin and then moved."""
    turn = quat_from_yaw(torch.tensor(yaw, dtype=motion.local_rotations.dtype))
    rotations = motion.local_rotations.clone()
    rotations[:, 0] = quat_multiply(turn.expand_as(rotations[:, 0]), rotations[:, 0])
    places = quat_rotate(turn, motion.root_positions) + torch.tensor(move, dtype=torch.float64)
    return replace(motion, local_rotations=rotations, root_positions=places)


def still_feet(frames: int = 60) -> Tensor:
    """Feet (T, 4, 3) that stand: ankles at 9 cm, toes on the floor."""
    feet = torch.zeros(frames, 4, 3, dtype=torch.float64)
    feet[:, [0, 2], 1] = 9.0
    return feet


@pytest.fixture
def motion() -> Motion:
    return swaying()
