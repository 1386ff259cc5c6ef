"""Brings a motion of any rig into cm with Y up and back, with measurements on its canonical joints."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import SkeletonError
from motionkit.features.heading import heading_angles
from motionkit.motion.contacts import foot_contacts
from motionkit.motion.floor import TOE_HEIGHT, TOES, floor_shift
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    quat_from_yaw,
    quat_identity,
    quat_inverse,
    quat_multiply,
    quat_rotate,
    rotate_ground,
)
from motionkit.motion.skeleton import Skeleton
from motionkit.names import counted
from motionkit.reading import reading
from motionkit.rig.canonical import canonical_motion
from motionkit.rig.names import EXCHANGED, RigMap, map_rig
from motionkit.rig.pose import SAMPLES
from motionkit.rig.units import motion_unit
from motionkit.rig.up_axis import turned_world, up_axis, up_name, up_turn

CM, CM_PER_METRE = 0.01, 100.0  # metres per cm, and cm per metre
# Range over the ground in cm below which a root stands still, and from which the hips below it travel.
STILL_ROOT, MOVING_HIPS = 1.0, 30.0
_STANDING_TOE = (-1.0, 6.0)  # cm; heights of toes in a rest pose that stands on the floor
AS_BROUGHT = partial(
    reading, up="+Y", cm=1.0
)  # in which motions that were brought into cm with Y up are read again
_Y_UP = np.array([0.0, 1.0, 0.0], np.float32)


@dataclass(frozen=True, eq=False)
class InMetres:
    """A motion in metres with Y up.

    Attributes:
        motion: the motion.
        scale: metres per unit of the original motion.
        up: (3,) up axis of the original motion.
        note: how unit and axis were determined.
    """

    motion: Motion
    scale: float
    up: Array
    note: str


def describe_motion(motion: Motion) -> str:
    """How a motion of any rig is read, in words: frames, unit, up axis and joints."""
    positions = motion_kinematics(motion)[1]
    up = up_axis(positions, motion.skeleton)
    stays = "" if up[1] >= 1.0 else ", and stays so in BVH"
    unit = f"unit: {motion_unit(motion)[1]}; {up_name(up)} up{stays}"
    return f"{counted(len(motion), 'frame')} at {motion.fps:g} fps; {unit}; {_joints(motion, positions)}"


def _joints(motion: Motion, positions: Array) -> str:
    """How the canonical joints of a motion are found, and which it lacks, in words."""
    try:
        rig = _map_by_names(motion.skeleton) or map_rig(
            motion.skeleton, positions[:: max(1, len(motion) // SAMPLES)]
        )
    except SkeletonError:
        return f"{counted(len(motion.skeleton), 'joint')}, no known human rig"
    sources = " and ".join(sorted({rig.found(name) for name in rig.places}))
    lacks = f" (no {', '.join(rig.missing())})" if rig.missing() else ""
    exchanged = f"; {EXCHANGED}" if rig.exchanged else ""
    return f"{len(rig.places)} joints found by {sources}{lacks}{exchanged}"


def _map_by_names(skeleton: Skeleton) -> RigMap | None:
    """The map of a rig whose limbs are all named, which its poses would not change; None for other rigs."""
    try:
        rig = map_rig(skeleton)
    except SkeletonError:
        return None
    return None if rig.by_shape else rig


def in_metres(motion: Motion) -> InMetres:
    """Bring a motion of any rig, unit and up axis into metres with Y up."""
    cm, note = motion_unit(motion)
    up = up_axis(motion_kinematics(motion)[1], motion.skeleton)
    scaled = motion.scaled(cm * CM)
    if up[1] < 1.0:
        scaled, note = turned_world(scaled, up_turn(up)), f"{note}; {up_name(up)} up"
    return InMetres(scaled, cm * CM, up, note)


@dataclass(frozen=True, eq=False)
class Upright:
    """A motion in cm with Y up.

    Attributes:
        motion: the motion on its own joints.
        scale: cm per unit of the original motion.
        up: (3,) up axis of the original motion.
        rig: skeleton of the original motion; None if unknown.
        as_human: whether a human is measured on the canonical joints; otherwise as rigs that are not human.
    """

    motion: Motion
    scale: float = 1.0
    up: Array = field(default_factory=lambda: _Y_UP)
    rig: Skeleton | None = None
    as_human: bool = True

    @staticmethod
    def of(motion: Motion) -> Upright:
        """Bring a motion of any rig and unit into cm with Y up, with its movement over the ground in the root."""
        metres = in_metres(motion)
        scaled = _carried_by_root(metres.motion.scaled(CM_PER_METRE))
        return Upright(scaled, metres.scale * CM_PER_METRE, metres.up, motion.skeleton)

    def back(self, motion: Motion) -> Motion:
        """Bring a motion in cm with Y up back to the unit and the up axis of the original motion."""
        out = motion.scaled(1.0 / self.scale)
        if self.rig is not None and motion.skeleton.names == self.rig.names:
            out = replace(out, skeleton=self.rig)  # the original offsets, to the last digit
        return out if self.up[1] >= 1.0 else turned_world(out, quat_inverse(up_turn(self.up)))

    @cached_property
    def canonical(self) -> Motion | None:
        """The motion on the canonical joints with its own bone lengths, in cm; None for rigs that are not human.

        Where the rest pose of the rig stands on the floor, feet as high as there are as high as canonical ones.
        """
        motion = self.motion
        if not self.as_human:
            return None
        try:
            with AS_BROUGHT():
                made = canonical_motion(motion, own_body=True, scale=1.0)
        except SkeletonError:
            return None
        up = 0.0 if made.skeleton.names == motion.skeleton.names else _lift(motion)
        return replace(made, root_positions=made.root_positions + np.array([0.0, up, 0.0], np.float32))

    @cached_property
    def positions(self) -> Array:
        """Positions (T, J, 3) in cm of the canonical joints, or of all joints of a rig that is not human."""
        return motion_kinematics(self.canonical or self.motion)[1]

    @cached_property
    def heading(self) -> Array:
        """Heading (T,) in radians; 0 throughout for rigs that are not human."""
        if self.canonical is None:
            return np.zeros(len(self.motion), np.float32)
        return heading_angles(self.positions, self.motion.fps)

    @cached_property
    def facing_positions(self) -> Array:
        """Positions (T, J, 3) in cm in the heading frame."""
        place = self.positions[:, :1] * np.array([1.0, 0.0, 1.0], np.float32)
        return quat_rotate(quat_from_yaw(-self.heading)[:, None], self.positions - place)

    @cached_property
    def velocities(self) -> Array:
        """Velocities (T, 2) of the root over the ground in cm/s in the heading frame."""
        track = self.positions[:, 0, [0, 2]].astype(np.float64)
        return rotate_ground(-self.heading.astype(np.float64), np.gradient(track, axis=0)) * self.motion.fps

    @cached_property
    def contacts(self) -> Array:
        """Contacts (T, 4) of left foot, left toe, right foot, right toe; (T, 0) for rigs that are not human."""
        if self.canonical is None:
            return np.zeros((len(self.motion), 0), np.float32)
        lift = np.array([0.0, floor_shift(self.canonical)[0], 0.0], np.float32)
        return foot_contacts(self.positions + lift, self.motion.fps)


def _lift(motion: Motion) -> float:
    """How far standing toes of the canonical joints are higher, in cm, than they are in the rest pose of a rig.

    Feet of other rigs slope in other ways, so toes of a canonical foot with their length are elsewhere. 0 if the rest
    pose does not stand on the floor; motion is in cm with Y up.
    """
    skeleton = motion.skeleton
    still = Motion(skeleton, quat_identity((1, len(skeleton))), skeleton.offsets[:1], motion.fps)
    try:
        toes = [map_rig(skeleton).places.get(f"{side}ToeBase") for side in ("Left", "Right")]
        with AS_BROUGHT():
            rest = canonical_motion(still, own_body=True, scale=1.0)
    except SkeletonError:
        return 0.0
    places = skeleton.rest_positions()[[toe for toe in toes if toe is not None], 1] + skeleton.offsets[0, 1]
    if len(places) < 2 or not all(_STANDING_TOE[0] <= height <= _STANDING_TOE[1] for height in places):
        return 0.0
    return TOE_HEIGHT - float(motion_kinematics(rest)[1][0, list(TOES), 1].mean())


def _carried_by_root(motion: Motion) -> Motion:
    """Move the translation of hips below a still root into the root; all joints but those in between stay in place.

    In some rigs the root stays at the origin and the hips travel, beside other joints such as targets of the feet.
    """
    places = motion.local_positions
    if places is None or _range(motion.root_positions) > STILL_ROOT:
        return motion
    skeleton, chain, turns = motion.skeleton, [0], motion.local_rotations[:, 0]
    sizes = skeleton.branch_sizes()
    while below := skeleton.children(chain[-1]):
        joint = max(below, key=sizes.__getitem__)
        moved = places[:, joint] - skeleton.offsets[joint]
        if _range(quat_rotate(turns, moved)) >= MOVING_HIPS:
            break
        chain.append(joint)
        turns = quat_multiply(turns, motion.local_rotations[:, joint])
    else:
        return motion
    places = places.copy()
    places[:, joint] = skeleton.offsets[joint]
    beside = joint
    for above in reversed(chain):
        for other in skeleton.children(above):
            if other != beside:
                places[:, other] -= moved
        moved, beside = quat_rotate(motion.local_rotations[:, above], moved), above
    roots = motion.root_positions + moved
    places[:, 0] = roots
    return replace(motion, root_positions=roots, local_positions=places)


def _range(places: Array) -> float:
    """Range of positions (T, 3) along x or z, the larger of both."""
    return float(np.ptp(places[:, [0, 2]], axis=0).max())


def relative_rotation(above: Array, below: Array) -> Array:
    """Global rotations `below` (..., 4) expressed in the space of rotations `above`."""
    return quat_multiply(quat_inverse(above), below)
