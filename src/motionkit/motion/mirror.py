"""Mirrors a motion on its own skeleton, by a plan of opposite joints and reflections (rig/mirror.py).

The world is reflected in a vertical plane through the origin. The frame of each joint becomes the mirror image of its
opposite's frame. That image is left-handed, so it is reflected again, by signs of the joint. With the reflection M of
the world and R(j) = diag(+-1, +-1, +-1) of determinant -1, the mirrored global rotation of joint j with opposite o is
M G(o) R(j), and its local rotation is R(parent) L(o) R(j). If the signs map the bones of one side to those of the
other, and both sides have equal lengths, all positions are mirrored exactly.

Rest poses without symmetry, as cameras record them, have no such signs. There R(j) is M Q(j), with a rotation Q(j)
that maps the bones of a joint to the reflected bones of its opposite.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import Array
from motionkit.errors import SkeletonError
from motionkit.motion.bvh import BvhFile, bvh_to_motion, motion_to_bvh
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_inverse, quat_multiply, quat_rotate
from motionkit.motion.skeleton import Skeleton

# Possible reflections of a joint's frame: of one axis, or of all three. The last is for rigs on which equal angles make
# mirrored poses.
Signs = tuple[float, float, float]
REFLECTIONS: tuple[Signs, ...] = ((-1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, -1.0), (-1.0, -1.0, -1.0))


@dataclass(frozen=True)
class MirrorPlan:
    """How to mirror a rig: the opposite and the reflection of each joint, and the reflection of the world.

    turns (J, 4) are rotations after the reflections, of rigs without symmetry, whose reflections are all the world's.
    """

    opposites: tuple[int, ...]
    world: Signs
    joints: tuple[Signs, ...]
    turns: Array | None = None

    def outer(self, skeleton: Skeleton, joint: int) -> Signs:
        """The reflection on the parent's side of a joint."""
        return self.joints[skeleton.parents[joint]] if joint else self.world


def mirrored(motion: Motion, plan: MirrorPlan) -> Motion:
    """Swap left and right of a motion on the same skeleton, and reflect the world, by a plan."""
    skeleton, opposites = motion.skeleton, plan.opposites
    rotations = [
        reflect_rotations(
            motion.local_rotations[:, opposite], plan.outer(skeleton, joint), plan.joints[joint]
        )
        for joint, opposite in enumerate(opposites)
    ]
    turns = plan.turns
    outer = None if turns is None else quat_inverse(turns[[max(parent, 0) for parent in skeleton.parents]])
    if turns is not None and outer is not None:
        outer[0] = (1.0, 0.0, 0.0, 0.0)  # the world's
        rotations = [
            quat_multiply(quat_multiply(np.broadcast_to(first, turned.shape), turned), last)
            for first, turned, last in zip(outer, rotations, turns, strict=True)
        ]
    world = np.array(plan.world, motion.root_positions.dtype)
    places = motion.local_positions
    if places is not None:
        signs = np.array([plan.outer(skeleton, j) for j in range(len(opposites))], places.dtype)
        places = places[:, list(opposites)] * signs
        places = places if outer is None else quat_rotate(outer, places).astype(places.dtype)
        # A joint that stays at its offset has no channels for another place.
        moving = set(motion.moving_joints())
        still = [j for j, opposite in enumerate(opposites) if not {j, opposite} & moving]
        places[:, still] = skeleton.offsets[still]
    return replace(
        motion,
        local_rotations=np.stack(rotations, axis=1),
        root_positions=motion.root_positions * world,
        local_positions=places,
    )


def mirrored_bvh(bvh: BvhFile, plan: MirrorPlan) -> BvhFile:
    """Swap left and right of a BVH file, with the same hierarchy and channels.

    If both sides have their channels in one order, angles only change signs or shift by half turns. So mirroring twice
    restores the file.

    A joint without the position channels of its opposite gets them.

    Raises:
        SkeletonError: opposite joints have different rotation channels.
    """
    bvh = _with_places(bvh, plan.opposites)
    columns = bvh.columns()
    values = np.empty_like(bvh.values)
    rebuilt: BvhFile | None = None
    for joint, opposite in enumerate(plan.opposites):
        names, opposite_names = bvh.channels[joint], bvh.channels[opposite]
        _check_channels(bvh, joint, opposite)
        outer = plan.outer(bvh.skeleton, joint)
        source = dict(zip(opposite_names, columns[opposite], strict=True))
        for name, column in zip(names, columns[joint], strict=True):
            if name.endswith("position"):
                values[:, column] = outer["XYZ".index(name[0])] * bvh.values[:, source[name]]
        mine = [c for n, c in zip(names, columns[joint], strict=True) if n.endswith("rotation")]
        theirs = [c for n, c in zip(opposite_names, columns[opposite], strict=True) if n.endswith("rotation")]
        order = _rotation_order(names)
        if plan.turns is None and order == _rotation_order(opposite_names):
            turned = _reflect_angles(bvh.values[:, theirs], order, outer, plan.joints[joint])
            if turned is None:
                raise SkeletonError(
                    f"{bvh.skeleton.names[joint]} has only the rotation channels {order or 'none'}; "
                    "its mirror image needs all three"
                )
            values[:, mine] = turned
        else:
            rebuilt = rebuilt or motion_to_bvh(mirrored(bvh_to_motion(bvh), plan), bvh.channels)
            whole = columns[joint] if plan.turns is not None else mine
            values[:, whole] = rebuilt.values[:, whole]
    return replace(bvh, values=values)


def _with_places(bvh: BvhFile, opposites: tuple[int, ...]) -> BvhFile:
    """The file, in which each joint has the position channels of its opposite, too; they hold its OFFSET."""
    channels, values = [], []
    for joint, opposite in enumerate(opposites):
        own = bvh.channels[joint]
        more = tuple(n for n in bvh.channels[opposite] if n.endswith("position") and n not in own)
        channels.append(more + own)
        offset = bvh.skeleton.offsets[joint]
        values += [np.full(len(bvh.values), offset["XYZ".index(name[0])], np.float64) for name in more]
        values += [bvh.values[:, column] for column in bvh.columns()[joint]]
    if tuple(channels) == bvh.channels:
        return bvh
    return replace(bvh, channels=tuple(channels), values=np.stack(values, axis=1), hierarchy=None)


def _rotation_order(channels: tuple[str, ...]) -> str:
    return "".join(name[0] for name in channels if name.endswith("rotation"))


def _check_channels(bvh: BvhFile, joint: int, opposite: int) -> None:
    channels, other = bvh.channels[joint], bvh.channels[opposite]
    whole = len(_rotation_order(channels)) == 3 or _rotation_order(channels) == _rotation_order(other)
    if set(channels) != set(other) or not whole:
        names = bvh.skeleton.names
        raise SkeletonError(
            f"{names[joint]} has the channels {' '.join(channels) or 'none'} but {names[opposite]} "
            f"{' '.join(other) or 'none'}; mirroring needs the same on both sides"
        )


def reflect_rotations(quat: Array, outer: Signs, inner: Signs) -> Array:
    """The rotations (..., 4) diag(outer) q diag(inner) for unit quaternions q (..., 4)."""
    conjugated = quat * np.array([1.0, *(-sign for sign in outer)], quat.dtype)
    half_turn = _half_turn_axis(outer, inner)
    if half_turn is None:
        return conjugated
    turn = np.zeros(4, quat.dtype)
    turn[1 + half_turn] = 1.0
    return quat_multiply(conjugated, np.broadcast_to(turn, conjugated.shape))


def _half_turn_axis(outer: Signs, inner: Signs) -> int | None:
    """The axis of the half turn diag(outer) diag(inner), or None if both are equal."""
    return None if outer == inner else [a * b for a, b in zip(outer, inner, strict=True)].index(1.0)


def _reflect_angles(
    angles: NDArray[np.float64], order: str, outer: Signs, inner: Signs
) -> NDArray[np.float64] | None:
    """Euler angles (T, len(order)) in degrees of diag(outer) q diag(inner); None if order has too few axes.

    A reflection multiplies an angle about axis k by -outer[k]. A half turn after the rotation commutes past the angles
    that follow its axis and negates them. A half turn about the middle axis becomes half turns about the other two, so
    that the middle angle stays within a quarter turn.
    """
    signs = np.array([-outer["XYZ".index(axis)] for axis in order])
    half_turn = _half_turn_axis(outer, inner)
    if half_turn is None:
        return angles * signs
    if len(order) != 3:
        return None
    at = order.index("XYZ"[half_turn])
    signs = signs * np.array([(1.0, -1.0, -1.0), (1.0, -1.0, -1.0), (1.0, 1.0, 1.0)][at])
    turned = angles * signs
    for column in ((0,), (0, 2), (2,))[at]:
        turned[:, column] += _half_turn_shift(angles[:, column], signs[column])
    return turned


def _half_turn_shift(angles: NDArray[np.float64], sign: float) -> float:
    """A shift of 180 degrees up or down for a whole column, such that a second shift undoes the first.

    The mean angle selects a half circle. Unreflected angles move up from even halves and down from odd ones. Reflected
    angles are reflected about the middle of their half.
    """
    mean = float(angles.mean())
    if sign > 0:
        return 180.0 if np.floor(mean / 180.0 + 0.5) % 2 == 0 else -180.0
    return 180.0 * (2.0 * np.floor(mean / 180.0) + 1.0)
