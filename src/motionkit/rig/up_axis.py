"""Detects the axis of a motion's world that points up, because BVH files do not say it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motionkit.arrays import Array, normalized
from motionkit.errors import SkeletonError
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_between, quat_multiply, quat_rotate
from motionkit.motion.skeleton import Skeleton, canonical_skeleton
from motionkit.reading import user_up
from motionkit.rig.names import map_rig, name_part
from motionkit.rig.rest_pose import SourceRig, body_frame, is_standing

# Weights of Y and of the up axis of a standing rest pose, added to the mean cosine of recorded bodies with each axis.
# Recorded bodies may lie on the floor or be upside down for a whole clip.
Y_VOTES, REST_VOTES = 0.3, 0.4
MOTIONKIT_VOTES = 2.0  # weight of the rest pose's up axis in motionkit's own files
_STANDING = 0.8  # cosine between an axis and the line from feet to head, above which a rest pose stands
_LIES_WITHIN = (0.05, 0.25)  # distances below and above height zero, as shares of the body's size
_AXES = np.eye(3, dtype=np.float32)


def voted_up(
    positions: Array,
    directions: Array,
    rest: Array | None,
    rest_votes: float = REST_VOTES,
    stated: str | None = None,
) -> Array:
    """The axis (3,) that points up, with its sign.

    A body that lies on the ground for a whole clip, as in push-ups, does not point up, and one that kneels bends
    forward. So between Y and the axis along the body, the one along which the lowest joint is at about height zero
    wins, if that is one of them only. A body that is upright as its rest pose is does not lie.

    Args:
        positions: (T, J, 3) of the recorded joints.
        directions: (T, 3) from lower to higher parts of the recorded bodies, of any length.
        rest: (3,) the same in a standing rest pose; None without one.
        rest_votes: weight of the rest pose.
        stated: the up axis that the file's format says (Skeleton.up). It counts unless rest pose and recorded bodies
            stand along another one: then a program wrote the file without turning it.
    """
    mean = normalized(directions).mean(axis=0)
    if stated is not None and not _stands_otherwise(stated, mean, rest):
        return named_up(stated)
    votes = np.abs(mean)
    votes[1] += Y_VOTES
    sign = np.where(mean < 0, -1.0, 1.0)
    if rest is not None:
        axis = int(np.abs(rest).argmax())
        votes[axis] += rest_votes
        # A body that is upside down for a whole clip, or in its rest pose, is more usual than a world with -Y up.
        against = axis == 1 and rest[axis] * mean[axis] < 0.0
        sign[axis] = 1.0 if rest[axis] > 0 or against else -1.0
    best, along = int(votes.argmax()), int(np.abs(mean).argmax())
    other = along if best == 1 else 1
    up, instead = (_AXES[axis] * sign[axis].astype(np.float32) for axis in (best, other))
    upright = rest is not None and along == int(np.abs(rest).argmax())
    if best == other or upright or _on_ground(positions, up) or not _on_ground(positions, instead):
        return up
    return instead


def _stands_otherwise(stated: str, mean: Array, rest: Array | None) -> bool:
    """Whether the rest pose and the recorded bodies on average stand along another axis than the stated one."""
    if rest is None:
        return False
    along = [int(np.abs(direction).argmax()) for direction in (mean, rest)]
    return along[0] == along[1] != "XYZ".index(stated[-1]) and abs(float(mean[along[0]])) > _STANDING


def human_up(source: SourceRig, positions: Array) -> Array:
    """The axis (3,) that points up in recorded positions (T, J, 3) of a human rig, with its sign.

    The recorded bodies, a preference for Y, and the rest pose decide; user_up overrides.
    """
    user = user_up()
    if user is not None:
        return named_up(user)
    arms, hips = (positions[:, source.rig.pair(part)].sum(axis=1) / 2 for part in ("Arm", "UpLeg"))
    rest = _standing_up(source)
    # The rest pose of motionkit's own files is upright, even if the recorded poses are few and show no standing body.
    canonical = source.skeleton.same_hierarchy(canonical_skeleton())
    return voted_up(
        positions, arms - hips, rest, MOTIONKIT_VOTES if canonical else REST_VOTES, source.skeleton.up
    )


def _standing_up(source: SourceRig) -> Array | None:
    """The direction (3,) of the body in the rest pose of a human rig; None if it does not stand."""
    frame = body_frame(source)
    return quat_rotate(frame, _AXES[1]) if is_standing(source, frame) else None


def rest_up(skeleton: Skeleton) -> Array | None:
    """The axis (3,) that points up in the standing rest pose of a human rig, with its sign; None for other rigs."""
    try:
        found = _standing_up(SourceRig(skeleton, map_rig(skeleton), skeleton.rest_positions()))
    except SkeletonError:
        return None
    return None if found is None else named_up(up_name(found))


def up_axis(positions: Array, skeleton: Skeleton) -> Array:
    """The axis (3,) that points up in the global positions (T, J, 3) of any rig, with its sign.

    human_up finds it for human rigs, the line between feet and head for others that have both. Without, it is Y or Z,
    the axis along which the body is larger, and Y if in doubt. A long body such as a snake or an arm on a table lies on
    the ground of Y if its lowest joint is at about height zero along Y.
    """
    user = user_up()
    if user is not None:
        return named_up(user)
    try:
        return human_up(SourceRig(skeleton, map_rig(skeleton), skeleton.rest_positions()), positions)
    except SkeletonError:
        parts = [name_part(name)[1] for name in skeleton.names]
    high = [joint for joint, part in enumerate(parts) if part in ("head", "neck")]
    low = [joint for joint, part in enumerate(parts) if part in ("foot", "toe")]
    if high and low:
        rest = _between(skeleton.rest_positions()[None], high, low)[0]
        standing = float(np.abs(rest).max()) > _STANDING * float(np.linalg.norm(rest))
        stood = rest if standing else None
        return voted_up(positions, _between(positions, high, low), stood, stated=skeleton.up)
    if skeleton.up is not None:
        return named_up(skeleton.up)
    spread = (positions.max(axis=1) - positions.min(axis=1)).mean(axis=0)
    if spread[2] <= 1.5 * spread[1]:
        return _AXES[1]
    return _AXES[1 if _on_ground(positions, _AXES[1]) else 2]


def _on_ground(positions: Array, up: Array) -> bool:
    """Whether the lowest joint of a clip (T, J, 3) is at about height zero along an axis."""
    size = float((positions.max(axis=1) - positions.min(axis=1)).mean(axis=0).max())
    return -_LIES_WITHIN[0] * size <= float((positions @ up).min()) <= _LIES_WITHIN[1] * size


def up_name(up: Array) -> str:
    """An up axis (3,) in words, such as "+Z"."""
    axis = int(np.abs(up).argmax())
    return f"{'-' if up[axis] < 0 else '+'}{'XYZ'[axis]}"


def named_up(name: str) -> Array:
    """The up axis (3,) of a name such as "+Z", "z" or "-Y"."""
    sign = np.float32(-1.0 if name.startswith("-") else 1.0)
    return _AXES["XYZ".index(name[-1].upper())] * sign


def up_turn(up: Array) -> Array:
    """The rotation (4,) that turns an up axis (3,) to +Y."""
    return quat_between(up, _AXES[1])


def turned_world(motion: Motion, turn: Array) -> Motion:
    """Turn the world of a motion by a rotation (4,) that takes an axis to an axis."""
    rotations = motion.local_rotations.copy()
    turns = np.broadcast_to(turn.astype(rotations.dtype), rotations[:, 0].shape)
    rotations[:, 0] = quat_multiply(turns, rotations[:, 0])
    roots = quat_rotate(turns, motion.root_positions)
    skeleton = motion.skeleton
    if skeleton.up is not None:
        skeleton = replace(skeleton, up=up_name(quat_rotate(turn, named_up(skeleton.up))))
    return replace(motion, skeleton=skeleton, local_rotations=rotations, root_positions=roots)


def _between(positions: Array, high: list[int], low: list[int]) -> Array:
    """Vectors (T, 3) from the mean of the low joints to the mean of the high joints."""
    return np.asarray(positions[:, high].mean(axis=1) - positions[:, low].mean(axis=1))
