"""Arrays that step_kernel.c reads and writes for a batch of characters.

Each attention layer keeps a ring of the last W keys and values, and the first convolution keeps its last inputs. So
work and memory per frame are constant.

Shape legend: B characters, P parts, L layers, D width, W window, K kernel, C controls.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import Floats
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.inference.step_weights import StepWeights

TILE = 32  # outputs that the kernel sums together; rows are padded to whole tiles
INPUT_COUNT = FEATURE_COUNT + CONTACT_COUNT + 1  # the last column is zero and pads parts with fewer inputs


@dataclass(frozen=True, eq=False)
class StepArrays:
    """Inputs, outputs and state of a step; the arrays must not move in memory.

    Attributes:
        keys, values: (B, 2, P, L, W, D) rings.
        recent: (B, K, 281) inputs, the newest last.
        filled: (B,) frames seen, the new one included.
        controls: (B, C) of the new frame.
        out: (B, padded) mean, log sigma and scratch, in this order.
        contacts_out: (B, TILE) contact logits in the first four columns.
    """

    keys: NDArray[np.float32]
    values: NDArray[np.float32]
    recent: NDArray[np.float32]
    filled: NDArray[np.int64]
    controls: NDArray[np.float32]
    out: NDArray[np.float32]
    contacts_out: NDArray[np.float32]

    @classmethod
    def of(cls, weights: StepWeights, batch: int) -> StepArrays:
        """The arrays of B characters before their first frame."""
        config = weights.config
        rings = (batch, 2, len(weights.columns), config.layers, config.window, config.width)
        head = 2 * FEATURE_COUNT + config.head.contact_hidden
        return cls(
            keys=np.zeros(rings, np.float32),
            values=np.zeros(rings, np.float32),
            recent=np.zeros((batch, config.kernel, INPUT_COUNT), np.float32),
            filled=np.zeros(batch, np.int64),
            controls=np.zeros((batch, weights.shallow.controls.shape[1]), np.float32),
            out=np.zeros((batch, head + -head % TILE), np.float32),
            contacts_out=np.zeros((batch, TILE), np.float32),
        )

    def take_in(self, x: Floats, contacts: Floats, controls: Floats) -> None:
        """Write the new frame: x (B, 276) normalised, contacts (B, 4), controls (B, C)."""
        self.recent[:, :-1] = self.recent[:, 1:]
        self.recent[:, -1, :FEATURE_COUNT] = x
        self.recent[:, -1, FEATURE_COUNT:-1] = contacts
        self.filled[:] += 1
        self.controls[:] = controls

    def forget(self) -> None:
        """Return to the state before the first frame; unfilled keys and values are never read."""
        self.recent[:] = 0.0
        self.filled[:] = 0

    def adopt(self, row: int, other: StepArrays, turn: int) -> None:
        """Replace one character by the only character of other arrays, with its rings rotated by `turn` slots."""
        self.keys[row] = np.roll(other.keys[0], turn, axis=-2)
        self.values[row] = np.roll(other.values[0], turn, axis=-2)
        self.recent[row], self.filled[row] = other.recent[0], other.filled[0]

    @property
    def mean(self) -> Floats:
        """Means (B, 276) of the next frame, normalised; a view."""
        return self.out[:, :FEATURE_COUNT]

    @property
    def log_sigma(self) -> Floats:
        """Logarithms (B, 276) of their standard deviations; a view."""
        return self.out[:, FEATURE_COUNT : 2 * FEATURE_COUNT]

    @property
    def contact_logits(self) -> Floats:
        """Logits (B, 4) of the contacts of the next frame; a view."""
        return self.contacts_out[:, :CONTACT_COUNT]
