"""How a character begins: frames to start from, and how much of its first type they have shown."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from motionkit.arrays import Array
from motionkit.control.reference_player import frames_behind, last_poses, last_speed
from motionkit.inference.start import Start, clip_start, on_body, type_start
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import Skeleton


@dataclass(frozen=True, eq=False)
class Opening:
    """The frames one character starts from.

    Attributes:
        start: the frames, on the character's body.
        near: (S, 24) pose embeddings of the last of them (last_poses).
        length: frames of the performance that the start pose begins; 0 for other types, and for frames of a clip.
        behind: frames of the first type's performance that they have shown already.
        speed: over the ground in cm/s at their end.
    """

    start: Start
    near: Array
    length: float
    behind: int
    speed: float


def opening(
    model: MotionModel, kind: str, body: Skeleton, init: str | Path | Motion | None = None, choice: int = 0
) -> Opening:
    """Start from a type's own start pose, or from the first frames of a clip.

    Args:
        kind: the first type to be shown.
        body: the skeleton that the network moves.
        init: a BVH file of any rig, or a canonical motion in cm; None takes a start pose.
        choice: picks the start pose, counted round.

    Raises:
        MotionkitError: for a file that cannot be used, or a type without start poses.
    """
    start = type_start(model, kind, choice=choice) if init is None else clip_start(model, init, 1)
    shown = start.features[0]
    near, speed = last_poses(model, shown), last_speed(model, shown)
    if init is not None:
        return Opening(on_body(model, start, body), near, 0.0, frames_behind(model, kind, near), speed)
    # A start pose is the beginning of a performance; what comes after it goes on from there.
    length = model.phase_seconds(kind) * model.fps
    behind = len(shown) if length else 0
    return Opening(on_body(model, start, body), near, length, behind, speed)
