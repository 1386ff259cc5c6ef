"""The network one frame at a time for a batch of characters: constant work and memory per frame, exact.

Each attention layer keeps a ring of the last W keys and values, the first convolution its last inputs.
Where a C compiler was at hand when motionkit was installed, step_kernel.c does a step; else numpy does,
with the same weights and the same state.

Shape legend: B characters, P parts, L layers, D width, H heads, W window, K kernel, C controls.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import Floats, row_products
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.inference.step_kernel import TILE, StepKernel
from motionkit.inference.step_weights import NORM_EPS, ModuleWeights, StepWeights

INPUT_COUNT = FEATURE_COUNT + CONTACT_COUNT + 1  # a column of zeros at the end, for short parts


class NetworkStep:
    """B independent characters; after step() the Gaussians of their next frames stand in mean and log_sigma.

    Attributes:
        mean, log_sigma: (B, 276), normalised; contact_logits: (B, 4). Overwritten by every step.
    """

    def __init__(self, weights: StepWeights, batch: int, kernel: StepKernel | None = None) -> None:
        config = weights.config
        self.weights, self.config, self.batch, self.kernel = weights, config, batch, kernel
        P, D, W = len(weights.columns), config.width, config.window
        rings = (batch, 2, P, config.layers, W, D)
        self.keys, self.values = np.zeros(rings, np.float32), np.zeros(rings, np.float32)
        self.recent = np.zeros((batch, config.kernel, INPUT_COUNT), np.float32)
        self.filled = np.zeros(batch, np.int64)
        self.before = np.zeros((batch, FEATURE_COUNT), np.float32)
        self.slot = W - 1
        # Rows as wide as the kernel's tiles.
        head = 2 * FEATURE_COUNT + config.head.contact_hidden
        self.out = np.zeros((batch, head + -head % TILE), np.float32)
        self.contacts_out = np.zeros((batch, TILE), np.float32)
        self.mean, self.log_sigma = (
            self.out[:, :FEATURE_COUNT],
            self.out[:, FEATURE_COUNT : 2 * FEATURE_COUNT],
        )
        self.contact_logits = self.contacts_out[:, :CONTACT_COUNT]
        self._controls = np.zeros((batch, weights.shallow.controls.shape[1]), np.float32)
        self._run = self._numpy_step if kernel is None else kernel.bind(self, self._controls)

    @property
    def bytes_per_character(self) -> int:
        """Memory of the state of one character."""
        arrays = (self.keys, self.values, self.recent, self.before)
        return sum(array.nbytes for array in arrays) // self.batch

    def alone(self) -> NetworkStep:
        """A step of the same network for one character."""
        return NetworkStep(self.weights, 1, self.kernel)

    def reset(self, coming: int = 0) -> None:
        """Forget all frames of all characters.

        coming: frames after which the rings stand at their last place, from where characters go on. Sums over a ring
            run from its first place, so a character's last digits depend on where in it a frame is.
        """
        self.recent[:] = 0.0
        self.filled[:] = 0
        self.slot = (-1 - coming) % self.config.window

    def adopt(self, row: int, other: object) -> None:
        """Put the only character of another step, which has seen frames of its own, in place of one of these."""
        assert isinstance(other, NetworkStep) and other.batch == 1
        turn = self.slot - other.slot
        self.keys[row] = np.roll(other.keys[0], turn, axis=-2)
        self.values[row] = np.roll(other.values[0], turn, axis=-2)
        self.recent[row], self.filled[row] = other.recent[0], other.filled[0]
        self.before[row] = other.before[0]

    def step(self, x: Floats, contacts: Floats, controls: Floats) -> None:
        """Take in a frame and predict the next: x (B, 276) normalised, contacts (B, 4), controls (B, C)."""
        recent = self.recent
        recent[:, :-1] = recent[:, 1:]
        recent[:, -1, :FEATURE_COUNT] = x
        recent[:, -1, FEATURE_COUNT:-1] = contacts
        self.filled += 1
        self.slot = (self.slot + 1) % self.config.window
        self._controls[:] = controls
        self._run(self.slot)
        momentum = self.weights.momentum
        if momentum is not None:
            self.before[self.filled == 1] = x[self.filled == 1]  # nothing has moved yet at the first frame
            self.mean += momentum * (x - self.before)
            self.before[:] = x

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")  # those who use the frame look at it
    def _numpy_step(self, slot: int) -> None:
        weights, config, B, controls = self.weights, self.config, self.batch, self._controls
        inputs = self.recent[:, :, weights.columns].transpose(2, 0, 1, 3).reshape(len(weights.columns), B, -1)
        shallow = self._module(0, weights.shallow, inputs, controls)
        together = np.broadcast_to(shallow, (len(weights.columns), *shallow.shape))
        deep = self._module(1, weights.deep, together, controls)
        head = self.out[:, : len(weights.head_bias)]
        np.add(row_products(deep, weights.head), weights.head_bias, out=head)
        from_shallow = row_products(shallow, weights.contact_shallow)
        hidden = np.maximum(head[:, 2 * FEATURE_COUNT :] + from_shallow, 0.0)
        self.contact_logits[:] = row_products(hidden, weights.contact) + weights.contact_bias
        self.mean += np.float32(config.head.head_leak) * self.recent[:, -1, :FEATURE_COUNT]
        np.clip(self.log_sigma, config.head.log_sigma_min, config.head.log_sigma_max, out=self.log_sigma)

    def _module(self, index: int, weights: ModuleWeights, inputs: Floats, controls: Floats) -> Floats:
        """Features (B, P D) without their sqrt(D), from inputs (P, B, N)."""
        config, D = self.config, self.config.width
        x = row_products(inputs, weights.embed) + weights.embed_bias[:, None]
        embedded = row_products(controls, weights.controls) + weights.controls_bias[:, None]
        added = row_products(embedded, weights.layer_controls)
        bias = self._position_bias(weights.position)
        spread = np.repeat(np.eye(config.heads, dtype=np.float32), D // config.heads, axis=1)
        for layer in range(config.layers):
            if layer * D < added.shape[-1]:
                x += added[..., layer * D : (layer + 1) * D]
            qkv = row_products(_norm(x), weights.qkv[layer])
            qkv += weights.qkv_bias[layer][:, None]
            keys = self.keys[:, index, :, layer].swapaxes(0, 1)  # (P, B, W, D)
            values = self.values[:, index, :, layer].swapaxes(0, 1)
            keys[:, :, self.slot] = qkv[..., D : 2 * D]
            values[:, :, self.slot] = qkv[..., 2 * D :]
            # Per head: products summed over its channels, and shares spread over them again.
            scores = np.matmul(keys * qkv[..., None, :D], spread.T)
            scores += bias[layer]
            scores -= scores.max(axis=-2, keepdims=True)
            shares = np.matmul(np.exp(scores, out=scores), spread)
            total = shares.sum(axis=-2)
            shares *= values
            mixed = shares.sum(axis=-2)
            mixed /= total
            x += row_products(mixed, weights.out[layer])
            hidden = row_products(_norm(x), weights.inner[layer])
            hidden += weights.inner_bias[layer][:, None]
            x += row_products(np.maximum(hidden, 0.0, out=hidden), weights.outer[layer])
        return _norm(x).swapaxes(0, 1).reshape(self.batch, -1)

    def _position_bias(self, position: Floats) -> NDArray[np.float32]:
        """Bias (L, P, B, W, H) of every place in the rings, -inf where nothing has been written yet."""
        distance = (self.slot - np.arange(self.config.window)) % self.config.window
        bias = position[:, :, None, :, distance].swapaxes(-1, -2)
        empty = np.where(distance < self.filled[:, None], np.float32(0.0), np.float32(-np.inf))
        return bias + empty[:, :, None] if empty.any() else bias


def _norm(x: Floats) -> Floats:
    """Layer norm of rows (..., D) without a mean, and without sqrt(D)."""
    squares = np.matmul(x[..., None, :], x[..., :, None])[..., 0]
    return x / np.sqrt(squares + np.float32(x.shape[-1] * NORM_EPS))
