"""Fills many small triangles at once in numpy; one call per triangle would be far slower."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from motionkit.view.surface import Array

_AT_ONCE = 500_000  # pixels filled at a time, to limit memory


def fill_triangles(canvas: NDArray[np.uint8], corners: Array, colors: NDArray[np.uint8]) -> None:
    """Fill the pixels whose centres are inside triangles; later triangles cover earlier ones.

    Args:
        canvas: (H, W, C), changed in place.
        corners: (F, 3, 2) x and y in pixels, in either orientation; triangles that are not finite are skipped.
        colors: (F, C) one colour per triangle.
    """
    height, width = canvas.shape[:2]
    with np.errstate(invalid="ignore"):
        lows = np.minimum(np.minimum(corners[:, 0], corners[:, 1]), corners[:, 2])
        highs = np.maximum(np.maximum(corners[:, 0], corners[:, 1]), corners[:, 2])
        first = np.maximum(np.ceil(lows - 0.5), 0.0)
        last = np.minimum(np.floor(highs - 0.5), [width - 1.0, height - 1.0])
        # Comparisons with NaN are False.
        sides, areas = _sides(corners)
        seen = np.flatnonzero((last >= first).all(axis=1) & (areas > 0.0) & (areas < np.inf))
    tops, counts = first[seen, 1], (last - first)[seen, 1].astype(np.int64) + 1
    which, within = _spread(counts)
    rows = tops[which] + within
    starts, ends = _spans(sides[seen[which]], rows + 0.5)
    starts, ends = np.maximum(np.ceil(starts - 0.5), 0.0), np.minimum(np.floor(ends - 0.5), width - 1.0)
    some = np.flatnonzero(ends >= starts)
    lengths = (ends - starts)[some].astype(np.int64) + 1
    begins = (rows[some] * width + starts[some]).astype(np.int64)
    paints = colors[seen[which[some]]]
    pixels = canvas.reshape(height * width, -1)
    for part in _parts(lengths):
        run, within = _spread(lengths[part])
        # If a pixel is assigned several times, the last value remains.
        pixels[begins[part][run] + within] = paints[part][run]


def _sides(corners: Array) -> tuple[Array, Array]:
    """The sides (F, 3, 3) as lines a x + b y + c, non-negative inside, and twice the area (F,)."""
    after = corners[:, [1, 2, 0]]
    a, b = corners[..., 1] - after[..., 1], after[..., 0] - corners[..., 0]
    c = -(a * corners[..., 0] + b * corners[..., 1])
    areas = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    turn = np.where(areas < 0.0, -1.0, 1.0)[:, None]
    return np.stack([a * turn, b * turn, c * turn], axis=1), np.abs(areas)


def _spans(sides: Array, y: Array) -> tuple[Array, Array]:
    """Start and end of pixel rows (N,) at heights y in triangles with sides (N, 3, 3)."""
    a = sides[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = -(sides[:, 1] * y[:, None] + sides[:, 2]) / a
    starts = np.where(a > 0.0, crossings, -np.inf)
    ends = np.where(a < 0.0, crossings, np.inf)
    return (
        np.maximum(np.maximum(starts[:, 0], starts[:, 1]), starts[:, 2]),
        np.minimum(np.minimum(ends[:, 0], ends[:, 1]), ends[:, 2]),
    )


def _spread(counts: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """For items with counts of parts: each part's item, and its index within the item."""
    which = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
    return which, within


def _parts(lengths: NDArray[np.int64]) -> list[slice]:
    """Consecutive slices of about _AT_ONCE pixels each."""
    ends = np.cumsum(lengths)
    cuts = np.searchsorted(ends, np.arange(_AT_ONCE, int(ends[-1]) if len(ends) else 0, _AT_ONCE))
    edges = np.unique([0, *cuts, len(lengths)])
    return [slice(a, b) for a, b in pairwise(edges)]
