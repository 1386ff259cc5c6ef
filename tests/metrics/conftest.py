from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import expmap_to_quat, quat_from_yaw, quat_multiply, quat_rotate
from motionkit.motion.skeleton import JOINT_COUNT, canonical_skeleton


def swaying(frames: int = 120, fps: float = 60.0, seed: int = 0, speed: float = 100.0) -> Motion:
    """A body that sways smoothly in all joints while its root moves along +Z at `speed` cm/s."""
    draw = np.random.default_rng(seed)
    size = draw.random((JOINT_COUNT, 3), np.float64) * 0.3
    rate = 0.3 + draw.random((JOINT_COUNT, 3), np.float64)
    phase = 6 * draw.random((JOINT_COUNT, 3), np.float64)
    time = np.arange(frames, dtype=np.float64)[:, None, None] / fps
    expmaps = size * np.sin(2 * math.pi * rate * time + phase)
    places = np.zeros((frames, 3), np.float64)
    places[:, 1] = 92.0
    places[:, 2] = speed * time[:, 0, 0]
    return Motion(canonical_skeleton(), expmap_to_quat(expmaps), places, fps)


def placed(motion: Motion, yaw: float = 0.0, move: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Motion:
    """The motion turned about Y through the origin and then moved."""
    turn = quat_from_yaw(np.array(yaw, motion.local_rotations.dtype))
    rotations = motion.local_rotations.copy()
    rotations[:, 0] = quat_multiply(np.broadcast_to(turn, rotations[:, 0].shape), rotations[:, 0])
    places = quat_rotate(turn, motion.root_positions) + np.array(move, np.float64)
    return replace(motion, local_rotations=rotations, root_positions=places)


def still_feet(frames: int = 60) -> Array:
    """Standing feet (T, 4, 3): ankles at 9 cm, toes on the floor."""
    feet = np.zeros((frames, 4, 3), np.float64)
    feet[:, [0, 2], 1] = 9.0
    return feet


@pytest.fixture
def motion() -> Motion:
    return swaying()
