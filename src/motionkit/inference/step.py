"""The network one frame at a time for a batch of characters: constant work and memory per frame, exact."""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Floats
from motionkit.features.layout import FEATURE_COUNT
from motionkit.inference.step_arrays import StepArrays
from motionkit.inference.step_kernel import StepKernel


class NetworkStep:
    """Predicts the next frames of B independent characters; every step() overwrites its results.

    Attributes:
        mean, log_sigma: (B, 276) Gaussians of the next frames, normalised.
        contact_logits: (B, 4).
    """

    def __init__(self, kernel: StepKernel, batch: int) -> None:
        self.kernel, self.batch = kernel, batch
        self.arrays = StepArrays.of(kernel.weights, batch)
        self.mean, self.log_sigma = self.arrays.mean, self.arrays.log_sigma
        self.contact_logits = self.arrays.contact_logits
        self.before = np.zeros((batch, FEATURE_COUNT), np.float32)
        self.slot = kernel.weights.config.window - 1  # ring slot of the last frame
        self._run = kernel.bind(self.arrays)

    @property
    def bytes_per_character(self) -> int:
        """Memory of one character's state."""
        state = (self.arrays.keys, self.arrays.values, self.arrays.recent, self.before)
        return sum(array.nbytes for array in state) // self.batch

    def alone(self) -> NetworkStep:
        """A step of the same network for one character."""
        return NetworkStep(self.kernel, 1)

    def reset(self, coming: int = 0) -> None:
        """Forget all frames of all characters.

        coming: frames after which the rings are at their last slot, where every character starts. Sums over a ring
            begin at its first slot, so the slot of a frame changes the last digits.
        """
        self.arrays.forget()
        self.slot = (-1 - coming) % self.kernel.weights.config.window

    def adopt(self, row: int, other: object) -> None:
        """Replace one character by the only character of another step, with the frames it has seen."""
        assert isinstance(other, NetworkStep) and other.batch == 1
        self.arrays.adopt(row, other.arrays, self.slot - other.slot)
        self.before[row] = other.before[0]

    def step(self, x: Floats, contacts: Floats, controls: Floats) -> None:
        """Predict the next frame from x (B, 276) normalised, contacts (B, 4) and controls (B, C)."""
        self.arrays.take_in(x, contacts, controls)
        self.slot = (self.slot + 1) % self.kernel.weights.config.window
        self._run(self.slot)
        momentum = self.kernel.weights.momentum
        if momentum is not None:
            first = self.arrays.filled == 1
            self.before[first] = x[first]  # the first frame has no velocity
            self.mean += momentum * (x - self.before)
            self.before[:] = x
