"""One smooth skin over many rounded pieces: limbs of elliptic sections, joined where they meet.

Each piece is a distance field; a soft minimum joins them (its blend is `BLEND`), and the skin is where the sum is zero.
The pieces also carry the joints and tints of the skin around them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from motionkit.view.isosurface import isosurface, neighbour_mean
from motionkit.view.surface import TINTS, Array, Surface, cross_axes, unit

STEP = 0.0135  # m, grid step for a body of usual size
COARSE_STEP = 0.02  # m, where few pixels show it
BLEND = 0.010  # m, how softly pieces join
GRIP = 0.016  # m, how softly the skin passes from the joints of one piece to those of the next
DYE = 0.009  # m, the same for tints
SMOOTHINGS = 4  # rounds of averaging the weights over neighbours
INFLUENCES = 4  # joints that move a point
MAX_CELLS = 2_000_000  # of the grid; a rig whose legs say little of its size gets a coarser one
_SAMPLES = 48  # of a profile
Chain = Sequence[tuple[float, float, int]]


@dataclass(frozen=True, eq=False)
class Piece:
    """A rounded limb along joints.

    Attributes:
        path: (K, 3) points from the near to the far end.
        profile: (S, 4) share of the length, half width, half depth, shift along the depth; the shares rise from 0 to 1,
            and rounded ends extend beyond them.
        front: (3,) direction of the depth.
        joints: the joint at the near end, then for each further joint (share where it begins, half width of the
            change as a share, joint).
        tints: the same for tints.
        power: of the section: 2 is an ellipse, more is closer to a rectangle.
        caps: how far the rounded ends reach; at 1 they are as long as the piece is wide there.
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
        """Across, depth and along (3,)."""
        along = unit(self.path[-1] - self.path[0], np.array([0.0, 1.0, 0.0]))
        across, depth = cross_axes(along, self.front)
        return across, depth, along

    @cached_property
    def length(self) -> float:
        return max(float(np.linalg.norm(self.path[-1] - self.path[0])), 1e-6)

    @cached_property
    def table(self) -> Array:
        """(N, 7) share, half width, half depth and middle (3,) along the piece, smooth between the given shares."""
        shares = np.linspace(0.0, 1.0, _SAMPLES)
        _, depth, along = self.axes
        heights = (self.path - self.path[0]) @ along / self.length
        lines = [np.interp(shares, np.maximum.accumulate(heights), self.path[:, k]) for k in range(3)]
        rows = [_smooth_interp(shares, self.profile[:, 0], self.profile[:, k]) for k in (1, 2, 3)]
        middles = np.stack(lines, axis=1) + rows[2][:, None] * depth
        return np.concatenate([np.stack([shares, rows[0], rows[1]], axis=1), middles], axis=1)

    def shares(self, points: Array) -> Array:
        """Where points (..., 3) are along the piece: 0 at its near, 1 at its far end."""
        shares: Array = (points - self.path[0]) @ self.axes[2] / self.length
        return shares

    def distances(self, points: Array) -> Array:
        """About how far points (..., 3) are from the surface, negative inside."""
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
    """Cubic interpolation through (x, y) that overshoots nowhere (Fritsch and Carlson, 1980)."""
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
    """Weights (N, count) of the members of a chain at shares (N,); they add up to 1."""
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
    """The skin over pieces.

    Args:
        pieces: at least one.
        axes: (3, 3) the directions left, up and front of the body in rows; a body that is the same on both sides of
            the plane through the first piece gets the same skin there.
        size: of the body; 1 is usual.
        joint_count: of the skeleton.
        step: about the length of the mesh's edges for a body of usual size, m.
    """
    step *= size
    points, triangles, slopes = _net(pieces, axes, step, BLEND * size)
    for _ in range(2):  # even out the points, then back to the skin
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
    """What pieces carry at points, (V, count): of the nearest piece, and of others that are about as near."""
    near = np.exp(-(distances - distances.min(axis=1, keepdims=True)) / soft)
    near /= near.sum(axis=1, keepdims=True)
    out = np.zeros((len(points), count))
    for n, piece in enumerate(pieces):
        first, chain = getattr(piece, what)
        some = np.flatnonzero(near[:, n] > 1e-3)
        out[some] += near[some, n, None] * _chain_weights(piece.shares(points[some]), first, chain, count)
    return out / out.sum(axis=1, keepdims=True)


def _net(
    pieces: Sequence[Piece], axes: Array, step: float, blend: float
) -> tuple[Array, NDArray[np.int64], Callable[[Array], Array]]:
    """Points, triangles, and a function that gives the field's unit gradient at points."""
    margin = 5 * blend
    # Boxes along the body's axes, so that the grid is the same on its left and right.
    boxes = [_turned_box(piece, axes, margin) for piece in pieces]
    low, high = np.min([b[0] for b in boxes], axis=0), np.max([b[1] for b in boxes], axis=0)
    step = max(step, float((np.prod(high - low) / MAX_CELLS) ** (1 / 3)))
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
    """Rows (N, 3) made one long."""
    scaled: Array = rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-12)
    return scaled


def _turned_box(piece: Piece, axes: Array, margin: float) -> tuple[Array, Array]:
    middles = piece.table[:, 3:] @ axes.T
    reach = piece.table[:, 1:3].max(axis=1, keepdims=True) * 1.05 + margin
    return (middles - reach).min(axis=0), (middles + reach).max(axis=0)
