"""The figure of a motion, in metres, for formats that hold a body mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import SkeletonError
from motionkit.motion.motion import Motion
from motionkit.rig.upright import in_metres
from motionkit.view.body import make_body
from motionkit.view.surface import SHADES, TINTS, Surface, point_normals

SHIRT = np.array([79.0, 134.0, 232.0])  # default body colour, 0 to 255
NAMES = {"body": "Shirt", "leg": "Trousers", "head": "Head", "hand": "Hands", "foot": "Shoes"}


@dataclass(frozen=True, eq=False)
class Figure:
    """A motion with its body mesh, in metres with Y up.

    Attributes:
        motion: the motion.
        rest: (J, 3) local translations of the rest pose, which stands on the floor; its rotations are identity.
        inverse_binds: (J, 4, 4) matrices from the world to each joint's space in the pose of the mesh; they act on
            columns.
        surface: the mesh.
        normals: (V, 3) normals of its points.
    """

    motion: Motion
    rest: Array
    inverse_binds: Array
    surface: Surface
    normals: Array


def joint_translations(motion: Motion) -> Array:
    """Local translations (T, J, 3) of all joints; the root's is its position in the world."""
    shape = (len(motion), len(motion.skeleton), 3)
    still = np.broadcast_to(motion.skeleton.offsets, shape)
    places = np.array(still if motion.local_positions is None else motion.local_positions, np.float32)
    places[:, 0] = motion.root_positions
    return places


def make_figure(motion: Motion) -> Figure:
    """The body of a motion of any rig and unit, in metres. Raises SkeletonError if its bones allow none."""
    motion = in_metres(motion).motion
    surface, pose = make_body(motion)
    rest = motion.skeleton.offsets.astype(np.float64)
    rest[0] = 0.0
    places = motion.skeleton.rest_positions()
    unturned = np.broadcast_to(np.eye(3), (len(rest), 3, 3))
    rest[0, 1] = -surface.posed(pose.matrices_from(unturned, places.astype(np.float64)))[:, 1].min()
    normals = point_normals(surface.points, surface.triangles)
    flat = np.linalg.norm(normals, axis=-1, keepdims=True) < 0.5
    normals = np.where(flat, np.array([0.0, 1.0, 0.0]), normals)
    binds = pose.inverse_matrices()
    if not all(np.isfinite(values).all() for values in (surface.points, surface.weights, rest, binds)):
        raise SkeletonError("no body can be made around these bones")
    return Figure(motion, rest, binds, surface, normals)


def skin_weights(surface: Surface) -> tuple[Array, Array]:
    """Up to four joints (V, 4) per point, all different, and their weights (V, 4); unused entries are joint 0."""
    joints, weights = surface.joints.copy(), surface.weights.astype(np.float64)
    for later in range(1, joints.shape[1]):
        for earlier in range(later):
            same = joints[:, later] == joints[:, earlier]
            weights[same, earlier] += weights[same, later]
            weights[same, later] = 0.0
    weights = np.where(weights < 1e-4, 0.0, weights)
    weights /= weights.sum(axis=1, keepdims=True)
    return np.where(weights > 0.0, joints, 0).astype(np.uint16), weights.astype(np.float32)


def materials(surface: Surface) -> list[tuple[str, tuple[float, ...], Array]]:
    """Name, linear colour and triangles (N,) of each part of the body; a triangle belongs to its most frequent part."""
    parts = surface.tints[surface.triangles].mean(axis=1).argmax(axis=1)
    out = []
    for tint, name in enumerate(TINTS):
        other, share = SHADES[name]
        shade = ((1 - share) * SHIRT + share * np.array(other)) / 255.0
        linear = np.where(shade < 0.04045, shade / 12.92, ((shade + 0.055) / 1.055) ** 2.4)
        triangles = np.flatnonzero(parts == tint)
        if len(triangles):
            out.append((NAMES[name], tuple(float(f"{value:.4g}") for value in linear), triangles))
    return out
