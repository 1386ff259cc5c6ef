"""Control signals C_n: skeleton, motion type, and where the root is to be over the coming second.

Paper section 3, "Control Signal Representation". Beside the paper's four there are a flag that says
whether a trajectory is given, so that one model serves both with and without a path, and the phase of
types that turn the body over, which says when to begin, and the reference (features/reference.py), which says what
the body is to do next.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array
from motionkit.features.normalize import Scaling
from motionkit.features.reference import REFERENCE_COUNT
from motionkit.motion.rotations import rotate_ground
from motionkit.motion.skeleton import JOINT_COUNT, Skeleton, canonical_skeleton

TRAJECTORY_OFFSETS: tuple[int, ...] = (10, 20, 30, 40, 50, 60)  # frames ahead, at 60 fps
TRAJECTORY_COUNT = 4 * len(TRAJECTORY_OFFSETS)  # 6 positions (x, z), then 6 directions (x, z)
SKELETON_COUNT = 3 * JOINT_COUNT
TYPE_BLEND_FRAMES = 40
# Rest-pose positions reach the network in units of 10 cm around the canonical body.
SKELETON_UNIT = 10.0


@dataclass(frozen=True)
class ControlLayout:
    """Where each signal stands in the control vector: skeleton, type, trajectory, flag, phase, reference, flag."""

    types: tuple[str, ...]

    @property
    def skeleton(self) -> slice:
        """The 69 rest-pose joint positions."""
        return slice(0, SKELETON_COUNT)

    @property
    def type(self) -> slice:
        """The weights of the motion types."""
        return slice(SKELETON_COUNT, SKELETON_COUNT + len(self.types))

    @property
    def trajectory(self) -> slice:
        """The 24 trajectory numbers, zero where none is given."""
        return slice(self.type.stop, self.type.stop + TRAJECTORY_COUNT)

    @property
    def flag(self) -> int:
        """The column that is 1 where a trajectory is given."""
        return self.trajectory.stop

    @property
    def phase(self) -> slice:
        """Sine and cosine of the phase, both zero for types without one."""
        return slice(self.flag + 1, self.flag + 3)

    @property
    def reference(self) -> slice:
        """The 72 numbers of the reference, zero where none is given."""
        return slice(self.phase.stop, self.phase.stop + REFERENCE_COUNT)

    @property
    def reference_gain(self) -> int:
        """The column that is 1 where a reference is given."""
        return self.reference.stop

    @property
    def size(self) -> int:
        """Numbers in a control vector."""
        return self.reference_gain + 1


def future_trajectory(ground: Array, frames: Array) -> Array:
    """Trajectory numbers (..., 24) of the given frames, in the heading frame of each.

    Beyond the last frame the root goes on as it went over the last six frames, facing as it did.

    Args:
        ground: (T, 3) root x, z (cm) and heading (radians).
        frames: (...) indices into ground.
    """
    last = ground.shape[0] - 1
    ahead = frames[..., None] + np.array(TRAJECTORY_OFFSETS)
    beyond = np.maximum(ahead - last, 0).astype(ground.dtype)
    span = min(6, last)
    drift = (ground[last, :2] - ground[last - span, :2]) / max(span, 1)
    targets = ground[np.minimum(ahead, last)]
    positions = targets[..., :2] + beyond[..., None] * drift
    here = ground[frames]
    relative = rotate_ground(-here[..., None, 2], positions - here[..., None, :2])
    turn = targets[..., 2] - here[..., None, 2]
    directions = np.stack([np.sin(turn), np.cos(turn)], axis=-1)
    count = TRAJECTORY_COUNT // 2
    shape = (*frames.shape, count)
    return np.concatenate([relative.reshape(shape), directions.reshape(shape)], axis=-1)


def trajectory_mirror() -> Array:
    """Signs (24,) that mirror trajectory numbers at the plane x = 0."""
    return np.array([-1.0, 1.0] * (2 * len(TRAJECTORY_OFFSETS)), np.float32)


def blend_types(type_ids: Array, count: int, blend: int = TYPE_BLEND_FRAMES) -> Array:
    """Type weights (T, count) that move linearly over the blend frames centred on each change.

    Args:
        type_ids: (T,) the type of every frame.
        count: the number of types.
        blend: frames a change takes (the paper's 40).
    """
    weights = np.eye(count, dtype=np.float32)[type_ids]
    if blend < 2 or bool((type_ids == type_ids[0]).all()):
        return weights
    before, after = blend // 2, blend - blend // 2
    padded = np.pad(weights, ((before, after), (0, 0)), mode="edge")
    sums = np.pad(np.cumsum(padded, axis=0, dtype=np.float64), ((1, 0), (0, 0)))
    return ((sums[blend : blend + len(weights)] - sums[: len(weights)]) / blend).astype(np.float32)


def phase_signal(phase: Array) -> Array:
    """Sine and cosine (..., 2) of a turn for progress (...) in [0, 1); zeros where it is negative: no phase."""
    angle = 2.0 * np.pi * phase
    return np.stack([np.sin(angle), np.cos(angle)], axis=-1) * (phase >= 0)[..., None]


def control_vector(
    layout: ControlLayout,
    skeleton_B69: Array,
    type_weights: Array,
    trajectory: Array,
    trajectory_mask: Array,
    phase: Array,
    reference: Array,
    reference_gain: Array,
    trajectory_scaling: Scaling,
) -> Array:
    """Control vectors (..., C): trajectory normalised; it and the reference zero where they are not given.

    progress (...) is that of phase_signal, negative for types without a phase; reference (..., 72) is as ReferenceMap shows it.
    """
    shown = trajectory_scaling.normalize(trajectory) * trajectory_mask[..., None]
    parts = [skeleton_B69, type_weights, shown, trajectory_mask[..., None], phase_signal(phase)]
    parts += [reference * reference_gain[..., None], reference_gain[..., None]]
    out = np.concatenate(
        [np.broadcast_to(p, (*type_weights.shape[:-1], p.shape[-1])) for p in parts], axis=-1
    )
    assert out.shape[-1] == layout.size
    return out


def skeleton_signal(skeleton: Skeleton) -> Array:
    """The 69 skeleton numbers: rest-pose joint positions against the canonical body's."""
    difference = skeleton.rest_positions() - canonical_skeleton().rest_positions()
    return (difference / SKELETON_UNIT).reshape(SKELETON_COUNT)
