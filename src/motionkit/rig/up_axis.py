"""Detects the axis of a motion's world that points up, because BVH files do not say it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from motionkit.arrays import Array, normalized
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_between, quat_multiply, quat_rotate
from motionkit.motion.skeleton import Skeleton

# Weights of Y and of the up axis of a standing rest pose, added to the mean cosine of recorded bodies with each axis.
# Recorded bodies may lie on the floor or be upside down for a whole clip.
Y_VOTES, REST_VOTES = 0.3, 0.4
_STANDS = 0.8  # cosine between an axis and the line from feet to head, above which a rest pose stands
_LIES_WITHIN = (0.05, 0.25)  # distances below and above height zero, as shares of the body's size
_AXES = np.eye(3, dtype=np.float32)


def voted_up(
    positions: Array, directions: Array, rest: Array | None, rest_votes: float = REST_VOTES
) -> Array:
    """The axis (3,) that points up, with its sign.

    A body that lies on the ground for a whole clip, as in push-ups, does not point up. So Y still wins if the lowest
    joint is at about height zero along Y, and not along the other axis.

    Args:
        positions: (T, J, 3) of the recorded joints.
        directions: (T, 3) from lower to higher parts of the recorded bodies, of any length.
        rest: (3,) the same in a standing rest pose; None without one.
        rest_votes: weight of the rest pose.
    """
    mean = normalized(directions).mean(axis=0)
    votes = np.abs(mean)
    votes[1] += Y_VOTES
    sign = np.where(mean < 0, -1.0, 1.0)
    if rest is not None:
        axis = int(np.abs(rest).argmax())
        votes[axis] += rest_votes
        sign[axis] = 1.0 if rest[axis] > 0 else -1.0
    best = int(votes.argmax())
    up = _AXES[best] * sign[best].astype(np.float32)
    return _AXES[1] if best != 1 and _on_ground(positions, _AXES[1]) and not _on_ground(positions, up) else up


def up_axis(positions: Array, skeleton: Skeleton) -> Array:
    """The axis (3,) from the feet to the head in global positions (T, J, 3), with its sign.

    Without such joint names, it is Y or Z, the axis along which the body is larger, and Y if in doubt. A long body such
    as a snake or an arm on a table lies on the ground of Y if its lowest joint is at about height zero along Y.
    """
    high = _named(skeleton.names, r"head|neck")
    low = _named(skeleton.names, r"foot|toe|ankle")
    if high and low:
        rest = _between(skeleton.rest_positions()[None], high, low)[0]
        stands = float(np.abs(rest).max()) > _STANDS * float(np.linalg.norm(rest))
        return voted_up(positions, _between(positions, high, low), rest if stands else None)
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


def up_turn(up: Array) -> Array:
    """The rotation (4,) that turns an up axis (3,) to +Y."""
    return quat_between(up, _AXES[1])


def turned_world(motion: Motion, turn: Array) -> Motion:
    """Turn the world of a motion by a rotation (4,)."""
    rotations = motion.local_rotations.copy()
    turns = np.broadcast_to(turn.astype(rotations.dtype), rotations[:, 0].shape)
    rotations[:, 0] = quat_multiply(turns, rotations[:, 0])
    roots = quat_rotate(turns, motion.root_positions)
    return replace(motion, local_rotations=rotations, root_positions=roots)


def _named(names: Sequence[str], pattern: str) -> list[int]:
    return [i for i, name in enumerate(names) if re.search(pattern, name, re.IGNORECASE)]


def _between(positions: Array, high: list[int], low: list[int]) -> Array:
    """Vectors (T, 3) from the mean of the low joints to the mean of the high joints."""
    return np.asarray(positions[:, high].mean(axis=1) - positions[:, low].mean(axis=1))
