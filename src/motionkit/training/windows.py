"""Makes training windows of clips: normalised features, and controls of which some are dropped or changed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch

from motionkit.arrays import Array
from motionkit.data.dataset import ClipData, Dataset
from motionkit.features.control import (
    TRAJECTORY_COUNT,
    TRAJECTORY_OFFSETS,
    ControlLayout,
    Controls,
    blend_types,
    control_vector,
    future_trajectory,
    skeleton_signal,
    types_ahead,
)
from motionkit.features.layout import FEATURE_COUNT
from motionkit.features.reference import reference_map
from motionkit.motion.skeleton import canonical_skeleton

GAP_FRAMES = 30  # frames of the shortest gap in reference poses; the longest is twice as long
STRAIGHT = 0.95  # a window goes straight if its displacement is at least this share of its path length


@dataclass(frozen=True)
class ControlSampling:
    """How often controls of a window are dropped or changed, so that the network learns to do without them."""

    trajectory_dropout: float = 0.5  # share of windows without a trajectory
    # Standard deviation of a random factor on the length of a trajectory. A network that has only seen true
    # trajectories passes on the speed of its own predicted ones, slightly higher every time. Only straight windows get
    # the factor: a gait keeps its speed, but the trajectory of a dance tells its next step.
    trajectory_drift: float = 0.0
    # Share of windows without reference poses, drawn separately before and after a change of type.
    reference_dropout: float = 0.5
    reference_gaps: float = 0.25  # share of windows with a gap in their reference poses (GAP_FRAMES)
    lead_share: float = 0.5  # share of windows whose type weights change before the motion does
    lead_frames: int = 30  # largest number of frames between the two


@dataclass(frozen=True)
class SamplerOptions:
    """How windows are sampled."""

    window: int = 96  # frames per window (paper: 300)
    balance: float = 0.75  # 0 draws types as often as recorded, 1 all equally often (paper)
    # Factor on the probability of types with a phase, such as flips; the paper favours hard types too.
    phase_weight: float = 3.0
    type_weights: dict[str, float] = field(default_factory=dict)  # factors on the probability of single types
    splices: int = 2000  # spliced transitions made before training
    splice_share: float = 0.4  # share of windows from spliced transitions
    controls: ControlSampling = field(default_factory=ControlSampling)
    # Frames between the starts of windows that are cut from every clip and drawn with equal probability (paper: 4).
    # Depending on balance, it is longer for types with many frames. 0 draws a type first and then a window instead.
    interval: float = 0.0
    noise: float = 0.01  # standard deviation of the noise on normalised inputs (paper: 0.05)
    # Share of windows with types that the initial model has but the dataset lacks; 0 drops these types.
    kept_share: float = 0.0


class WindowMaker:
    """Makes training windows from clips of a dataset, with control vectors of a layout."""

    def __init__(self, dataset: Dataset, controls: ControlLayout) -> None:
        self.dataset, self.controls = dataset, controls
        self.references = reference_map(dataset.pose_embedding, dataset.scaling)
        self.skeletons = [skeleton_signal(canonical_skeleton(body)) for body in dataset.bodies]

    def make(
        self,
        data: ClipData,
        body: int,
        options: SamplerOptions,
        trajectory_draw: float,
        generator: torch.Generator,
    ) -> dict[str, Array]:
        """One window: the fields of a Batch without its first dimension.

        Args:
            data: frames of the window and those that its controls look ahead to; fewer where the clip ends.
            body: an index into the dataset's bodies.
            trajectory_draw: a random number in [0, 1); the window has a trajectory if it reaches trajectory_dropout.
            generator: for everything else that is random.
        """
        T, settings = options.window, options.controls
        frames = min(T, len(data.types) - 1)
        x = self.dataset.scaling.normalize(data.features[: frames + 1])
        trajectory = future_trajectory(data.ground, np.arange(frames + 1))
        all_weights = blend_types(_early_types(data.types, settings, generator), len(self.dataset.types))
        reference_gain = _with_reference(data.types[:frames], settings, generator)
        noise = torch.randn(frames, FEATURE_COUNT, generator=generator).numpy()
        inputs = x[:frames] + noise * options.noise
        signals = Controls(
            all_weights[:frames],
            drifted(trajectory[:frames], data.ground[: frames + 1], settings.trajectory_drift, generator),
            np.full(frames, float(trajectory_draw >= settings.trajectory_dropout), np.float32),
            data.phases[:frames],
            data.reference[:frames],
            reference_gain,
            np.ones(frames, np.float32),
            types_ahead(all_weights)[:frames] if self.controls.kind == "paper" else None,
        )
        scaling, body_signal = self.dataset.trajectory_scaling, self.skeletons[body]
        controls = control_vector(
            self.controls, body_signal, signals, inputs, scaling, self.references, alone=False
        )
        window = {
            "inputs": inputs,
            "targets": x[1:],
            "contacts": data.contacts[:frames],
            "next_contacts": data.contacts[1 : frames + 1],
            "controls": controls,
            "trajectory": scaling.normalize(trajectory[1:]),
            # A short window has the same weight as a full one.
            "mask": np.full(frames, T / frames, np.float32),
        }
        padded = {name: _pad(value, T) for name, value in window.items()}
        padded["offsets"] = self.dataset.bodies[body]
        return padded


def _early_types(types: Array, options: ControlSampling, generator: torch.Generator) -> Array:
    """Types (T,) of a window. In a share of windows they come some frames early, so types change before the motion."""
    if torch.rand((), generator=generator) >= options.lead_share:
        return types
    early = int(torch.randint(options.lead_frames + 1, (), generator=generator))
    return np.pad(types[early:], (0, early), mode="edge") if early < len(types) else types


def drifted(trajectory: Array, ground: Array, drift: float, generator: torch.Generator) -> Array:
    """Trajectories (T, 24) of a window; those that go straight over ground (T + 1, 3) are scaled by a random factor.

    drift is the standard deviation of the factor around 1.
    """
    if drift == 0.0:
        return trajectory
    change = drift * float(torch.randn((), generator=generator))
    steps = np.diff(ground[:, :2], axis=0)
    if not np.linalg.norm(steps.sum(axis=0)) >= STRAIGHT * np.linalg.norm(steps, axis=1).sum():
        return trajectory
    factor = np.ones(TRAJECTORY_COUNT, np.float32)
    factor[: 2 * len(TRAJECTORY_OFFSETS)] += change
    return trajectory * factor


def _with_reference(types: Array, options: ControlSampling, generator: torch.Generator) -> Array:
    """Return the reference gain (T,), 0 or 1: a value before the first change of type, one after it, and 0 in gaps."""
    before, after = (torch.rand(2, generator=generator) >= options.reference_dropout).float().tolist()
    unchanged = np.logical_and.accumulate(types == types[0])
    gain = np.where(unchanged, np.float32(before), np.float32(after))
    if torch.rand((), generator=generator) < options.reference_gaps:
        begins, frames = torch.rand(2, generator=generator).tolist()
        first = int(begins * len(types))
        gain[first : first + GAP_FRAMES + int(frames * GAP_FRAMES)] = 0.0
    return gain


def _pad(values: Array, frames: int) -> Array:
    """Return values (T, ...) padded with zeros to the given number of frames."""
    if len(values) == frames:
        return values
    return np.pad(values, [(0, frames - len(values)), *[(0, 0)] * (values.ndim - 1)])
