"""The figure of a motion, in metres, for formats that hold a body mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import SkeletonError
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    matrix_to_quat,
    quat_continuous,
    quat_inverse,
    quat_multiply,
    quat_normalize,
    quat_rotate,
    quat_to_matrix,
)
from motionkit.motion.skeleton import Skeleton
from motionkit.rig.rest_pose import tiny_length
from motionkit.rig.upright import in_metres
from motionkit.view.asset import BODIES
from motionkit.view.body import make_body
from motionkit.view.surface import REGIONS, Surface

SHIRT = np.array([79.0, 134.0, 232.0])  # default body colour, 0 to 255


@dataclass(frozen=True, eq=False)
class Figure:
    """A motion with its body mesh, in metres with Y up. Joints have axes of their own: Y points along the bone.

    Attributes:
        motion: the motion.
        axes: (J, 4) rotations from the joints' axes to those of the world in the skeleton's rest pose.
        rest: (J, 3) local translations of that pose, which stands on the floor, in the axes of the world.
        binds: (J, 4, 4) matrices from the joints' axes to the world in the pose of the mesh, which stands likewise.
        surface: the mesh.
        normals: (V, 3) normals of its points.
    """

    motion: Motion
    axes: Array
    rest: Array
    binds: Array
    surface: Surface
    normals: Array

    @property
    def inverse_binds(self) -> Array:
        """Matrices (J, 4, 4) from the world to each joint's axes in the pose of the mesh; they act on columns."""
        return np.linalg.inv(self.binds)

    def from_parents(self) -> Array:
        """Rotations (J, 4) from the axes of the world to those of the joints' parents, in the rest pose."""
        parents = self.motion.skeleton.parents
        above = np.stack([self.axes[p] if p >= 0 else np.array([1.0, 0.0, 0.0, 0.0]) for p in parents])
        return quat_inverse(above)

    def rest_locals(self) -> tuple[Array, Array]:
        """Rotations (J, 4) and translations (J, 3) of the rest pose, relative to the parents' axes."""
        above = self.from_parents()
        return quat_multiply(above, self.axes), quat_rotate(above, self.rest)

    def locals(self) -> tuple[Array, Array]:
        """Rotations (T, J, 4) and translations (T, J, 3) of the motion, relative to the parents' axes."""
        above = self.from_parents()
        turns = quat_normalize(self.motion.local_rotations.astype(np.float64))
        turned = quat_multiply(quat_multiply(above, turns), self.axes)
        return quat_continuous(turned), quat_rotate(above, self.motion.translations().astype(np.float64))


def make_figure(motion: Motion, body: str = BODIES[0]) -> Figure:
    """The body of a motion of any rig and unit, in metres. Raises SkeletonError if its bones allow none."""
    motion = in_metres(motion).motion
    surface, pose = make_body(motion, body=body)
    rest = motion.skeleton.offsets.astype(np.float64)
    rest[0] = 0.0
    places = motion.skeleton.rest_positions()
    unturned = np.broadcast_to(np.eye(3), (len(rest), 3, 3))
    rest[0, 1] = -surface.posed(pose.matrices_from(unturned, places.astype(np.float64)))[:, 1].min()
    normals = surface.normals
    flat = np.linalg.norm(normals, axis=-1, keepdims=True) < 0.5
    normals = np.where(flat, np.array([0.0, 1.0, 0.0]), normals)
    axes = bone_axes(motion.skeleton)
    binds = np.broadcast_to(np.eye(4), (len(rest), 4, 4)).copy()
    binds[:, :3, :3] = pose.rotations @ quat_to_matrix(axes)
    binds[:, :3, 3] = pose.places
    if not all(np.isfinite(values).all() for values in (surface.points, surface.weights, rest, binds)):
        raise SkeletonError("no body can be made around these bones")
    return Figure(motion, axes, rest, binds, surface, normals)


def bone_axes(skeleton: Skeleton) -> Array:
    """Axes (J, 4) of joints with Y along the bone, as programs draw bones, and Z to the front as far as possible.

    Of several bones below a joint the one counts that best goes on from the bone above, and upwards from the root.
    """
    tiny = tiny_length(skeleton)
    directions = np.tile([0.0, 1.0, 0.0], (len(skeleton), 1))  # of the bones, from the root on
    for joint, parent in enumerate(skeleton.parents):
        came = directions[parent] if parent >= 0 else directions[joint]
        ends = [end for end in _ends_below(skeleton, joint, tiny) if np.linalg.norm(end) > tiny]
        ends = [end / np.linalg.norm(end) for end in ends]
        directions[joint] = max(ends, key=lambda end: float(end @ came)) if ends else came
    level = np.abs(directions[:, 2:]) > 0.9  # feet and other bones that point to the front have Z up
    fronts = np.where(level, [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])
    fronts = fronts - (fronts * directions).sum(-1, keepdims=True) * directions
    fronts /= np.linalg.norm(fronts, axis=-1, keepdims=True)
    return matrix_to_quat(np.stack([np.cross(directions, fronts), directions, fronts], axis=-1))


def _ends_below(skeleton: Skeleton, joint: int, tiny: float) -> list[Array]:
    """Places (3,) relative to a joint where its bones may end; joints at its own place pass theirs on."""
    ends = [np.array(skeleton.end_sites[joint], np.float64)] if joint in skeleton.end_sites else []
    for child in skeleton.children(joint):
        offset = skeleton.offsets[child].astype(np.float64)
        short = float(np.linalg.norm(offset)) <= tiny
        ends += _ends_below(skeleton, child, tiny) if short else [offset]
    return ends


def skin_weights(surface: Surface) -> tuple[Array, Array]:
    """Up to four joints (V, 4) per point, all different, and their weights (V, 4); unused entries are joint 0."""
    weights = np.where(surface.weights < 1e-4, 0.0, surface.weights)
    weights /= weights.sum(axis=1, keepdims=True)
    return np.where(weights > 0.0, surface.joints, 0).astype(np.uint16), weights.astype(np.float32)


def materials(surface: Surface) -> list[tuple[str, tuple[float, ...], Array]]:
    """Name, linear colour and triangles (N,) of each region of the body."""
    regions = surface.regions[surface.triangles[:, 0]]
    shades = surface.shades(SHIRT) / 255.0
    linear = np.where(shades < 0.04045, shades / 12.92, ((shades + 0.055) / 1.055) ** 2.4)
    found = [(region, np.flatnonzero(regions == region)) for region in range(len(REGIONS))]
    return [
        (REGIONS[region], tuple(float(f"{value:.4g}") for value in linear[region]), triangles)
        for region, triangles in found
        if len(triangles)
    ]
