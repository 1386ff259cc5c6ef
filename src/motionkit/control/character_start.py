"""The frames a character starts from, and how much of its first type they show."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motionkit.arrays import Array
from motionkit.control.momentum import ground_speeds
from motionkit.control.motion_index import STATE_FRAMES
from motionkit.control.recording_choice import frames_behind
from motionkit.features.decode import integrate_ground
from motionkit.inference.start import Start, clip_start, on_body, type_start
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import Skeleton


@dataclass(frozen=True, eq=False)
class StartState:
    """What the frames before a motion show.

    Attributes:
        poses: (S, 24) state of the last frame (last_poses).
        behind: frames of the first type's performance that have been shown.
        speed: speed over the ground in cm/s at the last frame; None if unknown.
    """

    poses: Array
    behind: int = 0
    speed: float | None = None


@dataclass(frozen=True, eq=False)
class CharacterStart:
    """The frames one character starts from.

    Attributes:
        start: the frames, on the character's body.
        start_state: what they show.
        length: length in frames of the performance that the start pose begins; 0 for other types and for a clip.
    """

    start: Start
    start_state: StartState
    length: float


def character_start(
    model: MotionModel, kind: str, body: Skeleton, init: str | Path | Motion | None = None, choice: int = 0
) -> CharacterStart:
    """Start from a type's own start pose, or from the first frames of a clip.

    Args:
        kind: the first type of the motion.
        body: the skeleton that the network moves.
        init: a BVH file of any rig, or a canonical motion in cm; None takes a start pose.
        choice: picks the start pose, modulo their number.

    Raises:
        MotionkitError: for a file that cannot be used, or a type without start poses.
    """
    start = type_start(model, kind, choice=choice) if init is None else clip_start(model, init, 1)
    features = start.features[0]
    poses, speed = last_poses(model, features), last_speed(model, features)
    if init is not None:
        start_state = StartState(poses, frames_behind(model, kind, poses), speed)
        return CharacterStart(on_body(model, start, body), start_state, 0.0)
    # A start pose is the beginning of a performance, so its frames have been shown.
    length = model.phase_seconds(kind) * model.fps
    start_state = StartState(poses, len(features) if length else 0, speed)
    return CharacterStart(on_body(model, start, body), start_state, length)


def last_poses(model: MotionModel, features: Array) -> Array:
    """State (S, 24) of the last of features (T, 276): the pose embeddings STATE_FRAMES before it."""
    return model.pose_embedding.of(features[[max(0, len(features) - 1 - before) for before in STATE_FRAMES]])


def last_speed(model: MotionModel, features: Array) -> float:
    """Speed over the ground in cm/s at the last of features (T, 276); 0 if T is 1."""
    if len(features) < 2:
        return 0.0
    ground = integrate_ground(features, np.zeros(3), model.fps, model.config.layout)
    return float(ground_speeds(ground, model.fps)[-1])
