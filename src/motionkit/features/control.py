"""Control signals C_n: skeleton, motion type, root trajectory of the next second, phase and reference poses.

Paper section 3, "Control Signal Representation". Three signals are added to the paper's: the trajectory mask,
so that one model works with and without a path; the phase of types that turn the body over, which times the
performance; and reference poses (features/reference.py), which say what the body does next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from motionkit.arrays import Array
from motionkit.features.normalize import Scaling
from motionkit.features.reference import REFERENCE_COUNT, ReferenceMap
from motionkit.motion.rotations import rotate_ground
from motionkit.motion.skeleton import JOINT_COUNT, Skeleton, canonical_skeleton

TRAJECTORY_OFFSETS: tuple[int, ...] = (10, 20, 30, 40, 50, 60)  # frames ahead, at 60 fps
TRAJECTORY_COUNT = 4 * len(TRAJECTORY_OFFSETS)  # 6 positions (x, z), then 6 directions (x, z)
SKELETON_COUNT = 3 * JOINT_COUNT
TYPE_BLEND_FRAMES = 40
# The network sees rest-pose positions as differences from the canonical body, in units of 10 cm.
SKELETON_UNIT = 10.0


@dataclass(frozen=True, eq=False)
class Controls:
    """What is asked for, at one frame or many; leading dimensions (...) are frames, characters or both.

    Attributes:
        type_weights: (..., N) weights of the motion types, which add up to 1.
        trajectory: (..., 24) where the root is to be, in cm in the heading frame of now.
        trajectory_mask: (...) 1 where the trajectory counts, else 0.
        phase: (...) in [0, 1) through a performance, strike or jump, negative for none.
        reference: (..., 72) pose embeddings of the reference some frames ahead.
        reference_gain: (...) factor on the reference, 0 where there is none.
        slip_correction: (...) factor on the root-slip correction of the types.
    """

    type_weights: Array
    trajectory: Array
    trajectory_mask: Array
    phase: Array
    reference: Array
    reference_gain: Array
    slip_correction: Array

    @staticmethod
    def of_types(type_weights: Array) -> Controls:
        """Ask for types (..., N) alone: no trajectory, phase or reference."""
        shape = type_weights.shape[:-1]
        zeros, ones = np.zeros(shape, np.float32), np.ones(shape, np.float32)
        trajectory = np.zeros((*shape, TRAJECTORY_COUNT), np.float32)
        reference = np.zeros((*shape, REFERENCE_COUNT), np.float32)
        return Controls(type_weights, trajectory, zeros, -ones, reference, zeros, ones)

    @staticmethod
    def concatenated(parts: Sequence[Controls], axis: int = 0) -> Controls:
        """Join along an axis: frames one after another, or characters side by side."""
        return Controls(*(np.concatenate([getattr(p, name) for p in parts], axis) for name in vars(parts[0])))

    @staticmethod
    def side_by_side(characters: Sequence[Controls]) -> Controls:
        """Stack (T, ...) of B characters as (T, B, ...); shorter ones repeat their last frame."""
        frames = max(len(c.phase) for c in characters)
        rows = [np.minimum(np.arange(frames), len(c.phase) - 1) for c in characters]
        pairs = list(zip(characters, rows, strict=True))
        return Controls(
            *(np.stack([getattr(c, name)[r] for c, r in pairs], 1) for name in vars(characters[0]))
        )

    def at(self, rows: int | slice | Array) -> Controls:
        """Some rows of the first dimension."""
        return Controls(*(values[rows] for values in vars(self).values()))

    def with_mask(self, mask: float) -> Controls:
        """The same with a trajectory mask of 1 or 0 everywhere."""
        return replace(self, trajectory_mask=np.full_like(self.trajectory_mask, mask))


@dataclass(frozen=True)
class ControlLayout:
    """Columns of the control vector: skeleton, types, trajectory and its mask, phase, reference and its gain."""

    types: tuple[str, ...]

    @property
    def skeleton(self) -> slice:
        """The 69 rest-pose joint positions (3 per joint)."""
        return slice(0, SKELETON_COUNT)

    @property
    def type(self) -> slice:
        """The weights of the motion types, one per type."""
        return slice(SKELETON_COUNT, SKELETON_COUNT + len(self.types))

    @property
    def trajectory(self) -> slice:
        """The 24 trajectory values, zero without a trajectory."""
        return slice(self.type.stop, self.type.stop + TRAJECTORY_COUNT)

    @property
    def flag(self) -> int:
        """The trajectory mask: 1 with a trajectory, else 0."""
        return self.trajectory.stop

    @property
    def phase(self) -> slice:
        """Sine and cosine of the phase, both zero for types without a phase."""
        return slice(self.flag + 1, self.flag + 3)

    @property
    def reference(self) -> slice:
        """The 72 values of the reference poses, zero without a reference."""
        return slice(self.phase.stop, self.phase.stop + REFERENCE_COUNT)

    @property
    def reference_gain(self) -> int:
        """The reference gain, zero without a reference."""
        return self.reference.stop

    @property
    def size(self) -> int:
        """Length of a control vector."""
        return self.reference_gain + 1


def future_trajectory(ground: Array, frames: Array) -> Array:
    """Trajectory values (..., 24) of frames, each in its own heading frame: positions in cm, then directions.

    Beyond the last frame the root continues with the mean velocity of the last six frames and keeps its facing.

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
    """Signs (24,) that mirror trajectory values at the plane x = 0."""
    return np.array([-1.0, 1.0] * (2 * len(TRAJECTORY_OFFSETS)), np.float32)


def blend_types(type_ids: Array, count: int, blend: int = TYPE_BLEND_FRAMES) -> Array:
    """Type weights (T, count) that change linearly over `blend` frames centred on each change of type.

    Args:
        type_ids: (T,) type of every frame.
        count: number of types.
        blend: frames that a change takes (40 in the paper).
    """
    weights = np.eye(count, dtype=np.float32)[type_ids]
    if blend < 2 or bool((type_ids == type_ids[0]).all()):
        return weights
    before, after = blend // 2, blend - blend // 2
    padded = np.pad(weights, ((before, after), (0, 0)), mode="edge")
    sums = np.pad(np.cumsum(padded, axis=0, dtype=np.float64), ((1, 0), (0, 0)))
    return ((sums[blend : blend + len(weights)] - sums[: len(weights)]) / blend).astype(np.float32)


def phase_signal(phase: Array) -> Array:
    """Sine and cosine (..., 2) of phases (...) in [0, 1); zeros for negative phases, which mean no phase."""
    angle = 2.0 * np.pi * phase
    return np.stack([np.sin(angle), np.cos(angle)], axis=-1) * (phase >= 0)[..., None]


def control_vector(
    layout: ControlLayout,
    skeleton: Array,
    controls: Controls,
    x: Array,
    trajectory_scaling: Scaling,
    references: ReferenceMap,
    alone: bool = True,
) -> Array:
    """Control vectors (..., C) of controls (...); trajectory and reference are zero where they are not given.

    Args:
        skeleton: (69,) of skeleton_signal.
        x: (..., 276) normalised present frames, which references are relative to.
        references: maps reference poses to the reference signal.
        alone: as in ReferenceMap.shown.
    """
    mask, gain = controls.trajectory_mask[..., None], controls.reference_gain[..., None]
    trajectory = trajectory_scaling.normalize(controls.trajectory) * mask
    reference = references.shown(controls.reference, x, alone) * gain
    parts = [skeleton, controls.type_weights, trajectory, mask, phase_signal(controls.phase)]
    parts += [reference, (gain > 0.0).astype(np.float32)]
    shape = controls.type_weights.shape[:-1]
    out = np.concatenate([np.broadcast_to(p, (*shape, p.shape[-1])) for p in parts], axis=-1)
    assert out.shape[-1] == layout.size
    return out


def skeleton_signal(skeleton: Skeleton) -> Array:
    """The 69 skeleton values: rest-pose joint positions minus the canonical body's, in units of 10 cm."""
    difference = skeleton.rest_positions() - canonical_skeleton().rest_positions()
    return (difference / SKELETON_UNIT).reshape(SKELETON_COUNT)
