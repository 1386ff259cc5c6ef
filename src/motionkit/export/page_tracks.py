"""Precomputed reference recordings of each type for a web page, which only plays them back.

A track is the output of one reference player: for each frame the pose 5 frames ahead, the phase, and the root's
position and heading. A bridge at its end blends back to its first frame, so that it can repeat.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array, lerp
from motionkit.control.blending import LONGEST_BLEND
from motionkit.control.momentum import ground_speeds
from motionkit.control.reference_player import ReferencePlayer
from motionkit.features.reference import EMBEDDING_COUNT, PAUSE
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind, MotionType
from motionkit.motion.rotations import rotate_ground

SECONDS = 12.0  # s, length of most tracks
STRIKES_SECONDS = 5.0  # s, length of tracks of strikes or jumps
STEPS_SECONDS = 1.5  # s, length of a gait's first steps from standing
TRACKS, STRIKE_TRACKS = 6, 12  # tracks per type, from which a seed chooses
AFTER_EVENT = 10  # frames kept after the last strike or jump


@dataclass(frozen=True, eq=False)
class Track:
    """L frames of a type.

    Attributes:
        poses: (L, 24) pose embeddings, each 5 frames ahead.
        phases: (L,) negative outside performances, strikes and jumps.
        ground: (L, 3) root x, z (cm) and heading (radians), starting at the origin.
        performance: frames to perform the type once, until shortly after the first strike or jump; 0 for lasting types.
        speed: cm/s, at the first frame if the type has phases, else the mean.
    """

    poses: Array
    phases: Array
    ground: Array
    performance: int
    speed: float

    def __len__(self) -> int:
        return len(self.ground)


def type_tracks(model: MotionModel, name: str) -> list[Track]:
    """The tracks of a type: of gaits their first steps; none if the type uses no recordings."""
    kind = model.types[name]
    if not kind.reference_clips or kind.kind is MotionKind.STANCE or not model.uses_references:
        return []
    if kind.kind is MotionKind.PERFORMANCE:
        count = len(kind.reference_clips)
    else:
        count = STRIKE_TRACKS if kind.kind.phased or kind.kind.steered else TRACKS
    return [_track(model, name, choice) for choice in range(count)]


def _track(model: MotionModel, name: str, choice: int) -> Track:
    kind = model.types[name]
    steered = kind.kind.steered  # first steps from standing, as control/memory.py has them
    player = ReferencePlayer(model, choice, few=steered)
    player.begin(name, speed=0.0 if steered else None)
    assert player.clip is not None
    performance = (
        player.event_frames() + (0 if kind.kind is MotionKind.PERFORMANCE else AFTER_EVENT)
        if kind.kind.phased
        else 0
    )
    poses, phases, steps = [], [], []
    for _ in range(_frames(kind, model.fps, len(player.clip))):
        controls = player.play(1)
        poses.append(controls.reference[0, :EMBEDDING_COUNT])
        phases.append(controls.phase[0])
        steps.append(_step(player.clip.ground, max(player.at - 1, 0)))
    length = len(poses)
    if kind.kind.phased and kind.kind is not MotionKind.PERFORMANCE:  # keep the last strike whole
        ends = np.flatnonzero(np.diff(np.array(phases) >= 0.0, append=False)) + 1 + AFTER_EVENT
        length = int(max(ends[ends <= length], default=length))
    bridge = PAUSE if kind.kind.phased else LONGEST_BLEND
    share = np.arange(1, bridge + 1, dtype=np.float32)[:, None] / (bridge + 1)
    poses_there, steps_there = np.stack(poses[:length]), np.stack(steps[:length])
    poses_back = lerp(poses_there[-1], poses_there[0], share)
    ground = _walked(np.concatenate([steps_there, lerp(steps_there[-1], steps_there[0], share)]))
    return Track(
        np.concatenate([poses_there, poses_back]),
        np.concatenate([phases[:length], np.full(bridge, -1.0)]).astype(np.float32),
        ground,
        performance,
        float(ground_speeds(ground, model.fps)[: 1 if kind.kind.phased else length].mean()),
    )


def _frames(kind: MotionType, fps: float, clip: int) -> int:
    """Length of a track without its bridge, in frames; a performance takes one clip."""
    if kind.kind is MotionKind.PERFORMANCE:
        return clip
    if kind.kind.steered:
        return round(STEPS_SECONDS * fps)
    return round((STRIKES_SECONDS if kind.kind.phased else SECONDS) * fps)


def _step(ground: Array, at: int) -> Array:
    """Step from a frame to the next in the heading frame: x, z and turn (3,). The last frame repeats a step."""
    at = min(at, len(ground) - 2)
    turn = ground[at + 1, 2] - ground[at, 2]
    return np.append(rotate_ground(-ground[at, 2], ground[at + 1, :2] - ground[at, :2]), turn)


def _walked(steps: Array) -> Array:
    """Positions x, z and headings (L, 3), integrated from steps (L, 3), starting at the origin."""
    out = np.zeros((len(steps) + 1, 3), np.float64)
    for n, (x, z, turn) in enumerate(steps):
        out[n + 1, :2] = out[n, :2] + rotate_ground(out[n, 2], np.array([x, z]))
        out[n + 1, 2] = out[n, 2] + turn
    return out[:-1].astype(np.float32)
