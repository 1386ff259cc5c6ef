"""Where a type's recordings may be gone over to: the places most like a pose and a trajectory over the ground.

What motion matching seeks among recorded frames (Clavet 2016, "Motion Matching and The Road to Next-Gen
Animation"), here only to choose what a reference shows: the body itself is the network's.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from motionkit.arrays import Array, lower_median
from motionkit.features.control import TRAJECTORY_COUNT, future_trajectory
from motionkit.models.motion_type import ReferenceClip

NEARBY = 90  # frames
# A state is the pose now and so many frames before: how it moves, and what it has just done.
STATE_FRAMES = (0, 5, 15, 30)
# A place that is so far off (cm), or a direction so far (of its length), counts as a pose one deviation off.
PLACE_UNIT, DIRECTION_UNIT = 20.0, 0.5


class MotionIndex:
    """All frames of some recordings in reference_clip.

    Attributes:
        first: the number of each recording's first frame among all frames.
        left: (P,) frames to the end of the recording, the frame itself included.
        moves: (P,) whether at least the type's usual movement follows.
    """

    def __init__(self, reference_clips: Sequence[ReferenceClip]) -> None:
        self.reference_clips = reference_clips
        lengths = [len(reference_clip) for reference_clip in reference_clips]
        self.first = [sum(lengths[:i]) for i in range(len(lengths))]
        self.left = np.concatenate([np.arange(length, 0, -1) for length in lengths])
        movement = np.concatenate([reference_clip.movement for reference_clip in reference_clips])
        self.moves = movement >= lower_median(movement)
        frames = [np.arange(length) for length in lengths]
        states = [pose_states(o, at) for o, at in zip(reference_clips, frames, strict=True)]
        trajectories = [
            future_trajectory(o.ground, at) for o, at in zip(reference_clips, frames, strict=True)
        ]
        self._features = np.concatenate(
            [np.concatenate(states).reshape(len(self.left), -1), _scaled(np.concatenate(trajectories))],
            axis=1,
        )

    def nearest(
        self, state: Array, trajectory: Array, least: int, stay: int | None = None, gain: float = 1.0
    ) -> tuple[int, int]:
        """The recording and frame most like a state (S, 24) and a trajectory (24,) to go.

        Args:
            least: frames that have to be left.
            stay: a place to stay at, unless another costs less than gain times as much. What is near it in its
                recording does not count: of what moves slowly the same second would be played again and again.
        """
        wanted = np.concatenate([state.reshape(-1), _scaled(trajectory)])
        all_costs = np.square(self._features - wanted).sum(axis=1)
        costs = np.where((self.left >= least) & self.moves, all_costs, np.inf)
        if stay is not None:
            costs[max(0, stay - NEARBY) : stay + NEARBY] = np.inf
        best = int(costs.argmin())
        if stay is not None and float(costs[best]) >= gain * float(all_costs[stay]):
            best = stay
        number = max(i for i, first in enumerate(self.first) if first <= best)
        return number, best - self.first[number]


def pose_states(reference_clip: ReferenceClip, frames: Array) -> Array:
    """The poses (..., S, 24) in reference_clip STATE_FRAMES before frames (...)."""
    return reference_clip.poses[np.maximum(frames[..., None] - np.array(STATE_FRAMES), 0)]


def pose_state(reference_clip: ReferenceClip, at: int) -> Array:
    """The poses (S, 24) in reference_clip STATE_FRAMES before a frame."""
    return pose_states(reference_clip, np.array(at))


def _scaled(trajectories: Array) -> Array:
    half = TRAJECTORY_COUNT // 2
    return np.concatenate(
        [trajectories[..., :half] / PLACE_UNIT, trajectories[..., half:] / DIRECTION_UNIT], axis=-1
    )
