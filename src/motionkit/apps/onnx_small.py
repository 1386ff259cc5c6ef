"""Weights made ready for products in 8 bits.

Rows of 8 bits share a scale, and a few channels of the residual stream that are much larger than the others would
leave these few steps. A rotation of all channels spreads the large ones over the others, and changes nothing
else: what writes into the stream is rotated, what reads from it is rotated back, and a norm sees lengths
alone. All ones stay where they are, for the stream has no mean and is to have none.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from motionkit.models.step_weights import Floats, ModuleWeights, StepWeights

Doubles = NDArray[np.float64]


def spread_channels(weights: StepWeights) -> StepWeights:
    """The same network with its channels rotated, by any rotation, but always the same one."""
    turn = _rotation(weights.config.width)

    def module(m: ModuleWeights) -> ModuleWeights:
        return replace(
            m,
            embed=_written(m.embed, turn),
            embed_bias=_written(m.embed_bias, turn),
            layer_controls=_written(m.layer_controls, turn),
            qkv=_read(m.qkv, turn),
            out=_written(m.out, turn),
            inner=_read(m.inner, turn),
            outer=_written(m.outer, turn),
        )

    deep = module(weights.deep)
    return replace(
        weights,
        shallow=module(weights.shallow),
        deep=replace(deep, embed=_read(deep.embed, turn)),
        contact_shallow=_read(weights.contact_shallow, turn),
        head=_read(weights.head, turn),
    )


def whole_numbers(weight: Floats) -> tuple[NDArray[np.int8], Floats]:
    """A map (K, N) in 8 bits, and the scales (N,) of its columns.

    Processors without instructions of their own for 8 bits add the products of two neighbouring rows in 16 bits, and
    cut off what is beyond. Values being up to 255, two neighbours may come to 128 on either side of zero.
    """
    padded = np.concatenate([weight, np.zeros((len(weight) % 2, weight.shape[1]), np.float32)])
    pairs = padded.reshape(-1, 2, weight.shape[1])
    sums = np.maximum(pairs.clip(min=0.0).sum(axis=1), -pairs.clip(max=0.0).sum(axis=1)).max(axis=0)
    # Rounding may add half a step to each of two.
    scale = np.maximum(np.maximum(sums / 127, np.abs(weight).max(axis=0) / 127), 1e-12).astype(np.float32)
    return np.rint(weight / scale).astype(np.int8), scale


def _rotation(size: int) -> Doubles:
    """An orthogonal matrix that leaves all ones as they are."""
    numbers = np.random.default_rng(0).standard_normal((2, size, size))
    numbers[:, :, 0] = 1.0
    first, second = (np.linalg.qr(each)[0][:, 1:] for each in numbers)
    return np.full((size, size), 1.0 / size) + first @ second.T


def _written(maps: Floats, turn: Doubles) -> Floats:
    """Maps whose outputs (..., n D) are channels."""
    blocks = maps.reshape(*maps.shape[:-1], -1, len(turn)).astype(np.float64)
    return (blocks @ turn).reshape(maps.shape).astype(np.float32)


def _read(maps: Floats, turn: Doubles) -> Floats:
    """Maps whose inputs (..., n D, N) are channels."""
    blocks = maps.reshape(*maps.shape[:-2], -1, len(turn), maps.shape[-1]).astype(np.float64)
    return (turn.T @ blocks).reshape(maps.shape).astype(np.float32)
