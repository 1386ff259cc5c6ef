"""Array types, and array functions that numpy lacks."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

Array = NDArray[Any]
Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]


def length(vectors: Array) -> Array:
    """Euclidean lengths (...) of vectors (..., N)."""
    return np.sqrt((vectors * vectors).sum(axis=-1))


def normalized(vectors: Array, eps: float = 1e-12) -> Array:
    """Vectors (..., N) scaled to length 1; vectors shorter than eps are divided by eps."""
    return vectors / np.maximum(length(vectors), eps)[..., None]


def smoothstep(x: Array) -> Array:
    """Smooth step from 0 to 1 for x (...) between 0 and 1; the slope is zero at both ends."""
    return x * x * (3.0 - 2.0 * x)


def lerp(a: Array, b: Array, share: Array | float) -> Array:
    """Linear interpolation from a (share 0) to b (share 1); share is broadcast against both."""
    return a + share * (b - a)


def smoothed(values: Array, half: int) -> Array:
    """Values (T, k), each averaged over `half` frames on both sides; near frames weigh more (Hann window)."""
    kernel = np.hanning(2 * half + 3)[1:-1]
    kernel = (kernel / kernel.sum()).astype(values.dtype)
    padded = np.pad(values, ((half, half), (0, 0)), mode="edge")
    return sliding_window_view(padded, 2 * half + 1, axis=0) @ kernel


def peak_smoothed(size: Array, values: Array, half: int) -> Array:
    """Values (T, k), each replaced by the one of largest size (T,) within `half` frames, then smoothed as widely.

    The result is never smaller than the values.
    """
    around = sliding_window_view(np.pad(size, half, constant_values=-1.0), 2 * half + 1)
    largest = values[around.argmax(axis=-1) + np.arange(len(size)) - half]
    return smoothed(largest, half)


def lower_median(values: Array, axis: int = 0) -> Array:
    """The median along an axis; for an even number of values, the lower of the middle two."""
    middle = (values.shape[axis] - 1) // 2
    return np.take(np.partition(values, middle, axis=axis), middle, axis=axis)


def cross(a: Array, b: Array) -> Array:
    """Cross products (..., 3); faster than np.cross, whose checks cost more than the product."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape), np.result_type(a, b))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return out


def distances_between(a: Array, b: Array) -> Array:
    """Euclidean distances (N, M) between the rows of a (N, D) and of b (M, D)."""
    a, b = a.astype(np.float64), b.astype(np.float64)  # exact for close rows
    squares = np.square(a).sum(axis=1)[:, None] + np.square(b).sum(axis=1) - 2.0 * (a @ b.T)
    return np.sqrt(np.maximum(squares, 0.0))


def row_products(x: Floats, weights: Floats) -> Floats:
    """Rows x (..., B, N) times weights (..., N, M): (..., B, M), with one matrix product per row.

    A single product could add up in another order when the number of rows or threads changes.
    """
    return np.matmul(x[..., None, :], weights[..., None, :, :])[..., 0, :]


def spans(flags: Array) -> list[tuple[int, int]]:
    """Ranges (start, end) in which flags (T,) are true; ends are exclusive."""
    edges = np.diff(np.pad(flags.astype(np.int8), 1))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return list(zip(starts.tolist(), ends.tolist(), strict=True))
