"""Control signals C_n: skeleton, motion type, root trajectory of the next second, phase and reference poses.

Paper section 3, "Control Signal Representation". Three signals are not in the paper: the trajectory mask, so that one
model works with and without a path; the phase, which times a performance; and reference poses
(features/reference.py), which show what the body does next.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
TYPE_BLEND_FRAMES = 40  # frames that a change of type takes, as in the paper
MOST_TYPES = 1000  # in one dataset or model
# Signals of a control vector. "paper": skeleton, types at six frames ahead, trajectory. "extended": skeleton, present
# types, trajectory, and the three signals that are not in the paper.
CONTROL_KINDS = ("extended", "paper")
# The network sees rest-pose positions as differences from the canonical body, in units of 10 cm.
SKELETON_UNIT = 10.0


@dataclass(frozen=True, eq=False)
class Controls:
    """The controls of one frame or many; leading dimensions (...) are frames, characters or both.

    Attributes:
        type_weights: (..., N) weights of the motion types, which add up to 1.
        trajectory: (..., 24) the root's future positions (cm) and directions in the present heading frame.
        trajectory_mask: (...) 1 with a trajectory, 0 without.
        phase: (...) in [0, 1) during a performance, strike or jump, else negative.
        reference: (..., 72) pose embeddings of the reference poses.
        reference_gain: (...) factor on the difference between reference and present pose, 0 without a reference.
        slip_correction: (...) factor on the types' root-slip correction.
        types_ahead: (..., 6, N) type weights at TRAJECTORY_OFFSETS, used by the paper's control signals only; None
            repeats the present weights.
    """

    type_weights: Array
    trajectory: Array
    trajectory_mask: Array
    phase: Array
    reference: Array
    reference_gain: Array
    slip_correction: Array
    types_ahead: Array | None = None

    @staticmethod
    def of_types(type_weights: Array) -> Controls:
        """Controls with type weights (..., N) only: no trajectory, phase or reference."""
        shape = type_weights.shape[:-1]
        zeros, ones = np.zeros(shape, np.float32), np.ones(shape, np.float32)
        trajectory = np.zeros((*shape, TRAJECTORY_COUNT), np.float32)
        reference = np.zeros((*shape, REFERENCE_COUNT), np.float32)
        return Controls(type_weights, trajectory, zeros, -ones, reference, zeros, ones)

    @staticmethod
    def concatenated(parts: Sequence[Controls]) -> Controls:
        """Concatenate controls along their first dimension, over frames or over characters."""
        return _joined(parts, np.concatenate)

    @staticmethod
    def side_by_side(characters: Sequence[Controls]) -> Controls:
        """Stack controls (T, ...) of B characters as (T, B, ...); shorter ones repeat their last frame."""
        frames = max(len(c.phase) for c in characters)
        rows = [np.minimum(np.arange(frames), len(c.phase) - 1) for c in characters]
        return _joined(
            characters, lambda arrays: np.stack([a[r] for a, r in zip(arrays, rows, strict=True)], 1)
        )

    def at(self, rows: int | slice | Array) -> Controls:
        """The controls at some rows of the first dimension."""
        return Controls(**{name: values[rows] for name, values in vars(self).items() if values is not None})

    def with_mask(self, mask: float) -> Controls:
        """The same controls with this trajectory mask, 1 or 0, everywhere."""
        return replace(self, trajectory_mask=np.full_like(self.trajectory_mask, mask))

    @property
    def ahead(self) -> Array:
        """Type weights (..., 6, N) at TRAJECTORY_OFFSETS: types_ahead, or the present weights repeated."""
        if self.types_ahead is not None:
            return self.types_ahead
        return np.repeat(self.type_weights[..., None, :], len(TRAJECTORY_OFFSETS), axis=-2)


def _joined(parts: Sequence[Controls], join: Callable[[list[Array]], Array]) -> Controls:
    """Join each field of several controls; types_ahead is dropped unless all parts have it."""
    ahead = all(part.types_ahead is not None for part in parts)
    names = [name for name in vars(parts[0]) if ahead or name != "types_ahead"]
    return Controls(*(join([getattr(part, name) for part in parts]) for name in names))


@dataclass(frozen=True)
class ControlLayout:
    """Columns of the control vector: skeleton, types, trajectory and its mask, phase, reference and its gain.

    The kind "paper" ends with the trajectory and has six sets of types, one for each of TRAJECTORY_OFFSETS.
    """

    types: tuple[str, ...]
    kind: str = "extended"

    @property
    def skeleton(self) -> slice:
        """The 69 rest-pose joint positions (3 per joint)."""
        return slice(0, SKELETON_COUNT)

    @property
    def type(self) -> slice:
        """The type weights, one per type; in the kind "paper" one per type and frame ahead."""
        return slice(SKELETON_COUNT, SKELETON_COUNT + self.type_samples * len(self.types))

    @property
    def type_samples(self) -> int:
        """Number of frames whose types the control vector holds."""
        return len(TRAJECTORY_OFFSETS) if self.kind == "paper" else 1

    @property
    def trajectory(self) -> slice:
        """The 24 trajectory values, zero without a trajectory."""
        return slice(self.type.stop, self.type.stop + TRAJECTORY_COUNT)

    @property
    def flag(self) -> int:
        """The column of the trajectory mask: 1 with a trajectory, else 0."""
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
        """The column that is 1 with a reference, else 0."""
        return self.reference.stop

    @classmethod
    def trajectory_columns(cls, kind: str, size: int) -> slice:
        """The columns of the trajectory in control vectors of a kind and length, whatever their number of types."""
        without = cls((), kind)
        beyond = without.size - without.trajectory.stop
        return slice(size - beyond - TRAJECTORY_COUNT, size - beyond)

    @property
    def size(self) -> int:
        """Length of a control vector."""
        return self.trajectory.stop if self.kind == "paper" else self.reference_gain + 1


def future_trajectory(ground: Array, frames: Array, here: Array | None = None) -> Array:
    """Trajectory values (..., 24) at frames, each in its own heading frame: positions in cm, then directions.

    Beyond the last frame, the root continues with the mean velocity of the last six frames and keeps its facing.

    Args:
        ground: (T, 3) root x, z (cm) and heading (radians).
        frames: (...) indices into ground.
        here: (..., 3) x, z and heading of the body that follows the ground track; by default ground at these frames.
    """
    last = ground.shape[0] - 1
    ahead = frames[..., None] + np.array(TRAJECTORY_OFFSETS)
    beyond = np.maximum(ahead - last, 0).astype(ground.dtype)
    span = min(6, last)
    drift = (ground[last, :2] - ground[last - span, :2]) / max(span, 1)
    targets = ground[np.minimum(ahead, last)]
    positions = targets[..., :2] + beyond[..., None] * drift
    here = ground[frames] if here is None else here
    relative = rotate_ground(-here[..., None, 2], positions - here[..., None, :2])
    turn = targets[..., 2] - here[..., None, 2]
    directions = np.stack([np.sin(turn), np.cos(turn)], axis=-1)
    count = TRAJECTORY_COUNT // 2
    shape = (*frames.shape, count)
    return np.concatenate([relative.reshape(shape), directions.reshape(shape)], axis=-1)


def straight_trajectory(velocity: tuple[float, float], fps: float) -> Array:
    """Trajectory values (24,) of a body that keeps its facing and a velocity (x, z in cm/s in its heading frame)."""
    seconds = np.array(TRAJECTORY_OFFSETS, np.float32) / np.float32(fps)
    places = seconds[:, None] * np.array(velocity, np.float32)
    directions = np.tile(np.array([0.0, 1.0], np.float32), len(TRAJECTORY_OFFSETS))
    return np.concatenate([places.ravel(), directions])


def blend_types(type_ids: Array, count: int, blend: int = TYPE_BLEND_FRAMES) -> Array:
    """Type weights (T, count) of types (T,) that change linearly over `blend` frames centred on each change of type."""
    weights = np.eye(count, dtype=np.float32)[type_ids]
    if blend < 2 or bool((type_ids == type_ids[0]).all()):
        return weights
    before, after = blend // 2, blend - blend // 2
    padded = np.pad(weights, ((before, after), (0, 0)), mode="edge")
    sums = np.pad(np.cumsum(padded, axis=0, dtype=np.float64), ((1, 0), (0, 0)))
    return ((sums[blend : blend + len(weights)] - sums[: len(weights)]) / blend).astype(np.float32)


def types_ahead(weights: Array) -> Array:
    """Type weights (T, 6, N) at TRAJECTORY_OFFSETS after every frame of weights (T, N); the last row is held."""
    frames = np.arange(len(weights))[:, None] + np.array(TRAJECTORY_OFFSETS)
    return weights[np.minimum(frames, len(weights) - 1)]


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
    """Control vectors (..., C) of controls (...); trajectory and reference are zero where there is none.

    Args:
        skeleton: (69,) from skeleton_signal.
        x: (..., 276) normalised present frames, which reference poses are relative to.
        references: maps reference poses to the network's input.
        alone: as for ReferenceMap.shown.
    """
    mask, gain = controls.trajectory_mask[..., None], controls.reference_gain[..., None]
    trajectory = trajectory_scaling.normalize(controls.trajectory) * mask
    shape = controls.type_weights.shape[:-1]
    if layout.kind == "paper":
        parts = [skeleton, controls.ahead.reshape(*shape, -1), trajectory]
    else:
        reference = references.network_input(controls.reference, x, alone) * gain
        parts = [skeleton, controls.type_weights, trajectory, mask, phase_signal(controls.phase)]
        parts += [reference, (gain > 0.0).astype(np.float32)]
    out = np.concatenate([np.broadcast_to(p, (*shape, p.shape[-1])) for p in parts], axis=-1)
    assert out.shape[-1] == layout.size
    return out


def skeleton_signal(skeleton: Skeleton) -> Array:
    """The 69 skeleton values: rest-pose joint positions minus the canonical body's, in units of 10 cm."""
    difference = skeleton.rest_positions() - canonical_skeleton().rest_positions()
    return (difference / SKELETON_UNIT).reshape(SKELETON_COUNT)
