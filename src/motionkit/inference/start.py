"""Frames to start from: the model's own seeds, or the beginning of a user's clip."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import ControlError
from motionkit.features.encode import encode_motion
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion, resample

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


def clip_motion(model: MotionModel, path: str | Path | Motion) -> Motion:
    """The first frames of a BVH file, any rig, or of a canonical motion in cm, at the model's rate.

    Raises MotionkitError if the file cannot be used.
    """
    from motionkit.motion.retarget import retarget_file

    motion = resample(path if isinstance(path, Motion) else retarget_file(path)[0], model.fps)
    if len(motion) < 2:
        name = "the start" if isinstance(path, Motion) else path
        raise ControlError(f"{name}: expected at least 2 frames to start from, found {len(motion)}")
    return motion.cut(0, INIT_FRAMES)


def clip_start(model: MotionModel, path: str | Path | Motion, count: int) -> Start:
    """The first frames of a BVH file, any rig, or of a canonical motion in cm, for count characters.

    They go on where the last of the frames is.

    Raises MotionkitError if the file cannot be used.
    """
    motion = clip_motion(model, path)
    encoded = encode_motion(motion, model.reference_rotations, model.config.layout)
    return Start(
        encoded.features[None].repeat(count, axis=0),
        encoded.contacts[None].repeat(count, axis=0),
        encoded.ground[-1:].repeat(count, axis=0),
    )
