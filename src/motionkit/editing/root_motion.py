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
    quat_inverse,
    quat_multiply,
    quat_rotate,
)
from motionkit.motion.skeleton import Skeleton
from motionkit.rig.upright import Upright, relative_rotation

_ROOT_NAMES = ("root", "reference")
ROOT = "Root"  # name of the bone on the floor
SMOOTHING_SECONDS = 0.25  # s, smoothing of the ground track; the sway of steps stays with the hips


def ground_track(upright: Upright, cyclic: bool = False) -> Array:
    """The ground track (T, 3) of a motion: smoothed x and z of the hips in cm, and their heading in radians.

    Args:
        cyclic: the last frame equals the first, apart from its place; the track then has equal steps at both ends.
    """
    track = np.concatenate(
        [
            upright.positions[:, root_bone(upright.motion.skeleton) or 0, [0, 2]].astype(np.float64),
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
        motion = _on_root_bone(motion, body, cyclic)
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

    A root bone stands on the floor and is called root or reference, with any prefix.
    """
    name = skeleton.names[0].rpartition(":")[2].rpartition("|")[2].strip("_ ").lower()
    if name not in _ROOT_NAMES:
        return None
    sizes = {
        child: sum(skeleton.descends(joint, child) for joint in range(len(skeleton)))
        for child in skeleton.children(0)
    }
    child = max(sizes, key=sizes.__getitem__, default=None)
    return child if child is not None and 2 * sizes[child] > len(skeleton) else None


def _on_root_bone(motion: Motion, body: int, cyclic: bool) -> Motion:
    """The motion with the track on its first joint, whose child `body` stays where it is in the world."""
    upright = Upright.of(motion)
    source = upright.motion
    track, skeleton = ground_track(upright, cyclic), source.skeleton
    height = np.full(len(source), skeleton.offsets[0, 1])
    place = np.stack([track[:, 0], height, track[:, 1]], axis=-1).astype(np.float32)
    turn = quat_from_yaw(track[:, 2]).astype(np.float32)
    still = np.broadcast_to(skeleton.offsets, (len(source), *skeleton.offsets.shape))
    moved = np.array(still if source.local_positions is None else source.local_positions, np.float32)
    rotations = source.local_rotations.copy()
    old = rotations[:, 0]
    at = source.root_positions + quat_rotate(old, moved[:, body])
    rotations[:, body] = relative_rotation(turn, quat_multiply(old, rotations[:, body]))
    moved[:, body] = quat_rotate(quat_inverse(turn), at - place)
    rotations[:, 0], moved[:, 0] = turn, place
    made = replace(
        source, local_rotations=quat_continuous(rotations), root_positions=place, local_positions=moved
    )
    return upright.back(made)


def with_ground_root(motion: Motion, cyclic: bool = False) -> Motion:
    """The motion with a root joint on the floor, which has the track and heading; the hips become its child.

    A root bone that is there takes the track, else a joint called Root is added.

    Raises:
        SkeletonError: the rig has a joint called Root that is no root bone.
    """
    body = root_bone(motion.skeleton)
    if body is not None:
        return _on_root_bone(motion, body, cyclic)
    if ROOT in motion.skeleton.names:
        raise SkeletonError(f"the rig has a joint called {ROOT} already; --root ground adds one")
    upright = Upright.of(motion)
    source = upright.motion
    track = ground_track(upright, cyclic)
    place = np.stack([track[:, 0], np.zeros(len(source)), track[:, 1]], axis=-1).astype(np.float32)
    turn = quat_from_yaw(track[:, 2]).astype(np.float32)
    skeleton = source.skeleton
    hips = quat_rotate(quat_inverse(turn), source.root_positions - place)
    usual = np.median(hips, axis=0).astype(np.float32)
    offsets = np.concatenate([np.zeros((1, 3), np.float32), usual[None], skeleton.offsets[1:]])
    still = np.broadcast_to(skeleton.offsets, (len(source), *skeleton.offsets.shape))
    moved = still if source.local_positions is None else source.local_positions
    rotations = source.local_rotations
    out = Motion(
        Skeleton(
            (ROOT, *skeleton.names),
            (-1, *(parent + 1 for parent in skeleton.parents)),
            offsets,
            {joint + 1: end for joint, end in skeleton.end_sites.items()},
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
