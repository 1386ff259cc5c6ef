"""Frames to start from: the model's own seeds, or the beginning of a user's clip."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import ControlError
from motionkit.features.encode import encode_motion
from motionkit.models.model import MotionModel
from motionkit.motion.motion import resample

INIT_FRAMES = 87  # the receptive field; the paper's number for its comparisons


@dataclass(frozen=True, eq=False)
class Start:
    """Frames B characters start from: features (B, T, 276), contacts (B, T, 4), place of the last one (B, 3)."""

    features: Array
    contacts: Array
    ground: Array


def type_start(model: MotionModel, kind: str, count: int = 1) -> Start:
    """The first start pose of a type for count characters, at the origin facing +Z.

    Raises ControlError if the model has none.
    """
    known = model.types.get(kind)
    if known is None or not known.start_poses:
        raise ControlError(f"the model has no frames to start {kind!r} from")
    pose = known.start_poses[0]
    return Start(
        pose.features[None].repeat(count, axis=0),
        pose.contacts[None].repeat(count, axis=0),
        np.zeros((count, 3), np.float32),
    )


def clip_start(model: MotionModel, path: str | Path, count: int) -> Start:
    """The first frames of a BVH file, any rig, for count characters that go on where the last of them is.

    Raises MotionkitError if the file cannot be used.
    """
    from motionkit.motion.retarget import retarget_file

    motion, _ = retarget_file(path)
    motion = resample(motion, model.fps)
    if len(motion) < 2:
        raise ControlError(f"{path}: expected at least 2 frames to start from, found {len(motion)}")
    motion = motion.cut(0, INIT_FRAMES)
    encoded = encode_motion(motion, model.reference_rotations, model.config.layout)
    return Start(
        encoded.features[None].repeat(count, axis=0),
        encoded.contacts[None].repeat(count, axis=0),
        encoded.ground[-1:].repeat(count, axis=0),
    )
