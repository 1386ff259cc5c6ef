"""Skinned meshes whose regions, such as a shirt, have one colour each."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
REGIONS = ("Shirt", "Trousers", "Skin", "Shoes", "Hair", "Eyes", "Iris")
# Share of a region's natural colour; the rest is the figure's colour, which sets figures apart.
COLOR_SHARES = (0.0, 0.82, 1.0, 1.0, 1.0, 1.0, 1.0)


@dataclass(frozen=True, eq=False)
class Surface:
    """A skinned mesh: V points and F triangles, in one pose of a skeleton.

    Attributes:
        points: (V, 3) positions in the pose in which the surface was made.
        triangles: (F, 3) point indices, counterclockwise from outside; the points of one have the same region.
        joints: (V, 4) joints that move a point; a joint of weight 0 may be any.
        weights: (V, 4) weights of those joints, which add up to 1.
        regions: (V,) index into REGIONS.
        palette: (R, 3) colours of the regions, 0 to 255.
    """

    points: Array
    triangles: NDArray[np.int64]
    joints: NDArray[np.int64]
    weights: Array
    regions: NDArray[np.int64]
    palette: Array

    def posed(self, matrices: Array) -> Array:
        """The points (V, 3) after each joint j has moved by the affine matrices[j]; matrices (J, 3, 4)."""
        return self.moved(matrices, self.points)[0]

    def moved(self, matrices: Array, normals: Array) -> tuple[Array, Array]:
        """The points (V, 3) and normals (V, 3) after each joint j has moved by the affine matrices[j]."""
        whole = np.zeros((len(self.points), len(matrices)))
        for joints, weights in zip(self.joints.T, self.weights.T, strict=True):
            whole[np.arange(len(whole)), joints] += weights
        blended = (whole @ matrices.reshape(len(matrices), 12)).reshape(-1, 3, 4)
        turns = blended[..., :3]
        points: Array = np.einsum("vij,vj->vi", turns, self.points) + blended[..., 3]
        return points, np.einsum("vij,vj->vi", turns, normals)

    def shades(self, color: Array) -> Array:
        """Colours (R, 3) of the regions for a figure's colour (3,), in the same scale (0 to 255)."""
        share = np.array(COLOR_SHARES)[:, None]
        shades: Array = (1.0 - share) * color + share * self.palette
        return shades

    @cached_property
    def normals(self) -> Array:
        """Unit normals (V, 3), means over the triangles around each place; borders of regions share their places."""
        corners = self.points[self.triangles]
        flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        place = np.unique(self.points.round(6), axis=0, return_inverse=True)[1].reshape(-1)
        at = place[self.triangles].ravel()
        sums = np.stack([np.bincount(at, np.repeat(n, 3), place.max() + 1) for n in flat.T], axis=-1)
        normals: Array = (sums / np.maximum(np.linalg.norm(sums, axis=-1, keepdims=True), 1e-12))[place]
        return normals


def unit(vector: Array, otherwise: Array) -> Array:
    """The direction of a vector (3,); `otherwise` if its length is zero."""
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-9 else otherwise
