"""Recorded motion to compare with: stretches of each type, training poses and motion profiles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from motionkit.arrays import Array
from motionkit.data.dataset import Dataset
from motionkit.data.labels import SPLITS
from motionkit.data.phases import type_stretches
from motionkit.errors import DatasetError
from motionkit.metrics.body import Body, body_of
from motionkit.metrics.detectors import detection_windows
from motionkit.motion.skeleton import JOINT_COUNT, MIRROR_JOINTS
from motionkit.training.verdict.extents import EXTENT_SECONDS, Extent, extents_of

SHORTEST = 24  # frames; stretches below 0.4 s are left out
BANK_EVERY = 8  # frames between the stored poses of a training clip
# More stored poses would make hours of recordings take hours to compare; then fewer of each clip are stored.
MOST_POSES = 100_000
POSE_EVERY = 6  # frames between the poses whose nearest neighbour is sought
PROFILE_SECONDS = 7.0
# Limits of a MotionProfile: these quantiles over the recorded windows, widened by these factors. The limit of
# the distance ratio is at least MIN_RATIO, for types with few recordings.
LOWEST, HIGHEST = 0.02, 0.98
CALM, BUSY = 0.1, 0.9  # the same of joint speeds that are usual for a whole roll-out
SLOWER, FASTER, FARTHER, MIN_RATIO = 0.7, 1.4, 1.25, 1.3
TIE = 1.0  # cm per joint; below it one type is as near as another


@dataclass(frozen=True, eq=False)
class Stretch:
    """Recorded motion of one type: type, number of the recording, clip name, split and body.

    The number is that of the recording's first clip in the dataset, also for its mirror image.
    """

    type: str
    clip: int
    name: str
    split: str
    body: Body


@dataclass(frozen=True)
class MotionProfile:
    """Limits measured on the recordings of a type; they judge types without a detector.

    Attributes:
        joint_speed: mean joint speed over all recordings in rad/s.
        usual: joint speeds of calm and of busy recorded windows; the mean is not outside.
        speeds: limits of joint speed in rad/s.
        movements: limits of body movement (bm-euler) in degrees per frame.
        distance: largest mean distance to the nearest recorded pose of the type in cm per joint.
        ratio: largest ratio of that distance to the distance to the nearest pose of any type.
        extents: reach, speeds, air time and steps of the recorded windows, held-out ones included.
        performance: length of a usual window in seconds, for a type that has a phase; 0 for one that goes on.
    """

    kind: int
    joint_speed: float
    usual: tuple[float, float]
    speeds: tuple[float, float]
    movements: tuple[float, float]
    distance: float
    ratio: float
    extents: tuple[Extent, ...]
    performance: float

    @property
    def judges(self) -> bool:
        """Whether it tells its type from others: not with one recording, which cannot be compared with another."""
        return bool(np.isfinite([self.distance, self.ratio]).all())

    def shows(self, body: Body, distances: Array) -> bool:
        """Whether a motion is within the limits. distances (N,) are those to the poses of each type in cm."""
        if not self.speeds[0] <= body.joint_speed() <= self.speeds[1]:
            return False
        if not self.movements[0] <= body.body_movement() <= self.movements[1]:
            return False
        mine = float(distances[self.kind])
        return mine <= self.distance and mine <= self.ratio * max(float(distances.min()), TIE)

    def reaches(self, body: Body) -> bool:
        """Whether a motion reaches as far, goes as fast, flies and steps as the recordings do, within their margins."""
        return self.excess(body) == 0.0

    def excess(self, body: Body) -> float:
        """Return by how much a motion misses the extents, in all."""
        return sum(extent.excess(extent.measure.of(body)) for extent in self.extents)

    def description(self) -> str:
        """Return the limits in words."""
        return (
            f"joint speed {self.speeds[0]:.2f} to {self.speeds[1]:.2f} rad/s, body movement "
            f"{self.movements[0]:.0f} to {self.movements[1]:.0f} degrees per frame, distance to the nearest recorded "
            f"pose of the type at most {self.distance:.1f} cm per joint and {self.ratio:.2f} times that to any type"
        )


@dataclass(frozen=True, eq=False)
class _PoseBank:
    """Poses of training clips, those of one type side by side.

    Attributes:
        centre: (D,) their mean; around it, squared distances are exact enough in float32, which takes half the time.
        poses, squares: (N, D) around the centre, and (N,) their squares.
        clips: (N,) number of the recording of each (Stretch).
        edges: where each type begins, and the end.
    """

    centre: Array
    poses: Array
    squares: Array
    clips: Array
    edges: list[int]

    @classmethod
    def of(cls, poses: Array, kinds: Array, clips: Array, types: int) -> _PoseBank:
        """Return the bank of poses (N, D) with their type ids and clip numbers (N,)."""
        order = np.argsort(kinds, kind="stable")
        centre = poses[order].mean(axis=0).astype(np.float32)
        around = np.ascontiguousarray(poses[order] - centre, np.float32)
        edges = [0, *np.cumsum(np.bincount(kinds, minlength=types), 0).tolist()]
        return cls(centre, around, np.square(around).sum(axis=1), clips[order], edges)

    def distances(self, poses: Array, without: int, types: int) -> Array:
        """Return distances (T, types) in cm per joint of poses (T, D) to the nearest of each type, but of one clip."""
        query = poses.astype(np.float32) - self.centre
        squares = np.square(query).sum(axis=1)[:, None] + self.squares - 2.0 * (query @ self.poses.T)
        distances = np.sqrt(np.maximum(squares, 0.0)) / np.float32(JOINT_COUNT**0.5)
        distances[:, self.clips == without] = np.inf
        out = np.full((len(distances), types), np.inf, np.float32)
        for kind, (start, end) in enumerate(pairwise(self.edges)):
            if end > start:
                out[:, kind] = distances[:, start:end].min(axis=1)
        return out


class RealMotion:
    """The recordings of a dataset. A mirrored copy in the split of its recording counts as training poses only.

    Attributes:
        types, fps: those of the dataset.
        held_out: the split that is held out: "test"; "validation", for which test clips are not read; or "train",
            for which training clips alone are.
        stretches: the recorded stretches.
        training: bodies of the training clips by clip number.
        longest: seconds of the longest training stretch of each type, short ones included.
    """

    def __init__(self, dataset: Dataset, held_out: str = "test") -> None:
        self.types, self.fps, self.held_out = dataset.types, dataset.fps, held_out
        self._performed = frozenset(dataset.phase_seconds)
        self.stretches: list[Stretch] = []
        self.training: dict[int, Body] = {}
        self.longest: dict[str, float] = {}
        poses, kinds, clips = [], [], []
        splits = SPLITS[: SPLITS.index(held_out) + 1]
        training_frames = sum(clip.frames for clip in dataset.clips if clip.split == "train")
        every = max(BANK_EVERY, math.ceil(2 * training_frames / MOST_POSES))
        # A mirrored clip whose recording is in the same split adds nothing; where types have one recording, one of the
        # two trains and the other is held out.
        plain = {(clip.start, clip.split) for clip in dataset.clips if not clip.mirrored}
        numbers: dict[int, int] = {}
        for index, clip in enumerate(dataset.clips):
            number = numbers.setdefault(clip.start, index)
            if (clip.mirrored and (clip.start, clip.split) in plain) or clip.split not in splits:
                continue
            data = dataset.read(clip)
            body = body_of(dataset.motion(clip, data))
            for start, end, kind in type_stretches(data.types):
                if clip.split == "train":
                    name, seconds = dataset.types[kind], (end - start) / self.fps
                    self.longest[name] = max(self.longest.get(name, 0.0), seconds)
                if end - start >= SHORTEST:
                    part = body.cut(start, end)
                    self.stretches.append(Stretch(dataset.types[kind], number, clip.name, clip.split, part))
            if clip.split == "train":
                self.training[number] = body
                some, kind_ids = body.poses(every), data.types[::every]
                poses += [some, mirrored_poses(some)]
                kinds += [kind_ids, dataset.mirrored_type_ids[kind_ids]]
                clips.append(np.full(2 * len(some), number))
        if not poses:
            raise DatasetError(f"{dataset.folder}: the dataset has no training clips to compare with")
        self._bank = _PoseBank.of(
            np.concatenate(poses), np.concatenate(kinds), np.concatenate(clips), len(self.types)
        )
        self._profiles: dict[str, MotionProfile | None] = {}

    def of_type(self, kind: str, split: str | None = None) -> list[Stretch]:
        """Return the stretches of a type, of one split or of both."""
        return [s for s in self.stretches if s.type == kind and split in (None, s.split)]

    def pose_distances(self, body: Body, without: int = -1) -> Array:
        """Return distances (T', N) in cm per joint to the nearest training pose of each type, every POSE_EVERY frames.

        The poses of recording `without` are left out. The distance to a type without poses is infinite.
        """
        return self._bank.distances(body.poses(POSE_EVERY), without, len(self.types))

    def profile(self, kind: str) -> MotionProfile | None:
        """Return the motion profile of a type; None for a type without training clips."""
        if kind not in self._profiles:
            found = self.of_type(kind, "train")
            self._profiles[kind] = self._measure_profile(kind, found) if found else None
        return self._profiles[kind]

    def _measure_profile(self, kind: str, found: list[Stretch]) -> MotionProfile:
        speeds, movements, distances, ratios = [], [], [], []
        index = self.types.index(kind)
        for stretch in found:
            for window in detection_windows(stretch.body, PROFILE_SECONDS):
                speeds.append(window.joint_speed())
                movements.append(window.body_movement())
                means = self.pose_distances(window, without=stretch.clip).mean(axis=0)
                distances.append(float(means[index]))
                # Of a single type with a single clip nothing is left to compare with.
                nearest = float(means.min())
                ratios.append(float(means[index]) / max(nearest, 1e-6) if nearest < np.inf else np.inf)
        frames = np.array([float(len(s.body)) for s in found])
        rates = np.array([s.body.joint_speed() for s in found])
        mean = float((frames * rates).sum() / frames.sum())
        windows = [w for s in self.of_type(kind) for w in detection_windows(s.body, EXTENT_SECONDS)]
        return MotionProfile(
            index,
            mean,
            (min(mean, _quantile(speeds, CALM)), max(mean, _quantile(speeds, BUSY))),
            (SLOWER * _quantile(speeds, LOWEST), FASTER * _quantile(speeds, HIGHEST)),
            (SLOWER * _quantile(movements, LOWEST), FASTER * _quantile(movements, HIGHEST)),
            FARTHER * _quantile(distances, HIGHEST),
            max(MIN_RATIO, _quantile(ratios, HIGHEST)),
            extents_of(windows),
            float(np.median([w.seconds for w in windows])) if kind in self._performed else 0.0,
        )


def mirrored_poses(poses: Array) -> Array:
    """Return the mirror images of poses (N, 69)."""
    joints = poses.reshape(-1, JOINT_COUNT, 3)[:, list(MIRROR_JOINTS)]
    return (joints * np.array([-1.0, 1.0, 1.0], np.float32)).reshape(len(joints), -1)


def _quantile(values: list[float], share: float) -> float:
    """Return the quantile of the finite values; infinity if there are none."""
    finite = np.array([v for v in values if v < float("inf")])
    return float(np.quantile(finite, share)) if len(finite) else float("inf")
