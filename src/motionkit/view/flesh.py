"""A smooth skin over rounded pieces with elliptic sections, which blend where they meet.

Each piece is a distance field. A soft minimum joins the fields over a distance of BLEND, and the skin is its zero
surface. Pieces also give the skin its joints and tints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from motionkit.errors import SkeletonError
from motionkit.view.isosurface import isosurface, neighbour_mean
from motionkit.view.surface import TINTS, Array, Surface, cross_axes, unit

STEP = 0.0135  # m, grid step for a body of default size
COARSE_STEP = 0.02  # m, grid step for small pictures
BLEND = 0.010  # m, width of the blend between pieces
GRIP = 0.016  # m, distance over which skin weights blend between pieces
DYE = 0.009  # m, the same for tints
SMOOTHINGS = 4  # passes that average the weights over neighbouring points
INFLUENCES = 4  # most joints per point
MAX_CELLS = 2_000_000  # most grid cells; a rig with very short legs for its body gets a coarser grid
COARSEST = 0.05  # m, largest grid step for a body of default size; a thigh is 0.16 thick
_SAMPLES = 48  # points per profile
Chain = Sequence[tuple[float, float, int]]


@dataclass(frozen=True, eq=False)
class Piece:
    """A rounded limb along joints.

    Attributes:
        path: (K, 3) points from the near end to the far end.
        profile: (S, 4) share of the length, half width, half depth, shift along the depth. Shares rise from 0 to 1;
            rounded ends extend beyond them.
        front: (3,) direction of the depth axis.
        joints: first joint, then for each further one (share of the length where it takes over, half width of the
            transition, joint).
        tints: tints, in the same form.
        power: exponent of the section: 2 is an ellipse, larger values are more rectangular.
        caps: length of the rounded ends, relative to the piece's width there.
    """

    path: Array
    profile: Array
    front: Array
    joints: tuple[int, Chain]
    tints: tuple[int, Chain]
    power: float = 2.0
    caps: tuple[float, float] = (1.0, 1.0)

    @cached_property
    def axes(self) -> tuple[Array, Array, Array]:
        """Unit axes (3,) across, in depth and along the piece."""
        along = unit(self.path[-1] - self.path[0], np.array([0.0, 1.0, 0.0]))
        across, depth = cross_axes(along, self.front)
        return across, depth, along

    @cached_property
    def length(self) -> float:
        return max(float(np.linalg.norm(self.path[-1] - self.path[0])), 1e-6)

    @cached_property
    def table(self) -> Array:
        """Rows (N, 6) along the piece, interpolated smoothly: share, half width, half depth, middle (3,)."""
        shares = np.linspace(0.0, 1.0, _SAMPLES)
        _, depth, along = self.axes
        heights = (self.path - self.path[0]) @ along / self.length
        lines = [np.interp(shares, np.maximum.accumulate(heights), self.path[:, k]) for k in range(3)]
        rows = [_smooth_interp(shares, self.profile[:, 0], self.profile[:, k]) for k in (1, 2, 3)]
        middles = np.stack(lines, axis=1) + rows[2][:, None] * depth
        return np.concatenate([np.stack([shares, rows[0], rows[1]], axis=1), middles], axis=1)

    def shares(self, points: Array) -> Array:
        """Positions of points (..., 3) along the piece: 0 at its near end, 1 at its far end."""
        shares: Array = (points - self.path[0]) @ self.axes[2] / self.length
        return shares

    def distances(self, points: Array) -> Array:
        """Approximate signed distances of points (..., 3) from the surface; negative inside."""
        share = self.shares(points)
        inner = np.clip(share, 0.0, 1.0)
        wide, deep, x, y, z = (np.interp(inner, self.table[:, 0], column) for column in self.table[:, 1:].T)
        away = points - np.stack([x, y, z], axis=-1)
        across, depth, _ = self.axes
        ends = np.sqrt(wide * deep) * np.where(share < 0.5, *self.caps)
        radii = np.stack([wide, deep, ends], axis=-1)
        scaled = (
            np.abs(np.stack([away @ across, away @ depth, (share - inner) * self.length], axis=-1)) / radii
        )
        size = (scaled**self.power).sum(axis=-1) ** (1.0 / self.power)
        slope = np.sqrt(((scaled / radii) ** 2).sum(axis=-1))
        distances: Array = np.where(size > 1e-6, size * (size - 1.0) / np.maximum(slope, 1e-9), -deep)
        return distances


def _smooth_interp(at: Array, x: Array, y: Array) -> Array:
    """Cubic interpolation through (x, y) without overshoot (Fritsch and Carlson, 1980)."""
    steps, rises = np.diff(x), np.diff(y)
    slopes = rises / steps
    turns = np.zeros_like(y)
    same = slopes[:-1] * slopes[1:] > 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        means = 2.0 / (1.0 / slopes[:-1] + 1.0 / slopes[1:])
    turns[1:-1] = np.where(same, means, 0.0)
    turns[0], turns[-1] = slopes[0], slopes[-1]
    n = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(steps) - 1)
    t, h = (at - x[n]) / steps[n], steps[n]
    curve: Array = (
        y[n] * (1 + 2 * t) * (1 - t) ** 2
        + turns[n] * h * t * (1 - t) ** 2
        + y[n + 1] * t**2 * (3 - 2 * t)
        + turns[n + 1] * h * t**2 * (t - 1)
    )
    return curve


def _chain_weights(shares: Array, first: int, chain: Chain, count: int) -> Array:
    """Weights (N, count) of a chain's members at shares (N,); each row adds up to 1."""
    weights, left = np.zeros((len(shares), count)), np.ones(len(shares))
    member = first
    for start, half, after in chain:
        t = np.clip((shares - start) / (2 * half) + 0.5, 0.0, 1.0)
        passed = t * t * (3 - 2 * t)
        weights[:, member] += left * (1 - passed)
        left, member = left * passed, after
    weights[:, member] += left
    return weights


def skin(pieces: Sequence[Piece], axes: Array, size: float, joint_count: int, step: float = STEP) -> Surface:
    """The skin over pieces, as a mesh.

    Args:
        pieces: at least one.
        axes: (3, 3) left, up and front of the body, in rows; a body symmetric about the middle of its first piece gets
            a symmetric mesh.
        size: size of the body; 1 is the default size.
        joint_count: number of joints of the skeleton.
        step: approximate edge length of the mesh for a body of default size, m.

    Raises:
        SkeletonError: a bone is so long beside the legs that a grid around the body would be too coarse for limbs.
    """
    step *= size
    points, triangles, slopes = _net(pieces, axes, step, size)
    for _ in range(2):  # even out the points, then project them onto the skin
        points = 0.5 * (points + neighbour_mean(triangles, points))
        values = _soft_minimum(np.stack([piece.distances(points) for piece in pieces], axis=1), BLEND * size)
        points = points - np.clip(values, -step, step)[:, None] * slopes(points)
    distances = np.stack([piece.distances(points) for piece in pieces], axis=1)
    joints = _blended(pieces, distances, points, GRIP * size, joint_count, "joints")
    for _ in range(SMOOTHINGS):
        joints = 0.5 * (joints + neighbour_mean(triangles, joints))
    tints = _blended(pieces, distances, points, DYE * size, len(TINTS), "tints")
    order = np.argsort(-joints, axis=1, kind="stable")[:, :INFLUENCES]
    weights = np.take_along_axis(joints, order, axis=1)
    return Surface(points, triangles, order, weights / weights.sum(axis=1, keepdims=True), tints)


def _soft_minimum(distances: Array, blend: float) -> Array:
    least = distances.min(axis=1)
    soft: Array = least - blend * np.log(np.exp(-(distances - least[:, None]) / blend).sum(axis=1))
    return soft


def _blended(
    pieces: Sequence[Piece], distances: Array, points: Array, soft: float, count: int, what: str
) -> Array:
    """Values of the pieces at points, (V, count), blended over pieces that are about equally near."""
    near = np.exp(-(distances - distances.min(axis=1, keepdims=True)) / soft)
    near /= near.sum(axis=1, keepdims=True)
    out = np.zeros((len(points), count))
    for n, piece in enumerate(pieces):
        first, chain = getattr(piece, what)
        some = np.flatnonzero(near[:, n] > 1e-3)
        out[some] += near[some, n, None] * _chain_weights(piece.shares(points[some]), first, chain, count)
    return out / out.sum(axis=1, keepdims=True)


def _net(
    pieces: Sequence[Piece], axes: Array, step: float, size: float
) -> tuple[Array, NDArray[np.int64], Callable[[Array], Array]]:
    """Points, triangles, and a function for the field's unit gradient at points."""
    blend = BLEND * size
    margin = 5 * blend
    # Boxes are aligned with the body's axes, so that the grid is symmetric.
    boxes = [_turned_box(piece, axes, margin) for piece in pieces]
    low, high = np.min([b[0] for b in boxes], axis=0), np.max([b[1] for b in boxes], axis=0)
    step = max(step, float((np.prod(high - low) / MAX_CELLS) ** (1 / 3)))
    if step > COARSEST * size:
        raise SkeletonError(f"a body of {np.max(high - low):.4g} m is too large for its legs")
    middle = axes @ pieces[0].path[0]
    counts = np.ceil((high - low) / step).astype(int) + 3
    origin = np.floor((low - middle) / step - 1) * step + middle + 0.5 * step
    grid = np.full(counts, np.exp(-margin / blend))
    for piece, (start, end) in zip(pieces, boxes, strict=True):
        a = np.maximum(np.floor((start - origin) / step).astype(int), 0)
        b = np.minimum(np.ceil((end - origin) / step).astype(int) + 1, counts)
        places = [origin[k] + step * np.arange(a[k], b[k]) for k in range(3)]
        points = np.stack(np.meshgrid(*places, indexing="ij"), axis=-1) @ axes
        part = grid[a[0] : b[0], a[1] : b[1], a[2] : b[2]]
        part += np.exp(-np.minimum(piece.distances(points), margin) / blend)
    field = -blend * np.log(grid)
    steps, triangles = isosurface(field)
    gradients = np.stack([np.gradient(field, axis=k) for k in range(3)], axis=-1)

    def slopes(points: Array) -> Array:
        at = np.clip(np.rint((points @ axes.T - origin) / step).astype(int), 0, counts - 1)
        found = gradients[tuple(at.T)]
        return unit_rows(found) @ axes

    return (origin + step * steps) @ axes, triangles, slopes


def unit_rows(rows: Array) -> Array:
    """Rows (N, 3) scaled to length 1."""
    scaled: Array = rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-12)
    return scaled


def _turned_box(piece: Piece, axes: Array, margin: float) -> tuple[Array, Array]:
    middles = piece.table[:, 3:] @ axes.T
    reach = piece.table[:, 1:3].max(axis=1, keepdims=True) * 1.05 + margin
    return (middles - reach).min(axis=0), (middles + reach).max(axis=0)
