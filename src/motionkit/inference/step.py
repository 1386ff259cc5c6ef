"""The network one frame at a time for a batch of characters: constant work and memory per frame, exact."""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Floats
from motionkit.features.layout import FEATURE_COUNT
from motionkit.inference.step_arrays import StepArrays
from motionkit.inference.step_kernel import StepKernel


class NetworkStep:
    """B independent characters; after step() the Gaussians of their next frames stand in mean and log_sigma.

    Attributes:
        mean, log_sigma: (B, 276), normalised; contact_logits: (B, 4). Overwritten by every step.
    """

    def __init__(self, kernel: StepKernel, batch: int) -> None:
        self.kernel, self.batch = kernel, batch
        self.arrays = StepArrays.of(kernel.weights, batch)
        self.mean, self.log_sigma = self.arrays.mean, self.arrays.log_sigma
        self.contact_logits = self.arrays.contact_logits
        self._before = np.zeros((batch, FEATURE_COUNT), np.float32)
        self._slot = kernel.weights.config.window - 1  # place in the rings of the last frame
        self._run = kernel.bind(self.arrays)

    @property
    def bytes_per_character(self) -> int:
        """Memory of the state of one character."""
        state = (self.arrays.keys, self.arrays.values, self.arrays.recent, self._before)
        return sum(array.nbytes for array in state) // self.batch

    def alone(self) -> NetworkStep:
        """A step of the same network for one character."""
        return NetworkStep(self.kernel, 1)

    def reset(self, coming: int = 0) -> None:
        """Forget all frames of all characters.

        coming: frames after which the rings stand at their last place, from where characters go on. Sums over a ring
            run from its first place, so a character's last digits depend on where in it a frame is.
        """
        self.arrays.forget()
        self._slot = (-1 - coming) % self.kernel.weights.config.window

    def adopt(self, row: int, other: object) -> None:
        """Put the only character of another step, which has seen frames of its own, in place of one of these."""
        assert isinstance(other, NetworkStep) and other.batch == 1
        self.arrays.adopt(row, other.arrays, self._slot - other._slot)
        self._before[row] = other._before[0]

    def step(self, x: Floats, contacts: Floats, controls: Floats) -> None:
        """Take in a frame and predict the next: x (B, 276) normalised, contacts (B, 4), controls (B, C)."""
        self.arrays.take_in(x, contacts, controls)
        self._slot = (self._slot + 1) % self.kernel.weights.config.window
        self._run(self._slot)
        momentum = self.kernel.weights.momentum
        if momentum is not None:
            first = self.arrays.filled == 1
            self._before[first] = x[first]  # nothing has moved yet at the first frame
            self.mean += momentum * (x - self._before)
            self._before[:] = x
