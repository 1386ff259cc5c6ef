"""Root motion: puts a clip in place, moves it to the origin, or adds a root bone on the floor.

Engines move a character by the root bone of its clips, or move it themselves while the clip plays in place.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import SkeletonError
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    quat_continuous,
    quat_from_yaw,
    quat_identity,
    quat_inverse,
    quat_multiply,
    quat_rotate,
)
from motionkit.motion.skeleton import Skeleton
from motionkit.rig.names import map_rig
from motionkit.rig.up_axis import rest_up, up_turn
from motionkit.rig.upright import Upright, relative_rotation

_ROOT_BONES = ("root", "reference", "ground")
_ADDED = (
    "Root",
    "Ground",
)  # names of an added root bone, the first that is free; engines ignore the case of letters
SMOOTHING_SECONDS = 0.25  # s, smoothing of the ground track; the sway of steps stays with the hips


def ground_track(upright: Upright, cyclic: bool = False) -> Array:
    """The ground track (T, 3) of a motion: smoothed x and z of the hips in cm, and their heading in radians.

    Args:
        cyclic: the last frame equals the first, apart from its place; the track then has equal steps at both ends.
    """
    # Canonical joints begin with the hips; a rig that is not human has its own joints.
    body = 0 if upright.canonical is not None else root_bone(upright.motion.skeleton) or 0
    track = np.concatenate(
        [
            upright.positions[:, body, [0, 2]].astype(np.float64),
            upright.heading[:, None].astype(np.float64),
        ],
        axis=1,
    )
    out = track.copy()
    out[:, :2] = _smoothed(track[:, :2], SMOOTHING_SECONDS * upright.motion.fps, cyclic)
    return out


def _smoothed(values: Array, sigma: float, cyclic: bool) -> Array:
    """Gaussian smoothing of values (T, C); they are extended cyclically or by point reflection."""
    frames = len(values)
    radius = min(math.ceil(3 * sigma), frames - 1)
    if radius < 1:
        return values
    if cyclic:
        cycle = values[-1] - values[0]
        before, after = values[-1 - radius : -1] - cycle, values[1 : radius + 1] + cycle
    else:
        before = 2.0 * values[0] - values[radius:0:-1]
        after = 2.0 * values[-1] - values[-2 : -radius - 2 : -1]
    padded = np.concatenate([before, values, after])
    kernel = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    kernel /= kernel.sum()
    return np.stack(
        [np.convolve(padded[:, c], kernel, mode="valid") for c in range(values.shape[1])], axis=-1
    )


def in_place(motion: Motion, cyclic: bool = False) -> Motion:
    """The motion without its ground track; the hips keep their height, sway and turns."""
    body = root_bone(motion.skeleton)
    if body is not None:  # which stays below the body
        motion = _on_root_bone(motion, cyclic)
    upright = Upright.of(motion)
    track = ground_track(upright, cyclic)[:, :2] if body is None else upright.motion.root_positions[:, [0, 2]]
    roots = upright.motion.root_positions.copy()
    roots[:, [0, 2]] -= track.astype(roots.dtype)
    return upright.back(replace(upright.motion, root_positions=roots))


def at_origin(motion: Motion, cyclic: bool = False) -> Motion:
    """The motion moved and turned so that its track begins at the origin and its mean heading is +Z.

    A rig that is not human has no heading, so it is only moved.
    """
    upright = Upright.of(motion)
    source = upright.motion
    track = ground_track(upright, cyclic)
    facing = math.atan2(np.sin(track[:, 2]).mean(), np.cos(track[:, 2]).mean())
    turn = quat_from_yaw(np.array(-facing, np.float32))
    start = np.array([track[0, 0], 0.0, track[0, 1]], np.float32)
    rotations = source.local_rotations.copy()
    rotations[:, 0] = quat_continuous(quat_multiply(turn, rotations[:, 0])[:, None])[:, 0]
    roots = quat_rotate(turn, source.root_positions - start).astype(source.root_positions.dtype)
    return upright.back(replace(source, local_rotations=rotations, root_positions=roots))


def root_bone(skeleton: Skeleton) -> int | None:
    """The child of a root bone that carries the body; None if the first joint is no root bone but the hips.

    A root bone stands on the floor and is called root, reference or ground, with any prefix. Hips may be called root
    too, as in Acclaim files: then the legs do not hang below the child.
    """
    name = skeleton.names[0].rpartition(":")[2].rpartition("|")[2].strip("_ ").lower()
    if name not in _ROOT_BONES:
        return None
    sizes = skeleton.branch_sizes()
    child = max(skeleton.children(0), key=sizes.__getitem__, default=None)
    if child is None or 2 * sizes[child] <= len(skeleton):
        return None
    try:
        places = map_rig(skeleton).places
    except SkeletonError:
        return child
    thighs = [places[part] for part in ("LeftUpLeg", "RightUpLeg") if part in places]
    return child if all(skeleton.descends(thigh, child) for thigh in thighs) else None


def _root_frames(upright: Upright, cyclic: bool, rest: Array) -> tuple[Array, Array]:
    """Positions (T, 3) and rotations (T, 4) of a root bone on the ground track of a motion.

    Its axes are those of the rig's rest pose, so that it rests upright on rigs with Z up too; rest (3,) is its place
    there, of which it keeps the height.
    """
    track = ground_track(upright, cyclic)
    up = rest_up(upright.motion.skeleton)
    stands = quat_identity() if up is None else up_turn(up)
    height = float(quat_rotate(stands, rest)[1])
    place = np.stack([track[:, 0], np.full(len(track), height), track[:, 1]], axis=-1).astype(np.float32)
    return place, quat_multiply(quat_from_yaw(track[:, 2]).astype(np.float32), stands)


def _on_root_bone(motion: Motion, cyclic: bool) -> Motion:
    """The motion with the track on its first joint, while all others stay where they are in the world."""
    upright = Upright.of(motion)
    source = upright.motion
    skeleton = source.skeleton
    place, turn = _root_frames(upright, cyclic, skeleton.offsets[0])
    still = np.broadcast_to(skeleton.offsets, (len(source), *skeleton.offsets.shape))
    moved = np.array(still if source.local_positions is None else source.local_positions, np.float32)
    rotations = source.local_rotations.copy()
    old = rotations[:, 0].copy()
    for child in skeleton.children(0):
        at = source.root_positions + quat_rotate(old, moved[:, child])
        rotations[:, child] = relative_rotation(turn, quat_multiply(old, rotations[:, child]))
        moved[:, child] = quat_rotate(quat_inverse(turn), at - place)
    rotations[:, 0], moved[:, 0] = turn, place
    made = replace(
        source, local_rotations=quat_continuous(rotations), root_positions=place, local_positions=moved
    )
    return upright.back(made)


def with_ground_root(motion: Motion, cyclic: bool = False) -> Motion:
    """The motion with a root joint on the floor, which has the track and heading; the hips become its child.

    A root bone that is there takes the track. Else a joint called Root is added, or Ground where a joint is called
    Root, in any case of letters.

    Raises:
        SkeletonError: the rig has joints of both names, none of which is a root bone.
    """
    body = root_bone(motion.skeleton)
    if body is not None:
        return _on_root_bone(motion, cyclic)
    taken = {joint.lower() for joint in motion.skeleton.names}
    name = next((name for name in _ADDED if name.lower() not in taken), None)
    if name is None:
        raise SkeletonError(
            f"the rig has joints called {' and '.join(_ADDED)} already; --root ground adds one"
        )
    upright = Upright.of(motion)
    source = upright.motion
    place, turn = _root_frames(upright, cyclic, np.zeros(3, np.float32))
    skeleton = source.skeleton
    hips = quat_rotate(quat_inverse(turn), source.root_positions - place)
    usual = np.median(hips, axis=0).astype(np.float32)
    offsets = np.concatenate([np.zeros((1, 3), np.float32), usual[None], skeleton.offsets[1:]])
    still = np.broadcast_to(skeleton.offsets, (len(source), *skeleton.offsets.shape))
    moved = still if source.local_positions is None else source.local_positions
    rotations = source.local_rotations
    out = Motion(
        Skeleton(
            (name, *skeleton.names),
            (-1, *(parent + 1 for parent in skeleton.parents)),
            offsets,
            {joint + 1: end for joint, end in skeleton.end_sites.items()},
            skeleton.cm,
            skeleton.up,
            {name: joint + 1 for name, joint in skeleton.humanoid.items()},
        ),
        quat_continuous(
            np.concatenate(
                [turn[:, None], relative_rotation(turn, rotations[:, 0])[:, None], rotations[:, 1:]], axis=1
            )
        ),
        place,
        source.fps,
        np.concatenate([place[:, None], hips[:, None], moved[:, 1:]], axis=1).astype(np.float32),
    )
    return upright.back(out)
