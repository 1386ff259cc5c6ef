"""Variety: how much of the recordings a motion shows, how long it follows one of them, and whether it loops.

Poses are joint positions (T, 69) in cm in the heading frame, at POSE_RATE.
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
WINDOW = 10  # poses of a window, half a second, whose nearest match in the recordings is searched
STRIDE = 5  # poses between the starts of two windows
# A window continues along a recording if its match is at most this many poses from STRIDE after the last match.
STRAY = 2
# A motion loops after a time lag if the median distance of poses so far apart in time is below LOOP_SHARE of the median
# over all pairs of poses. Lags start at LOOP_SECONDS.
LOOP_SHARE, LOOP_SECONDS = 0.3, 5.0
REPLAY_SECONDS = 5.0  # after which a recorded place that is shown again counts as replayed


def pose_gap(first: Array, second: Array) -> float:
    """Mean distance per joint in cm of two motions' poses (T, 69) at equal times; the longer motion is cut.

    Raises:
        MotionkitError: one of them is empty.
    """
    frames = min(len(first), len(second))
    if frames == 0:
        raise MotionkitError("the distance of two motions needs at least 1 pose of each, found 0")
    offsets = first[:frames].astype(np.float64) - second[:frames]
    return float(np.linalg.norm(offsets.reshape(frames, JOINT_COUNT, 3), axis=-1).mean())


def mean_pose_gap(motions: Sequence[Array], least: int = WINDOW) -> float | None:
    """Mean pose_gap over all pairs of motions that have at least `least` poses; None without a pair."""
    long = [poses for poses in motions if len(poses) >= least]
    gaps = [pose_gap(a, b) for i, a in enumerate(long) for b in long[:i]]
    return sum(gaps) / len(gaps) if gaps else None


@dataclass(frozen=True, eq=False)
class Places:
    """The nearest window of the recordings for each window of a motion.

    Attributes:
        recordings, tracks: (W,) number of the recording, and of the track counted over all recordings.
        poses: (W,) pose of the track at which the nearest window begins.
        distances: (W,) distance in cm per joint.
    """

    recordings: Array
    tracks: Array
    poses: Array
    distances: Array

    def longest_stretch(self) -> float:
        """Return the longest time in seconds for which the motion follows one recording."""
        if not len(self.tracks):
            return 0.0
        steps = np.diff(self.poses)
        along = (np.diff(self.tracks) == 0) & (np.abs(steps - STRIDE) <= STRAY)
        longest = max((end - start for start, end in spans(along)), default=0)
        return (longest * STRIDE + WINDOW) / POSE_RATE

    def replayed(self) -> float:
        """Return the share of windows whose nearest recorded place was nearest REPLAY_SECONDS or more before, too."""
        apart = round(REPLAY_SECONDS * POSE_RATE / STRIDE)
        found = [
            bool(((self.tracks[:before] == track) & (np.abs(self.poses[:before] - pose) <= STRAY)).any())
            for before, (track, pose) in enumerate(
                zip(self.tracks[apart:], self.poses[apart:], strict=True), start=1
            )
        ]
        return sum(found) / max(1, len(self.tracks))


class RecordingWindows:
    """All windows of WINDOW poses of some recordings; a recording may have several tracks, such as a mirrored one."""

    def __init__(self, recordings: Sequence[Sequence[Array]]) -> None:
        """Collect the windows of the tracks, poses (T, 69), of each recording; shorter tracks are left out."""
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
        """Return the nearest window, but of one recording, for each window of poses (T, 69)."""
        windows = _windows(poses, STRIDE).astype(np.float32)
        left_out = self._numbers == without
        if not len(windows) or left_out.all():
            none = np.zeros(0, np.int64)
            return Places(none, none, none, np.zeros(0))
        # Squared distances, without the norm of the searched window, which is the same for all rows.
        costs = self._squares - 2.0 * (windows @ self._rows.T)
        costs[:, left_out] = np.inf
        best = costs.argmin(axis=1)
        distances = np.linalg.norm(windows - self._rows[best], axis=1) / (WINDOW * JOINT_COUNT) ** 0.5
        return Places(self._numbers[best], self._tracks[best], self._starts[best], distances)


def drawn_share(places: Sequence[Places], lengths: Array) -> float:
    """Share of the recordings, by lengths (N,), that are nearest to at least one window of the motions."""
    used = np.unique(np.concatenate([place.recordings for place in places])).astype(np.int64)
    return float(lengths[used].sum() / lengths.sum())


def loop_seconds(poses: Array) -> MetricValue:
    """Shortest time in seconds, from LOOP_SECONDS to half the motion, after which poses (T, 69) repeat; else None."""
    distances = distances_between(poses, poses)
    usual = float(np.median(distances[np.triu_indices(len(poses), 1)]))
    first, last = round(LOOP_SECONDS * POSE_RATE), len(poses) // 2
    at = [float(np.median(np.diagonal(distances, lag))) for lag in range(first, last)]
    limit = LOOP_SHARE * usual
    for index, value in enumerate(at):
        lower_after = index + 1 < len(at) and at[index + 1] < value
        if value <= limit and not lower_after:
            share = value / usual if usual else 0.0  # a motion that stands still repeats itself at any time
            return MetricValue("loop", (first + index) / POSE_RATE, "s", {"share": share})
    return MetricValue("loop", None, "s", reason=f"no repetition within {last / POSE_RATE:g} s")


def _windows(poses: Array, stride: int) -> Array:
    """Windows (W, WINDOW * 69) of poses (T, 69), stride poses apart."""
    starts = range(0, len(poses) - WINDOW + 1, stride)
    if not len(starts):
        return np.zeros((0, WINDOW * poses.shape[1]), poses.dtype)
    return np.stack([poses[start : start + WINDOW].reshape(-1) for start in starts])
