"""How much of the recordings a motion shows, how long it goes along one of them, and whether it repeats itself.

Poses are joint positions (T, 69) in cm relative to the ground below the root, turned to its heading, at POSE_RATE.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array, distances_between, spans
from motionkit.errors import MotionkitError
from motionkit.metrics.value import MetricValue
from motionkit.motion.skeleton import JOINT_COUNT

POSE_RATE = 20.0  # poses a second
WINDOW = 10  # poses: half a second, which is sought in the recordings
STRIDE = 5  # poses between two windows that are sought
# A window goes on along a recording if its place there is at most so many poses from where the last one led.
STRAY = 2
# A motion repeats itself after a time if it is then, for at least half of the motion, this share of its usual
# distance between two poses from where it was.
LOOP_SHARE, LOOP_SECONDS = 0.3, 5.0


def pose_gap(first: Array, second: Array) -> float:
    """Mean distance per joint in cm between the poses (T, 69) of two motions at equal times, over their common length.

    Raises:
        MotionkitError: one of them is empty.
    """
    frames = min(len(first), len(second))
    if frames == 0:
        raise MotionkitError("the distance of two motions needs at least 1 pose of each, found 0")
    offsets = first[:frames].astype(np.float64) - second[:frames]
    return float(np.linalg.norm(offsets.reshape(frames, JOINT_COUNT, 3), axis=-1).mean())


def mean_pose_gap(motions: Sequence[Array], least: int = WINDOW) -> float | None:
    """Mean pose_gap over all pairs of motions of at least so many poses; None without a pair."""
    long = [poses for poses in motions if len(poses) >= least]
    gaps = [pose_gap(a, b) for i, a in enumerate(long) for b in long[:i]]
    return sum(gaps) / len(gaps) if gaps else None


@dataclass(frozen=True, eq=False)
class Places:
    """Where in the recordings the windows of a motion are nearest.

    Attributes:
        recordings, tracks: (W,) numbers of the recordings, and of the tracks among all.
        poses: (W,) number of the pose in the track at which the window begins.
        distances: (W,) distance in cm per joint.
    """

    recordings: Array
    tracks: Array
    poses: Array
    distances: Array

    def longest_stretch(self) -> float:
        """Return the longest time in seconds for which the nearest place goes on along one recording."""
        if not len(self.tracks):
            return 0.0
        steps = np.diff(self.poses)
        along = (np.diff(self.tracks) == 0) & (np.abs(steps - STRIDE) <= STRAY)
        longest = max((end - start for start, end in spans(along)), default=0)
        return (longest * STRIDE + WINDOW) / POSE_RATE


class RecordingWindows:
    """All windows of WINDOW poses of some recordings; recordings may have several tracks, such as a mirrored one."""

    def __init__(self, recordings: Sequence[Sequence[Array]]) -> None:
        """recordings: for each the poses (T, 69) of its tracks; tracks shorter than a window are left out."""
        tracks = [(number, poses) for number, recording in enumerate(recordings) for poses in recording]
        rows = [_windows(poses, 1) for _, poses in tracks]
        if not sum(map(len, rows)):
            raise MotionkitError(f"expected recordings of at least {WINDOW} poses")
        self._rows = np.concatenate(rows).astype(np.float32)
        self._squares = np.square(self._rows).sum(axis=1)
        self._numbers = np.concatenate(
            [np.full(len(row), number) for row, (number, _) in zip(rows, tracks, strict=True)]
        )
        self._tracks = np.concatenate([np.full(len(row), track) for track, row in enumerate(rows)])
        self._starts = np.concatenate([np.arange(len(row)) for row in rows])

    def places(self, poses: Array, without: int = -1) -> Places:
        """Return the nearest places of a motion's windows, STRIDE poses apart.

        Args:
            poses: (T, 69) of the motion.
            without: number of a recording that is left out.
        """
        wanted = _windows(poses, STRIDE).astype(np.float32)
        left_out = self._numbers == without
        if not len(wanted) or left_out.all():
            none = np.zeros(0, np.int64)
            return Places(none, none, none, np.zeros(0))
        # Squared distances but for the length of the window itself, which is the same for all rows.
        costs = self._squares - 2.0 * (wanted @ self._rows.T)
        costs[:, left_out] = np.inf
        best = costs.argmin(axis=1)
        distances = np.linalg.norm(wanted - self._rows[best], axis=1) / (WINDOW * JOINT_COUNT) ** 0.5
        return Places(self._numbers[best], self._tracks[best], self._starts[best], distances)


def drawn_share(places: Sequence[Places], lengths: Array) -> float:
    """Share of the recordings, by length (N,), that motions come nearest to in at least one window."""
    used = np.unique(np.concatenate([place.recordings for place in places])).astype(np.int64)
    return float(lengths[used].sum() / lengths.sum())


def loop_seconds(poses: Array) -> MetricValue:
    """The shortest time, from LOOP_SECONDS on, after which a motion repeats itself; None if it does not.

    Args:
        poses: (T, 69) at POSE_RATE. Times up to half of the motion are tried.
    """
    distances = distances_between(poses, poses)
    usual = float(np.median(distances[np.triu_indices(len(poses), 1)]))
    first, last = round(LOOP_SECONDS * POSE_RATE), len(poses) // 2
    at = [float(np.median(np.diagonal(distances, lag))) for lag in range(first, last)]
    limit = LOOP_SHARE * usual
    for index, value in enumerate(at):
        lower_after = index + 1 < len(at) and at[index + 1] < value
        if value < limit and not lower_after:
            return MetricValue("loop", (first + index) / POSE_RATE, "s", {"share": value / usual})
    return MetricValue("loop", None, "s", reason=f"no repetition within {last / POSE_RATE:g} s")


def _windows(poses: Array, stride: int) -> Array:
    """Windows (W, WINDOW * 69) of poses (T, 69), stride poses apart."""
    starts = range(0, len(poses) - WINDOW + 1, stride)
    if not len(starts):
        return np.zeros((0, WINDOW * poses.shape[1]), poses.dtype)
    return np.stack([poses[start : start + WINDOW].reshape(-1) for start in starts])
