"""The network's step in numpy, in place of step_kernel.c: with the same weights and the same arrays.

Shape legend: B characters, P parts, L layers, D width, H heads, W window, K kernel, C controls.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import Floats, row_products
from motionkit.features.layout import FEATURE_COUNT
from motionkit.inference.step import NetworkStep
from motionkit.inference.step_arrays import StepArrays
from motionkit.inference.step_weights import NORM_EPS, ModuleWeights, StepWeights


class NumpyKernel:
    """What StepKernel is to NetworkStep."""

    def __init__(self, weights: StepWeights) -> None:
        self.weights = weights

    def bind(self, arrays: StepArrays) -> Callable[[int], None]:
        """What does a step at a slot of the rings."""
        return _Step(self.weights, arrays).run


def numpy_step(weights: StepWeights, batch: int) -> NetworkStep:
    """A network's step by numpy."""
    return NetworkStep(NumpyKernel(weights), batch)  # type: ignore[arg-type]


class _Step:
    def __init__(self, weights: StepWeights, arrays: StepArrays) -> None:
        self.weights, self.config, self.arrays = weights, weights.config, arrays
        self.batch = len(arrays.filled)

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")  # those who use the frame look at it
    def run(self, slot: int) -> None:
        """The next frame of all characters, at a slot of the rings."""
        self.slot = slot
        weights, config, B, arrays = self.weights, self.config, self.batch, self.arrays
        controls, log_sigma = arrays.controls, arrays.log_sigma
        inputs = (
            arrays.recent[:, :, weights.columns].transpose(2, 0, 1, 3).reshape(len(weights.columns), B, -1)
        )
        shallow = self._module(0, weights.shallow, inputs, controls)
        together = np.broadcast_to(shallow, (len(weights.columns), *shallow.shape))
        deep = self._module(1, weights.deep, together, controls)
        head = arrays.out[:, : len(weights.head_bias)]
        np.add(row_products(deep, weights.head), weights.head_bias, out=head)
        from_shallow = row_products(shallow, weights.contact_shallow)
        hidden = np.maximum(head[:, 2 * FEATURE_COUNT :] + from_shallow, 0.0)
        arrays.contact_logits[:] = row_products(hidden, weights.contact) + weights.contact_bias
        mean = arrays.mean
        mean += np.float32(config.head.head_leak) * arrays.recent[:, -1, :FEATURE_COUNT]
        np.clip(log_sigma, config.head.log_sigma_min, config.head.log_sigma_max, out=log_sigma)

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
            keys = self.arrays.keys[:, index, :, layer].swapaxes(0, 1)  # (P, B, W, D)
            values = self.arrays.values[:, index, :, layer].swapaxes(0, 1)
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
        empty = np.where(distance < self.arrays.filled[:, None], np.float32(0.0), np.float32(-np.inf))
        return bias + empty[:, :, None] if empty.any() else bias


def _norm(x: Floats) -> Floats:
    """Layer norm of rows (..., D) without a mean, and without sqrt(D)."""
    squares = np.matmul(x[..., None, :], x[..., :, None])[..., 0]
    return x / np.sqrt(squares + np.float32(x.shape[-1] * NORM_EPS))
