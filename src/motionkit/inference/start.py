"""Frames to start from: the model's own seeds, or the beginning of a user's clip."""

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
    """Frames B characters start from: features (B, T, 276), contacts (B, T, 4), place of the last one (B, 3)."""

    features: Array
    contacts: Array
    ground: Array


def type_start(model: MotionModel, kind: str, count: int = 1, choice: int = 0) -> Start:
    """A start pose of a type for count characters, at the origin facing +Z; choice picks which, counted round.

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
    """The same poses on another body, its root as much higher as its legs are longer: as if it had been recorded.

    Models that are not shown bodies know only one, and get the start as it is.
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
    """The length in cm of the left thigh and shin in the first of frames (T, 276)."""
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
    """The first frames of a BVH file, any rig, or of a canonical motion in cm, at the model's rate.

    Raises MotionkitError if the file cannot be used.
    """
    from motionkit.rig.retarget import retarget_file

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
