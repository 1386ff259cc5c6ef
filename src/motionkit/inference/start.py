"""Frames that characters start from: start poses of the model, or the beginning of a user's clip."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import ControlError
from motionkit.features.decode import decode_motion
from motionkit.features.encode import encode_motion
from motionkit.features.layout import feature_layout
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion, resample
from motionkit.motion.skeleton import JOINT_NAMES, Skeleton, leg_length

INIT_FRAMES = 87  # the receptive field; the paper's number for its comparisons


@dataclass(frozen=True, eq=False)
class Start:
    """First frames of B characters: features (B, T, 276), contacts (B, T, 4), place of the last frame (B, 3)."""

    features: Array
    contacts: Array
    ground: Array


def type_start(model: MotionModel, kind: str, count: int = 1, choice: int = 0) -> Start:
    """A start pose of a type for count characters, at the origin facing +Z; choice, modulo their number, picks it.

    Raises ControlError if the model has none.
    """
    known = model.types.get(kind)
    if known is None or not known.start_poses:
        raise ControlError(f"the model has no frames to start {kind!r} from")
    pose = known.start_poses[choice % len(known.start_poses)]
    return Start(
        pose.features[None].repeat(count, axis=0),
        pose.contacts[None].repeat(count, axis=0),
        np.zeros((count, 3), np.float32),
    )


def on_body(model: MotionModel, start: Start, skeleton: Skeleton) -> Start:
    """Put the poses on another body, with root positions scaled by its leg length.

    The start stays as it is for models that do not take skeletons as input.
    """
    if not model.shows_bodies:
        return start
    layout, kept = model.config.layout, []
    reach = _leg_reach(start.features[0], layout)
    for features in start.features:
        motion = decode_motion(features, skeleton, model.fps, None, model.reference_rotations, layout)
        share = np.float32(leg_length(skeleton) / reach)
        motion = replace(motion, root_positions=motion.root_positions * share)
        encoded = encode_motion(motion, model.reference_rotations, layout)
        kept.append(encoded.features)
    return replace(start, features=np.stack(kept))


def _leg_reach(features: Array, layout: str) -> float:
    """Length in cm of the left thigh plus shin in the first frame of features (T, 276)."""
    columns = {
        (c.joint, c.component): i
        for i, c in enumerate(feature_layout(layout).columns)
        if c.block == "joint_positions"
    }
    hip, knee, ankle = (
        features[0, [columns[JOINT_NAMES.index(name), k] for k in range(3)]]
        for name in ("LeftUpLeg", "LeftLeg", "LeftFoot")
    )
    return float(np.linalg.norm(knee - hip) + np.linalg.norm(ankle - knee))


def clip_motion(model: MotionModel, path: str | Path | Motion) -> Motion:
    """The first INIT_FRAMES frames, at the model's rate, of a BVH file of any rig or of a canonical motion in cm.

    Raises MotionkitError if the file cannot be used.
    """
    from motionkit.rig.on_rig import file_on_floor

    motion = resample(path if isinstance(path, Motion) else file_on_floor(path), model.fps)
    if len(motion) < 2:
        name = "the start" if isinstance(path, Motion) else path
        raise ControlError(f"{name}: expected at least 2 frames to start from, found {len(motion)}")
    return motion.cut(0, INIT_FRAMES)


def clip_start(model: MotionModel, path: str | Path | Motion, count: int) -> Start:
    """The first frames of a BVH file of any rig, or of a canonical motion in cm, for count characters.

    The characters continue from the place of the last frame.

    Raises MotionkitError if the file cannot be used.
    """
    motion = clip_motion(model, path)
    encoded = encode_motion(motion, model.reference_rotations, model.config.layout)
    return Start(
        encoded.features[None].repeat(count, axis=0),
        encoded.contacts[None].repeat(count, axis=0),
        encoded.ground[-1:].repeat(count, axis=0),
    )
