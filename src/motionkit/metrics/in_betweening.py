"""The in-betweening protocol of Harvey et al. 2020 on LaFAN1: gaps of 5 to 45 frames, L2P, L2Q and NPSS as there.

A window has PAST frames, a gap, and the frame after it, which is the goal. Windows are put around the origin and turned
so that the hips' own Y axis points along X in the last frame before the gap.
Shape legend: N windows, T frames, J joints.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.metrics.prediction import power_distance
from motionkit.metrics.value import MetricValue
from motionkit.motion.kinematics import forward_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_continuous, quat_from_yaw, quat_multiply, quat_rotate, quat_slerp
from motionkit.motion.skeleton import Skeleton

PAST, GAPS = 10, (5, 15, 30, 45)
TRAINING, TEST = (50, 20), (65, 40)  # frames of a window, and from the start of one to that of the next


@dataclass(frozen=True, eq=False)
class Windows:
    """N windows of one skeleton: local rotations (N, T, J, 4), continuous in time, and root positions (N, T, 3)."""

    skeleton: Skeleton
    rotations: Array
    roots: Array

    def part(self, start: int, end: int) -> Windows:
        """Return frames start to end (exclusive)."""
        return replace(self, rotations=self.rotations[:, start:end], roots=self.roots[:, start:end])

    def globally(self) -> tuple[Array, Array]:
        """Return global rotations (N, T, 4 J) and positions (N, T, 3 J)."""
        offsets = self.skeleton.offsets.astype(np.float64)
        turns, places = forward_kinematics(self.rotations, self.roots, offsets, self.skeleton.parents)
        return turns.reshape(*turns.shape[:2], -1), places.reshape(*places.shape[:2], -1)


def windows_of(motions: Iterable[Motion], size: int, step: int) -> Windows:
    """Return the windows of motions, placed as the protocol has them.

    Raises:
        MotionkitError: no motion is longer than a window, or they have other joints.
    """
    rotations, roots, skeletons = [], [], list[Skeleton]()
    for motion in motions:
        if skeletons and not motion.skeleton.same_hierarchy(skeletons[0]):
            raise MotionkitError("the motions have different joints; the protocol needs one skeleton")
        skeletons.append(motion.skeleton)
        turns = quat_continuous(motion.local_rotations.astype(np.float64))
        for start in range(0, len(motion) - size, step):
            rotations.append(turns[start : start + size])
            roots.append(motion.root_positions[start : start + size].astype(np.float64))
    if not rotations:
        raise MotionkitError(f"no motion is longer than the {size} frames of a window")
    return _placed(Windows(skeletons[0], np.stack(rotations), np.stack(roots)))


def _placed(windows: Windows) -> Windows:
    roots, rotations = windows.roots.copy(), windows.rotations.copy()
    roots[..., [0, 2]] -= roots[..., [0, 2]].mean(axis=1, keepdims=True)
    up = np.broadcast_to(np.array([0.0, 1.0, 0.0]), (len(roots), 3))
    ahead = quat_rotate(rotations[:, PAST - 1, 0], up)
    turn = quat_from_yaw(np.arctan2(ahead[:, 2], ahead[:, 0]))[:, None]
    rotations[:, :, 0] = quat_multiply(np.broadcast_to(turn, rotations[:, :, 0].shape), rotations[:, :, 0])
    return replace(
        windows,
        rotations=rotations,
        roots=quat_rotate(np.broadcast_to(turn, rotations[:, :, 0].shape), roots),
    )


def last_pose(windows: Windows, gap: int) -> Windows:
    """Return a gap (N, gap, ...) filled by the last frame before it: the protocol's zero velocity."""
    last = windows.part(PAST - 1, PAST)
    return replace(last, rotations=last.rotations.repeat(gap, axis=1), roots=last.roots.repeat(gap, axis=1))


def interpolated(windows: Windows, gap: int) -> Windows:
    """Return a gap (N, gap, ...) filled by interpolation: rotations by slerp, the root along a line."""
    first, goal = windows.part(PAST - 1, PAST), windows.part(PAST + gap, PAST + gap + 1)
    share = np.linspace(0.0, 1.0, gap + 2)[1:-1, None]
    roots = first.roots + share * (goal.roots - first.roots)
    shape = (len(roots), gap, *first.rotations.shape[2:])
    before, after = (np.broadcast_to(each.rotations, shape) for each in (first, goal))
    turns = quat_slerp(before, after, np.broadcast_to(share, shape[:-1]))
    return replace(windows, rotations=turns, roots=roots)


@dataclass(frozen=True, eq=False)
class Scale:
    """Mean and deviation (3 J,) of global positions in the training windows, which divide those of L2P."""

    mean: Array
    std: Array

    @staticmethod
    def of(training: Windows) -> Scale:
        """Return the scale of training windows."""
        places = training.globally()[1]
        return Scale(places.mean(axis=(0, 1)), places.std(axis=(0, 1)))


def gap_errors(made: Windows, truth: Windows, scale: Scale) -> tuple[MetricValue, MetricValue, MetricValue]:
    """Return "lafan1-l2p", "lafan1-l2q" and "lafan1-npss" of filled gaps beside the recorded ones."""
    (turns, places), (true_turns, true_places) = made.globally(), truth.globally()
    deviation = np.maximum(scale.std, 1e-9)
    return (
        MetricValue("lafan1-l2p", _distance(places / deviation, true_places / deviation), ""),
        MetricValue("lafan1-l2q", _distance(turns, true_turns), ""),
        MetricValue("lafan1-npss", spectrum_distance(turns, true_turns), ""),
    )


def _distance(made: Array, truth: Array) -> float:
    return float(np.linalg.norm(made - truth, axis=-1).mean())


def spectrum_distance(made: Array, truth: Array) -> float:
    """Return NPSS of signals (N, T, C): squared real parts of Fourier coefficients, weighted by the true power."""
    return power_distance(*(np.square(np.fft.fft(each, axis=1).real) for each in (made, truth)))
