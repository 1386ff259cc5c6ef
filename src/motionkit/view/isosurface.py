"""Triangulates the zero surface of a field on a grid (surface nets: Gibson, MICCAI 1998)."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from motionkit.view.surface import Array

Indices = NDArray[np.int64]


def isosurface(values: Array) -> tuple[Array, Indices]:
    """Points (V, 3) in grid steps and triangles (F, 3), facing outward, around the negative region.

    Args:
        values: (X, Y, Z), positive at the border of the grid.
    """
    values = _without_corner_contacts(values)
    inside = values < 0.0
    corners = [
        inside[tuple(slice(o, n - 1 + o) for o, n in zip(at, values.shape, strict=True))] for at in _CUBE
    ]
    count = np.sum(corners, axis=0)
    cells = np.argwhere((count > 0) & (count < 8))
    numbers = np.full(count.shape, -1, dtype=np.int64)
    numbers[tuple(cells.T)] = np.arange(len(cells))
    points = _crossings(values, cells)
    return points, _split(points, _quads(inside, numbers))


_CUBE = tuple(product((0, 1), repeat=3))
_STEPS = np.eye(3, dtype=np.int64)


def _without_corner_contacts(values: Array) -> Array:
    """Values whose negative region never touches itself at a single edge, where the surface would intersect itself.

    Where only two opposite corners of a grid square are inside, the other two are moved inside as well.
    """
    values = values.copy()
    changed = True
    while changed:
        changed = False
        for axis in range(3):
            # All squares perpendicular to the axis, with their corners in order.
            flat = np.moveaxis(values, axis, 2)
            a, b, c, d = flat[:-1, :-1], flat[1:, :-1], flat[1:, 1:], flat[:-1, 1:]
            one = (a < 0.0) & (c < 0.0) & (b >= 0.0) & (d >= 0.0)
            other = (b < 0.0) & (d < 0.0) & (a >= 0.0) & (c >= 0.0)
            for mask, corners in ((one, (b, d)), (other, (a, c))):
                if mask.any():
                    changed = True
                    for corner in corners:
                        corner[mask] = -np.minimum(corner[mask], 1e-6) - 1e-9
    return values


def _crossings(values: Array, cells: Indices) -> Array:
    """The mean of the surface's intersections with the twelve edges of each cell."""
    sums, counts = np.zeros((len(cells), 3)), np.zeros((len(cells), 1))
    for axis in range(3):
        for corner in _CUBE:
            if corner[axis]:
                continue
            low = values[tuple((cells + corner).T)]
            high = values[tuple((cells + corner + _STEPS[axis]).T)]
            crossed = (low < 0.0) != (high < 0.0)
            share = low / np.where(crossed, low - high, 1.0)
            sums += crossed[:, None] * (corner + share[:, None] * _STEPS[axis])
            counts += crossed[:, None]
    return cells + sums / counts


def _quads(inside: NDArray[np.bool_], numbers: Indices) -> Indices:
    """The four cells (Q, 4) around each intersected grid edge, counterclockwise from outside."""
    quads = []
    for axis in range(3):
        b, c = _STEPS[(axis + 1) % 3], _STEPS[(axis + 2) % 3]
        low, high = np.delete(inside, -1, axis), np.delete(inside, 0, axis)
        for out, mask in ((True, low & ~high), (False, high & ~low)):
            at = np.argwhere(mask)
            around = [numbers[tuple((at - step).T)] for step in (b + c, c, 0 * c, b)]
            quads.append(np.stack(around if out else around[::-1], axis=1))
    return np.concatenate(quads)


def _split(points: Array, quads: Indices) -> Indices:
    """Triangles (F, 3) of quads, cut along the shorter diagonal."""
    first = np.linalg.norm(points[quads[:, 0]] - points[quads[:, 2]], axis=1)
    second = np.linalg.norm(points[quads[:, 1]] - points[quads[:, 3]], axis=1)
    turned = np.where((first <= second)[:, None], quads, np.roll(quads, -1, axis=1))
    return np.concatenate([turned[:, [0, 1, 2]], turned[:, [0, 2, 3]]])


def neighbour_mean(triangles: Indices, rows: Array) -> Array:
    """The mean of rows (V, N) over the neighbours of each point."""
    edges = np.concatenate([triangles[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))])
    order = np.argsort(edges[:, 0], kind="stable")
    starts = np.searchsorted(edges[order, 0], np.arange(len(rows)))
    counts = np.diff(np.append(starts, len(edges)))
    means: Array = np.add.reduceat(rows[edges[order, 1]], starts, axis=0) / counts[:, None]
    return means
