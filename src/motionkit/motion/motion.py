"""A motion: rotations and root positions over time on one skeleton."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.free_memory import check_memory
from motionkit.motion.rotations import quat_continuous, quat_from_yaw, quat_multiply, quat_rotate, quat_slerp
from motionkit.motion.skeleton import Skeleton


@dataclass(frozen=True, eq=False)
class Motion:
    """T frames of motion.

    Attributes:
        skeleton: the J joints.
        local_rotations: (T, J, 4) unit quaternions w, x, y, z in parent space.
        root_positions: (T, 3) root joint in the world, in the skeleton's unit (cm within motionkit).
        fps: frames per second.
        local_positions: (T, J, 3) for rigs whose joints translate relative to their parents (six-channel joints), else
            None. The row of the root is not used.
    """

    skeleton: Skeleton
    local_rotations: Array
    root_positions: Array
    fps: float
    local_positions: Array | None = None

    def __len__(self) -> int:
        return int(self.local_rotations.shape[0])

    @property
    def seconds(self) -> float:
        """Duration; each frame counts as 1 / fps."""
        return len(self) / self.fps

    def moving_joints(self) -> list[int]:
        """Indices of the root and of all joints that leave their offsets."""
        if self.local_positions is None:
            return [0]
        away = np.abs(self.local_positions - self.skeleton.offsets).max(axis=(0, 2), initial=0.0)
        return [0, *(joint for joint in np.flatnonzero(away > 1e-5).tolist() if joint > 0)]

    def translations(self) -> Array:
        """Local translations (T, J, 3) of all joints; the root's is its position in the world."""
        still = np.broadcast_to(self.skeleton.offsets, (len(self), len(self.skeleton), 3))
        places = np.array(still if self.local_positions is None else self.local_positions)
        places = places.astype(self.root_positions.dtype, copy=False)
        places[:, 0] = self.root_positions
        return places

    def cut(self, start: int, end: int, step: int = 1) -> Motion:
        """Frames start to end (exclusive), or every so manieth of them, as a slice takes them."""
        local = None if self.local_positions is None else self.local_positions[start:end:step]
        return replace(
            self,
            local_rotations=self.local_rotations[start:end:step],
            root_positions=self.root_positions[start:end:step],
            local_positions=local,
        )

    def followed_by(self, *after: Motion) -> Motion:
        """This motion and then others on the same joints, at the same rate."""
        every = (self, *after)
        places = [each.local_positions for each in every if each.local_positions is not None]
        return replace(
            self,
            local_rotations=np.concatenate([each.local_rotations for each in every]),
            root_positions=np.concatenate([each.root_positions for each in every]),
            local_positions=np.concatenate(places) if len(places) == len(every) else None,
        )

    def scaled(self, factor: float) -> Motion:
        """The same motion with every length multiplied by a factor."""
        local = None if self.local_positions is None else self.local_positions * factor
        return replace(
            self,
            skeleton=self.skeleton.scaled(factor),
            root_positions=self.root_positions * factor,
            local_positions=local,
        )

    def turned(self, angle: float) -> Motion:
        """The same motion turned about the vertical axis through the origin, in radians."""
        turn = quat_from_yaw(np.array(angle, self.local_rotations.dtype))
        local = self.local_rotations.copy()
        local[:, 0] = quat_multiply(np.broadcast_to(turn, local[:, 0].shape), local[:, 0])
        roots = quat_rotate(np.broadcast_to(turn, local[:, 0].shape), self.root_positions)
        return replace(self, local_rotations=local, root_positions=roots.astype(self.root_positions.dtype))


def longest_seconds(fps: float) -> float:
    """The longest accepted recording in seconds: four hours at capture rates, one hour at slower rates.

    Both fit in memory at 60 fps. At a slow rate even a small file would become many frames.
    """
    return 4 * 3600.0 if fps > 29.0 else 3600.0


def as_motion(value: object) -> Motion:
    """A motion, or that of a result or clip, which have it as `motion`; raises MotionkitError for anything else."""
    found = value if isinstance(value, Motion) else getattr(value, "motion", None)
    if not isinstance(found, Motion):
        raise MotionkitError(f"expected a Motion, or a result that has one, found {str(value)[:40]!r}")
    return found


def resample(motion: Motion, fps: float, cyclic: bool = False) -> Motion:
    """Resample a motion to another frame rate: rotations by slerp, positions linearly.

    Frame 0 keeps its time, and the last frame is at or before the last frame of the source. A cyclic motion keeps its
    last frame too, which equals its first, so that its pace changes by less than half a frame.

    Raises:
        MotionkitError: the rate is not above 0, the motion is longer than longest_seconds(), or it does not fit into
            memory.
    """
    if not 0.0 < fps < math.inf:
        raise MotionkitError(f"expected a frame rate above 0, found {fps:g}")
    if len(motion) < 2 or abs(motion.fps - fps) < 1e-6 * fps:
        return replace(motion, fps=fps) if len(motion) < 2 else motion
    if motion.seconds > longest_seconds(motion.fps) * 1.001:
        raise MotionkitError(
            f"{len(motion)} frames at {motion.fps:g} fps last {motion.seconds / 3600:.3g} hours, "
            f"expected at most {longest_seconds(motion.fps) / 3600:g}"
        )
    last = (len(motion) - 1) * fps / motion.fps
    frames = (max(1, round(last)) if cyclic else int(last + 1e-6)) + 1
    check_memory(frames, len(motion.skeleton), fps)
    times = np.arange(frames, dtype=np.float64) * (motion.fps / fps)
    if cyclic:
        times = np.linspace(0.0, len(motion) - 1, frames)
    before = np.minimum(np.floor(times), len(motion) - 2).astype(np.int64)
    fraction = (times - before).astype(motion.local_rotations.dtype)
    after = before + 1
    rotations = quat_slerp(
        motion.local_rotations[before],
        motion.local_rotations[after],
        np.broadcast_to(fraction[:, None], (frames, motion.local_rotations.shape[1])),
    )

    def linear(values: Array) -> Array:
        weight = fraction.reshape(frames, *[1] * (values.ndim - 1)).astype(values.dtype)
        return values[before] * (1 - weight) + values[after] * weight

    local = None if motion.local_positions is None else linear(motion.local_positions)
    return Motion(motion.skeleton, quat_continuous(rotations), linear(motion.root_positions), fps, local)
