"""What the writers of motion files take: a motion and what is known of it, and its figure in metres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.motion.motion import Motion
from motionkit.view.body import make_body
from motionkit.view.figure_data import in_metres
from motionkit.view.surface import SHADES, TINTS, Surface, point_normals

SHIRT = np.array([79.0, 134.0, 232.0])  # a figure's own colour, 0 to 255
NAMES = {"body": "Shirt", "leg": "Trousers", "head": "Head", "hand": "Hands", "foot": "Shoes"}
LARGEST = 1e7  # of a length in metres or centimetres in a file


@dataclass(frozen=True, eq=False)
class Clip:
    """A motion to write.

    Attributes:
        motion: of any rig, unit and up axis.
        name: what the file calls it.
        types: motion types and their seconds in sequence; empty if unknown.
        channels: of each joint in the BVH file the motion was read from, to be kept in a BVH file; None for the usual.
        hierarchy: the text of that file's hierarchy section, to be kept likewise; None for one made from the skeleton.
    """

    motion: Motion
    name: str = "motion"
    types: Sequence[tuple[str, float]] = ()
    channels: tuple[tuple[str, ...], ...] | None = None
    hierarchy: str | None = None

    def with_motion(self, motion: Motion) -> Clip:
        """The same with an edited motion; channels and hierarchy are kept if they hold it."""
        kept = self._holds(motion)
        same = kept and np.array_equal(motion.skeleton.offsets, self.motion.skeleton.offsets)
        return replace(
            self,
            motion=motion,
            channels=self.channels if kept else None,
            hierarchy=self.hierarchy if same else None,
        )

    def _holds(self, motion: Motion) -> bool:
        """Whether the channels can hold a motion: three rotations for each joint, and places for those that move."""
        if self.channels is None or motion.skeleton.names != self.motion.skeleton.names:
            return False
        moving = set(motion.moving_joints())
        kinds = [[name[1:] for name in names] for names in self.channels]
        turns = all(names.count("rotation") == 3 for names in kinds)
        return turns and all(names.count("position") == 3 for j, names in enumerate(kinds) if j in moving)


@dataclass(frozen=True, eq=False)
class Figure:
    """A motion with its body mesh, in metres with Y up.

    Attributes:
        motion: the motion.
        rest: (J, 3) local translations of its rest pose, which stands on the floor; its rotations are identity.
        inverse_binds: (J, 4, 4) from the world to each joint's space in the pose of the mesh; they act on columns.
        surface: the mesh.
        normals: (V, 3) of its points.
    """

    motion: Motion
    rest: Array
    inverse_binds: Array
    surface: Surface
    normals: Array


def joint_translations(motion: Motion) -> Array:
    """Local translations (T, J, 3) of all joints; the root's is its place in the world."""
    shape = (len(motion), len(motion.skeleton), 3)
    still = np.broadcast_to(motion.skeleton.offsets, shape)
    places = np.array(still if motion.local_positions is None else motion.local_positions, np.float32)
    places[:, 0] = motion.root_positions
    return places


def make_figure(motion: Motion) -> Figure:
    """The figure of a motion of any rig and unit."""
    motion, _, _ = in_metres(motion)
    surface, pose = make_body(motion)
    rest = motion.skeleton.offsets.astype(np.float64)
    rest[0] = 0.0
    places = motion.skeleton.rest_positions() - motion.skeleton.offsets[0]
    unturned = np.broadcast_to(np.eye(3), (len(rest), 3, 3))
    rest[0, 1] = -surface.posed(pose.matrices_from(unturned, places.astype(np.float64)))[:, 1].min()
    normals = point_normals(surface.points, surface.triangles)
    flat = np.linalg.norm(normals, axis=-1, keepdims=True) < 0.5
    normals = np.where(flat, np.array([0.0, 1.0, 0.0]), normals)
    return Figure(motion, rest, pose.inverse_matrices(), surface, normals)


def skin_weights(surface: Surface) -> tuple[Array, Array]:
    """Joints (V, 4) and weights (V, 4) of each point, each joint once; a joint without weight is joint 0."""
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
    """Name, linear colour and triangles (N,) of each part of a body; a triangle belongs to what it shows most of."""
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


def check_numbers(path: object, motion: Motion) -> None:
    """Raise MotionkitError for numbers that no file should hold, before a file is begun."""
    places = [motion.root_positions, motion.skeleton.offsets]
    places += [] if motion.local_positions is None else [motion.local_positions]
    if len(motion) < 1:
        raise MotionkitError(f"{path}: not written: the motion has no frames")
    if not all(bool((np.abs(values) <= LARGEST).all()) for values in places):
        raise MotionkitError(f"{path}: not written: a position is not a number up to {LARGEST:,.0f}")
    lengths = np.linalg.norm(motion.local_rotations.astype(np.float64), axis=-1)
    if not bool((np.abs(lengths - 1.0) < 1e-2).all()):
        raise MotionkitError(f"{path}: not written: a rotation is not a unit quaternion")
    if not 0.0 < motion.fps < float("inf"):
        raise MotionkitError(f"{path}: not written: {motion.fps} frames per second")
