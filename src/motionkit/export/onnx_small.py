"""Preparation of weights for products in 8 bits.

A row in 8 bits has one scale. A few channels of the residual stream are much larger than the others, which would be
left with few steps. A rotation of all channels spreads the large ones over the others and changes nothing else: maps
that write into the stream are rotated, maps that read from it are rotated back, and norms depend on lengths only.
The rotation keeps the vector of ones, because the stream must keep a mean of zero.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import Floats
from motionkit.inference.step_weights import ModuleWeights, StepWeights

Doubles = NDArray[np.float64]


def spread_channels(weights: StepWeights) -> StepWeights:
    """Return the same network with rotated channels; the rotation is random but always the same."""
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


def balance_heads(weights: StepWeights) -> StepWeights:
    """Return the same network with rotated heads whose queries, keys and values (L, P, D, 3 H E) fit one scale.

    Keys are four times as large as queries. A factor on queries can be divided out of keys, and both can be rotated
    alike. The map after the values takes back their factor and rotation.
    """
    heads = weights.config.heads
    size = weights.config.width // heads
    turns = np.random.default_rng(1).standard_normal((heads, size, size))
    turns = np.linalg.qr(turns)[0]

    def module(m: ModuleWeights) -> ModuleWeights:
        layers, parts, width, _ = m.qkv.shape
        maps = m.qkv.astype(np.float64).reshape(layers, parts, width, 3, heads, size)
        maps = np.einsum("lpdche,hef->lpdchf", maps, turns)
        biases = m.qkv_bias.astype(np.float64).reshape(layers, parts, 3, heads, size)
        biases = np.einsum("lpche,hef->lpchf", biases, turns)
        out = m.out.astype(np.float64).reshape(layers, parts, heads, size, width)
        out = np.einsum("hef,lphed->lphfd", turns, out)
        # The largest column of each head (L, P, 3, H), and its new size.
        largest = _column_sizes(maps.transpose(0, 1, 3, 4, 2, 5)).max(axis=-1)
        both = np.sqrt(largest[:, :, 0] * largest[:, :, 1])
        values = np.broadcast_to(both.max(axis=(1, 2), keepdims=True), both.shape)
        factors = np.stack([both, both, values], axis=2) / largest
        maps *= factors[:, :, None, :, :, None]
        biases *= factors[..., None]
        out /= factors[:, :, 2, :, None, None]
        found = (maps.reshape(m.qkv.shape), biases.reshape(m.qkv_bias.shape), out.reshape(m.out.shape))
        qkv, qkv_bias, out = (array.astype(np.float32) for array in found)
        return replace(m, qkv=qkv, qkv_bias=qkv_bias, out=out)

    return replace(weights, shallow=module(weights.shallow), deep=module(weights.deep))


def whole_numbers(weight: Floats, even: bool = False) -> tuple[NDArray[np.int8], Floats]:
    """Return a map (K, N) in 8 bits and the scales (N,) of its columns; one scale for all if even.

    Processors without special instructions for 8 bits add the products of two neighbouring rows in 16 bits and
    saturate. Values go up to 255, so two neighbouring weights may add up to at most 128 on either side of zero.
    """
    scale = _column_sizes(weight)
    scale = np.full_like(scale, scale.max()) if even else scale
    return np.rint(weight / scale).astype(np.int8), scale


def _column_sizes(weight: NDArray) -> Floats:
    """Return the scales (..., N) with which the columns of maps (..., K, N) fit into 8 bits."""
    rest = [(0, 0)] * (weight.ndim - 2)
    padded = np.pad(weight, [*rest, (0, weight.shape[-2] % 2), (0, 0)])
    pairs = padded.reshape(*weight.shape[:-2], -1, 2, weight.shape[-1])
    sums = np.maximum(pairs.clip(min=0.0).sum(axis=-2), -pairs.clip(max=0.0).sum(axis=-2)).max(axis=-2)
    # Rounding may add half a step to each of the two.
    sizes = np.maximum(np.maximum(sums / 127, np.abs(weight).max(axis=-2) / 127), 1e-12)
    return sizes.astype(np.float32)


def _rotation(size: int) -> Doubles:
    """Return an orthogonal matrix that keeps the vector of ones."""
    numbers = np.random.default_rng(0).standard_normal((2, size, size))
    numbers[:, :, 0] = 1.0
    first, second = (np.linalg.qr(each)[0][:, 1:] for each in numbers)
    return np.full((size, size), 1.0 / size) + first @ second.T


def _written(maps: Floats, turn: Doubles) -> Floats:
    """Rotate maps whose outputs (..., n D) are channels."""
    blocks = maps.reshape(*maps.shape[:-1], -1, len(turn)).astype(np.float64)
    return (blocks @ turn).reshape(maps.shape).astype(np.float32)


def _read(maps: Floats, turn: Doubles) -> Floats:
    """Rotate maps whose inputs (..., n D, N) are channels."""
    blocks = maps.reshape(*maps.shape[:-2], -1, len(turn), maps.shape[-1]).astype(np.float64)
    return (turn.T @ blocks).reshape(maps.shape).astype(np.float32)
