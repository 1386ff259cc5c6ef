"""Where a type's recordings may be gone over to: the places most like a pose and a way over the ground.

What motion matching seeks among recorded frames (Clavet 2016, "Motion Matching and The Road to Next-Gen
Animation"), here only to choose what a guide shows: the body itself is the network's.
"""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Array, lower_median
from motionkit.features.control import TRAJECTORY_COUNT, future_trajectory
from motionkit.models.checkpoint import Outline

NEARBY = 90  # frames
# A state is the pose now and so many frames before: how it moves, and what it has just done.
STATE_FRAMES = (0, 5, 15, 30)
# A place that is so far off (cm), or a direction so far (of its length), counts as a pose one deviation off.
PLACE_UNIT, DIRECTION_UNIT = 20.0, 0.5


class Places:
    """All frames of some recordings in outline.

    Attributes:
        first: the number of each recording's first frame among all frames.
        left: (P,) frames to the end of the recording, the frame itself included.
        moves: (P,) whether at least the type's usual movement follows.
    """

    def __init__(self, outlines: list[Outline]) -> None:
        self.outlines = outlines
        lengths = [len(outline) for outline in outlines]
        self.first = [sum(lengths[:i]) for i in range(len(lengths))]
        self.left = np.concatenate([np.arange(length, 0, -1) for length in lengths])
        movement = np.concatenate([outline.movement for outline in outlines])
        self.moves = movement >= lower_median(movement)
        frames = [np.arange(length) for length in lengths]
        states = [pose_states(o, at) for o, at in zip(outlines, frames, strict=True)]
        ways = [future_trajectory(o.ground, at) for o, at in zip(outlines, frames, strict=True)]
        self._features = np.concatenate(
            [np.concatenate(states).reshape(len(self.left), -1), _scaled(np.concatenate(ways))], axis=1
        )

    def nearest(
        self, state: Array, way: Array, least: int, stay: int | None = None, gain: float = 1.0
    ) -> tuple[int, int]:
        """The recording and frame most like a state (S, 24) and a trajectory (24,) to go.

        Args:
            least: frames that have to be left.
            stay: a place to stay at, unless another costs less than gain times as much. What is near it in its
                recording does not count: of what moves slowly the same second would be played again and again.
        """
        wanted = np.concatenate([state.reshape(-1), _scaled(way)])
        all_costs = np.square(self._features - wanted).sum(axis=1)
        costs = np.where((self.left >= least) & self.moves, all_costs, np.inf)
        if stay is not None:
            costs[max(0, stay - NEARBY) : stay + NEARBY] = np.inf
        best = int(costs.argmin())
        if stay is not None and float(costs[best]) >= gain * float(all_costs[stay]):
            best = stay
        number = max(i for i, first in enumerate(self.first) if first <= best)
        return number, best - self.first[number]


def pose_states(outline: Outline, frames: Array) -> Array:
    """The poses (..., S, 24) in outline STATE_FRAMES before frames (...)."""
    return outline.poses[np.maximum(frames[..., None] - np.array(STATE_FRAMES), 0)]


def pose_state(outline: Outline, at: int) -> Array:
    """The poses (S, 24) in outline STATE_FRAMES before a frame."""
    return pose_states(outline, np.array(at))


def _scaled(ways: Array) -> Array:
    half = TRAJECTORY_COUNT // 2
    return np.concatenate([ways[..., :half] / PLACE_UNIT, ways[..., half:] / DIRECTION_UNIT], axis=-1)
