"""Motion matching: finds the frames of reference clips that are most like a pose and a trajectory.

The search is that of Clavet 2016, "Motion Matching and The Road to Next-Gen Animation". It only chooses the reference
poses; the network makes the motion.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from motionkit.arrays import Array, lower_median
from motionkit.features.control import TRAJECTORY_COUNT, future_trajectory
from motionkit.models.motion_type import ReferenceClip

NEARBY = 90  # frames around the present one that a search skips
# A state holds the poses this many frames ago. It tells how the body moves and what it has just done.
STATE_FRAMES = (0, 5, 15, 30)
# Errors of a position (cm) and of a unit direction that cost as much as an embedding value off by one deviation.
POSITION_UNIT, DIRECTION_UNIT = 20.0, 0.5


class MotionIndex:
    """All frames of some clips, with their states and trajectories.

    Attributes:
        clips: the clips, in the given order.
        first: index of each clip's first frame among all frames.
        left: (F,) frames to the end of the clip, including the frame.
        moves: (F,) whether at least median movement follows.
    """

    def __init__(self, clips: Sequence[ReferenceClip], rests: bool = False) -> None:
        """Index the clips; with rests, frames with little movement after them count too (moves is all True)."""
        self.clips = tuple(clips)
        lengths = [len(clip) for clip in clips]
        self.first = [sum(lengths[:i]) for i in range(len(lengths))]
        self.left = np.concatenate([np.arange(length, 0, -1) for length in lengths])
        movement = np.concatenate([clip.movement for clip in clips])
        self.moves = (movement >= lower_median(movement)) | rests
        frames = [np.arange(length) for length in lengths]
        states = [pose_states(clip, at) for clip, at in zip(clips, frames, strict=True)]
        trajectories = [future_trajectory(clip.ground, at) for clip, at in zip(clips, frames, strict=True)]
        self._features = np.concatenate(
            [np.concatenate(states).reshape(len(self.left), -1), _scaled(np.concatenate(trajectories))],
            axis=1,
        )

    def nearest(
        self, state: Array, trajectory: Array, least: int, stay: int | None = None, gain: float = 1.0
    ) -> tuple[int, int]:
        """Return the clip and the frame most like a state (S, 24) and a trajectory (24,).

        Args:
            least: frames that must follow in the clip.
            stay: index of the present frame, which wins unless another costs less than gain times as much. Frames near
                it do not count, because in a slow motion the same second would play again and again.
            gain: see stay.
        """
        query = np.concatenate([state.reshape(-1), _scaled(trajectory)])
        all_costs = np.square(self._features - query).sum(axis=1)
        costs = np.where((self.left >= least) & self.moves, all_costs, np.inf)
        if stay is not None:
            costs[max(0, stay - NEARBY) : stay + NEARBY] = np.inf
        best = int(costs.argmin())
        if stay is not None and float(costs[best]) >= gain * float(all_costs[stay]):
            best = stay
        number = max(i for i, first in enumerate(self.first) if first <= best)
        return number, best - self.first[number]


def state_costs(clip: ReferenceClip, frames: Sequence[int], near: Array) -> Array:
    """Squared distances (N,) of a clip's states at frames from a state (S, 24), over those of its poses that exist."""
    at = np.asarray(frames)
    known = at[:, None] >= np.array(STATE_FRAMES)
    apart = np.square(pose_states(clip, at) - near).sum(axis=2)
    return np.asarray((apart * known).sum(axis=1) * (len(STATE_FRAMES) / known.sum(axis=1)))


def pose_states(clip: ReferenceClip, frames: Array) -> Array:
    """States (..., S, 24) of a clip at frames (...): the pose embeddings STATE_FRAMES before them."""
    return clip.poses[np.maximum(frames[..., None] - np.array(STATE_FRAMES), 0)]


def pose_state(clip: ReferenceClip, at: int) -> Array:
    """State (S, 24) of a clip at a frame."""
    return pose_states(clip, np.array(at))


def _scaled(trajectories: Array) -> Array:
    half = TRAJECTORY_COUNT // 2
    return np.concatenate(
        [trajectories[..., :half] / POSITION_UNIT, trajectories[..., half:] / DIRECTION_UNIT], axis=-1
    )
