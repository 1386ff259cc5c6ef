"""Baselines that a network must beat: the last frame held, the nearest training clip, and motion matching."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from motionkit.arrays import Array
from motionkit.data.dataset import Clip, Dataset
from motionkit.features.control import TRAJECTORY_COUNT, future_trajectory
from motionkit.lab.held_out import Continue, HeldOut
from motionkit.motion.skeleton import FOOT_JOINTS

MATCHED = (0, 10, 20, 30)  # the nearest clip is matched at these frames before the last initial one
REMAINS = 60  # fewest frames of a training clip after the matched frame
# Motion matching (Clavet 2016): frames between searches, and weights of the trajectory's positions (cm) and directions,
# of foot positions (cm), and of foot and hip velocities (cm/s).
SEARCHED = 20
WEIGHTS = {"places": 0.02, "directions": 1.0, "feet": 0.05, "velocities": 0.01}


def last_frame(dataset: Dataset) -> Continue:
    """Return the baseline that holds the pose of the last initial frame, without velocity."""

    def continues(sequence: HeldOut, number: int) -> Array:
        row = sequence.data.features[sequence.initial - 1].copy()
        for block in (
            "root_yaw_velocity",
            "root_xz_velocity",
            "joint_angular_velocities",
            "joint_velocities",
        ):
            row[dataset.layout.blocks[block]] = 0.0
        return np.repeat(row[None], sequence.frames, axis=0)

    return continues


class _Library:
    """All training frames one after another, with the values that motion matching compares."""

    def __init__(self, dataset: Dataset, clips: Sequence[Clip]) -> None:
        data = [dataset.read(clip) for clip in clips]
        self.features = np.concatenate([d.features for d in data])
        self.contacts = np.concatenate([d.contacts for d in data])
        self.types = np.concatenate([d.types for d in data])
        self.trajectories = np.concatenate(
            [future_trajectory(d.ground, np.arange(len(d.types))) for d in data]
        )
        self.ends = np.repeat(np.cumsum([len(d.types) for d in data]), [len(d.types) for d in data])
        self.starts = self.ends - np.repeat([len(d.types) for d in data], [len(d.types) for d in data])
        self.poses = dataset.layout.blocks["joint_positions"]
        self.feet = dataset.layout.block_columns("joint_positions", FOOT_JOINTS)
        self.speeds = dataset.layout.block_columns("joint_velocities", (*FOOT_JOINTS, 0))

    def matched(self, features: Array, trajectories: Array) -> Array:
        """Return the weighted values (N, D) to compare, from features (N, 276) and trajectories (N, 24)."""
        half = TRAJECTORY_COUNT // 2
        parts = [
            WEIGHTS["places"] * trajectories[:, :half],
            WEIGHTS["directions"] * trajectories[:, half:],
            WEIGHTS["feet"] * features[:, self.feet],
            WEIGHTS["velocities"] * features[:, self.speeds],
        ]
        return np.concatenate(parts, axis=1).astype(np.float32)


def nearest_clip(dataset: Dataset, clips: Sequence[Clip] = ()) -> Continue:
    """Return the baseline that continues with the training clip whose last half second is nearest.

    The clip's last frame is held beyond its end, and its first frame before its beginning. clips are those to choose
    from; all training clips by default.
    """
    library = _Library(dataset, clips or dataset.select("train"))
    rows = np.arange(len(library.ends))
    long = np.flatnonzero((rows - library.starts >= MATCHED[-1]) & (library.ends - rows > REMAINS))
    usable = long if len(long) else rows  # where all clips are short

    def continues(sequence: HeldOut, number: int) -> Array:
        cost = np.zeros(len(usable))
        for back in MATCHED:
            query = sequence.data.features[max(0, sequence.initial - 1 - back), library.poses]
            past = np.maximum(usable - back, library.starts[usable])
            cost += np.linalg.norm(library.features[past][:, library.poses] - query, axis=1)
        at = int(usable[cost.argmin()])
        rows = np.minimum(at + 1 + np.arange(sequence.frames), library.ends[at] - 1)
        return library.features[rows]

    return continues


class Matching:
    """Motion matching over the training clips: plays recorded frames, and searches again every SEARCHED frames.

    Transitions are not blended.
    """

    def __init__(self, dataset: Dataset) -> None:
        self.library = library = _Library(dataset, dataset.select("train"))
        self._table = library.matched(library.features, library.trajectories)
        left = library.ends - np.arange(len(library.ends))
        self._lasts = left > (SEARCHED if (left > SEARCHED).any() else 1)
        self.at = -1  # row of the library that is played

    def begin(self) -> None:
        """Forget what is played."""
        self.at = -1

    def next(self, frame: int, present: Array, kind: int, trajectory: Array) -> int:
        """Return the row of the library to play in a frame.

        Args:
            present: (276,) features of the frame before.
            kind: the requested type, as a number of the dataset.
            trajectory: (24,) the requested trajectory.
        """
        library = self.library
        goes_on = self.at >= 0 and self.at + 1 < library.ends[self.at]
        if frame % SEARCHED == 0 or not goes_on:
            allowed = np.flatnonzero(self._lasts & (library.types == kind))
            allowed = allowed if len(allowed) else np.flatnonzero(self._lasts)
            query = library.matched(present[None], trajectory[None])
            cost = np.square(self._table[allowed] - query).sum(axis=1)
            stay = float(np.square(self._table[self.at] - query).sum()) if goes_on else np.inf
            self.at = int(allowed[cost.argmin()]) if float(cost.min()) < stay else self.at
        self.at += 1
        return self.at


def motion_matching(dataset: Dataset) -> Continue:
    """Return the motion-matching baseline, which gets the types and the trajectory of the test sequence."""
    matching = Matching(dataset)

    def continues(sequence: HeldOut, number: int) -> Array:
        trajectories = future_trajectory(sequence.data.ground, np.arange(len(sequence.data.types)))
        rows: list[Array] = [sequence.data.features[sequence.initial - 1]]
        matching.begin()
        for frame in range(sequence.frames):
            now = sequence.initial - 1 + frame
            row = matching.next(frame, rows[-1], int(sequence.data.types[now]), trajectories[now])
            rows.append(matching.library.features[row])
        return np.stack(rows[1:])

    return continues


FLOORS: dict[str, Callable[[Dataset], Continue]] = {
    "last frame": last_frame,
    "nearest clip": nearest_clip,
    "motion matching": motion_matching,
}
