"""Recorded motion as a measure: stretches of each type, the poses of the training set, and its profile."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from motionkit.arrays import Array, distances_between
from motionkit.data.dataset import Dataset
from motionkit.data.phases import type_stretches
from motionkit.errors import DatasetError
from motionkit.evaluation.body import Body, body_of
from motionkit.evaluation.detectors import sign_windows
from motionkit.features.decode import decode_motion
from motionkit.motion.skeleton import JOINT_COUNT, MIRROR_JOINTS

SHORTEST = 24  # frames; stretches under 0.4 s show nothing
BANK_EVERY = 8  # frames between the poses that are kept of a training clip
POSE_EVERY = 6  # frames between the poses that are looked for
PROFILE_SECONDS = 7.0
# MotionProfile: the limits lie at these quantiles of the recordings' windows, wider by these factors. Where a type
# has few recordings the detour to its own poses may be DETOUR at least.
LOWEST, HIGHEST = 0.02, 0.98
SLOWER, FASTER, FARTHER, DETOUR = 0.7, 1.4, 1.25, 1.3
TIE = 1.0  # cm a joint, below which one type is as near as another


@dataclass(frozen=True, eq=False)
class Stretch:
    """Recorded motion of one type: clip number in the dataset, split, and the body."""

    type: str
    clip: int
    name: str
    split: str
    body: Body


@dataclass(frozen=True)
class MotionProfile:
    """How a type is done that has no kinematic detector of its own, measured on its recordings.

    Attributes:
        kind: index of the type.
        joint_speed: mean over all recordings, rad/s.
        speeds, movements: limits of joint speed (rad/s) and of body movement (bm-euler, degrees per frame).
        distance: largest mean distance (cm a joint) to the nearest recorded pose of the type.
        detour: largest ratio of that distance to the one to the nearest pose of any type.
    """

    kind: int
    joint_speed: float
    speeds: tuple[float, float]
    movements: tuple[float, float]
    distance: float
    detour: float

    def shows(self, body: Body, distances: Array) -> bool:
        """Whether a motion with these distances (N,) to the poses of each type is done in this profile."""
        if not self.speeds[0] <= body.joint_speed() <= self.speeds[1]:
            return False
        if not self.movements[0] <= body.body_movement() <= self.movements[1]:
            return False
        mine = float(distances[self.kind])
        return mine <= self.distance and mine <= self.detour * max(float(distances.min()), TIE)

    def says(self) -> str:
        """The detector in words."""
        return (
            f"joint speed {self.speeds[0]:.2f} to {self.speeds[1]:.2f} rad/s, body movement "
            f"{self.movements[0]:.0f} to {self.movements[1]:.0f} degrees a frame, nearest recorded pose of the "
            f"type within {self.distance:.1f} cm a joint and {self.detour:.2f} times that of any type"
        )


class RealMotion:
    """The recordings of a dataset; mirrored twins count among the poses only."""

    def __init__(self, dataset: Dataset) -> None:
        self.types, self.fps = dataset.types, dataset.fps
        self.stretches: list[Stretch] = []
        self.training: dict[int, Body] = {}  # by clip number
        poses, kinds, clips = [], [], []
        for number, clip in enumerate(dataset.clips):
            if clip.mirrored:
                continue
            data = dataset.read(clip)
            skeleton, layout = dataset.skeleton(clip), dataset.layout.version
            body = body_of(
                decode_motion(
                    data.features, skeleton, dataset.fps, data.ground[0], dataset.reference_rotations, layout
                )
            )
            for start, end, kind in type_stretches(data.types):
                if end - start >= SHORTEST:
                    part = body.cut(start, end)
                    self.stretches.append(Stretch(dataset.types[kind], number, clip.name, clip.split, part))
            if clip.split == "train":
                self.training[number] = body
                some, kind_ids = body.poses(BANK_EVERY), data.types[::BANK_EVERY]
                poses += [some, _mirrored(some)]
                kinds += [kind_ids, dataset.mirrored_type_ids[kind_ids]]
                clips.append(np.full(2 * len(some), number))
        if not poses:
            raise DatasetError(f"{dataset.folder}: the dataset has no training clips to measure against")
        order = np.argsort(np.concatenate(kinds), kind="stable")
        self._poses, self._clips = np.concatenate(poses)[order], np.concatenate(clips)[order]
        counts = np.bincount(np.concatenate(kinds), minlength=len(self.types))
        self._edges = [0, *np.cumsum(counts, 0).tolist()]
        self._profiles: dict[str, MotionProfile | None] = {}

    def of_type(self, kind: str, split: str | None = None) -> list[Stretch]:
        """The stretches of a type, of one split or of both."""
        return [s for s in self.stretches if s.type == kind and split in (None, s.split)]

    def pose_distances(self, body: Body, without: int = -1) -> Array:
        """Distances (T', N) in cm a joint to the nearest training pose of each type, every POSE_EVERY frames.

        Infinite for a type without poses.

        Args:
            without: number of a clip whose poses do not count.
        """
        distances = distances_between(body.poses(POSE_EVERY), self._poses) / JOINT_COUNT**0.5
        distances[:, self._clips == without] = np.inf
        out = np.full((len(distances), len(self.types)), np.inf, np.float32)
        for kind, (start, end) in enumerate(pairwise(self._edges)):
            if end > start:
                out[:, kind] = distances[:, start:end].min(axis=1)
        return out

    def profile(self, kind: str) -> MotionProfile | None:
        """How a type is done, None for a type without training stretches."""
        if kind not in self._profiles:
            found = self.of_type(kind, "train")
            self._profiles[kind] = self._measure_profile(kind, found) if found else None
        return self._profiles[kind]

    def _measure_profile(self, kind: str, found: list[Stretch]) -> MotionProfile:
        speeds, movements, distances, detours = [], [], [], []
        index = self.types.index(kind)
        for stretch in found:
            for window in sign_windows(stretch.body, PROFILE_SECONDS):
                speeds.append(window.joint_speed())
                movements.append(window.body_movement())
                means = self.pose_distances(window, without=stretch.clip).mean(axis=0)
                distances.append(float(means[index]))
                detours.append(float(means[index] / np.maximum(means.min(), 1e-6)))
        frames = np.array([float(len(s.body)) for s in found])
        rates = np.array([s.body.joint_speed() for s in found])
        return MotionProfile(
            index,
            float((frames * rates).sum() / frames.sum()),
            (SLOWER * _quantile(speeds, LOWEST), FASTER * _quantile(speeds, HIGHEST)),
            (SLOWER * _quantile(movements, LOWEST), FASTER * _quantile(movements, HIGHEST)),
            FARTHER * _quantile(distances, HIGHEST),
            max(DETOUR, _quantile(detours, HIGHEST)),
        )


def _mirrored(poses: Array) -> Array:
    """Poses (N, 69) of the mirror images."""
    joints = poses.reshape(-1, JOINT_COUNT, 3)[:, list(MIRROR_JOINTS)]
    return (joints * np.array([-1.0, 1.0, 1.0], np.float32)).reshape(len(joints), -1)


def _quantile(values: list[float], share: float) -> float:
    """The quantile of the finite values; infinite if there are none."""
    finite = np.array([v for v in values if v < float("inf")])
    return float(np.quantile(finite, share)) if len(finite) else float("inf")
