"""Turns requested controls into the control vectors of the network and the sampling presets of the types."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from motionkit.arrays import Array, Floats, row_products
from motionkit.features.control import (
    TRAJECTORY_COUNT,
    Controls,
    control_vector,
    future_trajectory,
    skeleton_signal,
)
from motionkit.features.decode import integrate_ground
from motionkit.inference.frame_arrays import PresetArrays
from motionkit.models.model import MotionModel
from motionkit.motion.skeleton import Skeleton

PRESETS = ("noise_scale", "velocity_blend", "slip_correction")


class ControlInput:
    """The controls of B characters.

    Attributes:
        vectors: (B, C) input of the network.
        presets: sampling presets of the requested types.
        type_presets: (N, 3) PRESETS of every type.
        skeletons: (B, S) skeleton control signals.
        trajectory: (B, 24) in cm, predicted by a plain model; used where no trajectory is given (paper section 5.2).
    """

    def __init__(self, model: MotionModel, batch: int) -> None:
        self.model = model
        self._layout, self._references = model.controls, model.reference_map  # each access builds them again
        self.vectors = np.zeros((batch, self._layout.size), np.float32)
        self.presets = PresetArrays.of(batch)
        self.type_presets = np.stack([model.presets(name) for name in PRESETS], axis=1)
        self.skeletons = np.zeros((batch, 0), np.float32)
        self.trajectory = np.zeros((batch, TRAJECTORY_COUNT), np.float32)

    def set_skeletons(self, skeletons: Sequence[Skeleton]) -> None:
        """Set the skeleton control signal of each character."""
        self.skeletons = np.stack([skeleton_signal(s) for s in skeletons])

    def take(self, controls: Controls, x: Floats) -> Floats:
        """Return the control vectors (B, C) at normalised frames x (B, 276), and set the presets of the types."""
        model, presets = self.model, self.presets
        if model.plain:
            controls = self._with_predicted_trajectory(controls)
        shares = row_products(controls.type_weights, self.type_presets)
        presets.log_noise_scale[:] = np.log(np.maximum(shares[:, :1], 1e-6))
        presets.velocity_blend[:], presets.slip_correction[:] = shares[:, 1:2], shares[:, 2:]
        presets.slip_correction[:, 0] *= controls.slip_correction
        self.vectors[:] = control_vector(
            self._layout, self.skeletons, controls, x, model.trajectory_scaling, self._references
        )
        return self.vectors

    def keep_trajectory(self, predicted: Floats) -> None:
        """Keep the normalised trajectory (B, 24) that a plain model predicted for the next frame."""
        if self.model.plain:
            self.trajectory[:] = self.model.trajectory_scaling.denormalize(predicted)

    def recorded_trajectories(self, features: Array) -> Array:
        """Trajectories (B, T, 24) of recorded frames (B, T, 276), extended straight on after the last frame."""
        origin = np.zeros((len(features), 3), np.float32)
        ground = integrate_ground(features, origin, self.model.fps, self.model.config.layout)
        frames = np.arange(features.shape[1])
        return np.stack([future_trajectory(each.astype(np.float32), frames) for each in ground])

    def _with_predicted_trajectory(self, controls: Controls) -> Controls:
        """Fill in the predicted trajectory where the controls give none."""
        requested = controls.trajectory_mask[:, None] > 0.0
        return replace(
            controls, trajectory=np.where(requested, controls.trajectory, self.trajectory)
        ).with_mask(1.0)
