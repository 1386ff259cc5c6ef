"""Closed meshes skinned to joints: rings of points along a line, joined to a surface that bends with the joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
RING = 16  # points per ring
_CAP = 4  # rings per rounded end


@dataclass(frozen=True, eq=False)
class Surface:
    """A skinned mesh: V points and F triangles, in one pose of a skeleton.

    Attributes:
        points: (V, 3) positions in the pose in which the surface was made.
        triangles: (F, 3) point indices, counterclockwise from outside.
        joints: (V, 4) joints that move a point; a joint of weight 0 may be any.
        weights: (V, 4) weights of those joints, which add up to 1.
        tints: (V, 5) shares of the TINTS in a point's colour, which add up to 1.
    """

    points: Array
    triangles: NDArray[np.int64]
    joints: NDArray[np.int64]
    weights: Array
    tints: Array

    def posed(self, matrices: Array) -> Array:
        """The points (V, 3) after each joint j has moved by the affine matrices[j]; matrices (J, 3, 4)."""
        whole = np.concatenate([self.points, np.ones((len(self.points), 1))], axis=1)
        blended = np.einsum("vk,vkij->vij", self.weights, matrices[self.joints])
        moved: Array = np.einsum("vij,vj->vi", blended, whole)
        return moved

    def colors(self, color: Array) -> Array:
        """Colours (V, 3) of the points for a figure's colour (3,), in the same scale (0 to 255)."""
        table = np.array([(1 - share) * color + share * np.array(other) for other, share in SHADES.values()])
        shades: Array = self.tints @ table
        return shades


def joined(first: Surface, second: Surface) -> Surface:
    """Two surfaces in the same pose as one."""
    return Surface(
        np.concatenate([first.points, second.points]),
        np.concatenate([first.triangles, second.triangles + len(first.points)]),
        np.concatenate([first.joints, second.joints]),
        np.concatenate([first.weights, second.weights]),
        np.concatenate([first.tints, second.tints]),
    )


def point_normals(points: Array, triangles: NDArray[np.int64]) -> Array:
    """Unit normals (V, 3) of points (V, 3): the means of their triangles' normals, weighted by area."""
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    spread = [np.bincount(triangles.ravel(), np.repeat(n, 3), len(points)) for n in normals.T]
    skin: Array = np.stack(spread, axis=-1)
    return skin / np.maximum(np.linalg.norm(skin, axis=-1, keepdims=True), 1e-12)


# Tints of body parts: a second colour, and its share in the mix with the figure's colour.
SHADES = {
    "body": ((0, 0, 0), 0.0),
    "leg": ((42, 48, 64), 0.68),
    "head": ((242, 224, 208), 0.85),
    "hand": ((242, 224, 208), 0.85),
    "foot": ((20, 23, 28), 0.82),
}
TINTS = tuple(SHADES)


@dataclass(frozen=True, eq=False)
class Ring:
    """An ellipse: middle (3,), half axes a and b (3,), the joints that move it, and its tint or None."""

    middle: Array
    a: Array
    b: Array
    joints: tuple[int, int]
    weight: float = 0.0
    tint: str | None = None


class SurfaceBuilder:
    """Combines closed pieces into one surface."""

    def __init__(self) -> None:
        self._points: list[Array] = []
        self._triangles: list[NDArray[np.int64]] = []
        self._joints: list[tuple[int, int]] = []
        self._weights: list[float] = []
        self._tints: list[int] = []

    @property
    def parts(self) -> bool:
        """Whether any piece was added."""
        return bool(self._points)

    def loft(self, rings: Sequence[Ring], tint: str = "body") -> None:
        """Add a closed skin over rings, in order from end to end; a x b points to the next ring."""
        angles = np.linspace(0.0, 2 * np.pi, RING, endpoint=False)
        first = len(self._weights)
        for ring in rings:
            around = np.cos(angles)[:, None] * ring.a + np.sin(angles)[:, None] * ring.b
            self._add(ring.middle + around, ring, tint)
        self._add(rings[0].middle[None], rings[0], tint)
        self._add(rings[-1].middle[None], rings[-1], tint)
        here = np.arange(RING)
        after = (here + 1) % RING
        for n in range(len(rings) - 1):
            low, high = first + n * RING, first + (n + 1) * RING
            self._triangles.append(np.stack([low + here, low + after, high + after], axis=-1))
            self._triangles.append(np.stack([low + here, high + after, high + here], axis=-1))
        bottom, top = first + len(rings) * RING, first + len(rings) * RING + 1
        last = first + (len(rings) - 1) * RING
        self._triangles.append(np.stack([first + after, first + here, np.full(RING, bottom)], axis=-1))
        self._triangles.append(np.stack([last + here, last + after, np.full(RING, top)], axis=-1))

    def _add(self, points: Array, ring: Ring, tint: str) -> None:
        self._points.append(points)
        self._joints += [ring.joints] * len(points)
        self._weights += [ring.weight] * len(points)
        self._tints += [TINTS.index(ring.tint or tint)] * len(points)

    def surface(self) -> Surface:
        """All pieces as one surface."""
        pairs, second = np.array(self._joints, dtype=np.int64), np.array(self._weights)
        spare = np.zeros_like(second)
        return Surface(
            np.concatenate(self._points),
            np.concatenate(self._triangles),
            np.concatenate([pairs, np.zeros_like(pairs)], axis=1),
            np.stack([1.0 - second, second, spare, spare], axis=1),
            np.eye(len(TINTS))[self._tints],
        )

    def limb(
        self,
        path: Sequence[tuple[Array, int]],
        profile: Sequence[tuple[float, ...]],
        front: Array,
        tint: str = "body",
    ) -> None:
        """Add a rounded limb along joints.

        Args:
            path: points (3,) from the near end to the far end, each with the joint that moves the bone after it.
            profile: (share of the length, half width, half depth, forward shift); shares rise from 0 to 1, and rounded
                ends extend beyond the path.
            front: (3,) direction of the depth axis.
        """
        points = np.array([point for point, _ in path])
        lengths = np.linalg.norm(np.diff(points, axis=0), axis=-1)
        arcs = np.concatenate([[0.0], np.cumsum(lengths)])
        total = max(float(arcs[-1]), 1e-9)
        along = unit(points[-1] - points[0], np.array([0.0, 1.0, 0.0]))
        across, depth = cross_axes(along, front)
        rings: list[Ring] = []
        for share, width, thick, shift in profile:
            arc = share * total
            bone = int(np.clip(np.searchsorted(arcs, arc, side="right") - 1, 0, len(lengths) - 1))
            within = (arc - arcs[bone]) / max(float(lengths[bone]), 1e-9)
            middle = points[bone] + within * (points[bone + 1] - points[bone]) + shift * depth
            joint = path[bone][1]
            rings.append(Ring(middle, width * across, thick * depth, (joint, joint)))
        self.loft(rounded(rings, along), tint)


def rounded(rings: list[Ring], along: Array) -> list[Ring]:
    """Add half an ellipsoid before the first ring and after the last."""

    def cap(ring: Ring, direction: float) -> list[Ring]:
        reach = float(np.sqrt(np.linalg.norm(ring.a) * np.linalg.norm(ring.b)))
        turns = np.linspace(0.5 * np.pi, 0.0, _CAP, endpoint=False)
        return [
            Ring(
                ring.middle + direction * reach * np.sin(turn) * along,
                max(np.cos(turn), 0.02) * ring.a,
                max(np.cos(turn), 0.02) * ring.b,
                ring.joints,
                ring.weight,
                ring.tint,
            )
            for turn in turns
        ]

    return [*cap(rings[0], -1.0), *rings, *reversed(cap(rings[-1], 1.0))]


def unit(vector: Array, otherwise: Array) -> Array:
    """The direction of a vector (3,); `otherwise` if its length is zero."""
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-9 else otherwise


def cross_axes(along: Array, front: Array) -> tuple[Array, Array]:
    """Unit axes across and front, both perpendicular to along; across x front is along."""
    depth = front - (front @ along) * along
    if np.linalg.norm(depth) < 1e-3:
        spare = np.eye(3)[int(np.argmin(np.abs(along)))]
        depth = spare - (spare @ along) * along
    depth = depth / np.linalg.norm(depth)
    return np.cross(depth, along), depth
