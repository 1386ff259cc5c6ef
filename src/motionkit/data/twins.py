"""Types whose mirror images are other types: by the sides in their names, else by how they move."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from motionkit.arrays import Array, distances_between
from motionkit.data.labels import mirrored_type
from motionkit.features.encode import encode_motion
from motionkit.features.layout import DEFAULT_LAYOUT, feature_layout
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import JOINT_COUNT

EVERY = 8  # frames between the poses that are compared
LEAST_POSES, MOST_POSES = 12, 400  # of a type; half a stride looks like the mirror image of the other half
# The mirror image of a type is another one if its poses are nearer to that one's than both are to its own: this
# quantile of the distances to the nearest pose, in cm per joint, since most poses of a kick are those of standing.
QUANTILE, NEARER = 0.9, 0.8
_LAYOUT = feature_layout(DEFAULT_LAYOUT)
_POSE = _LAYOUT.blocks["joint_positions"]
ONE_SIDED = (
    10.0  # cm per joint between the poses of a type and their mirror images; symmetric types have less
)


def type_poses(motion: Motion, spans: Sequence[tuple[int, int, str]]) -> dict[str, Array]:
    """Poses (N, D) of each type in a motion: joints over the ground below the root, relative to the heading, in cm.

    Args:
        spans: first and last frame (exclusive) and type of its stretches.
    """
    few = replace(
        motion,
        local_rotations=motion.local_rotations[::EVERY],
        root_positions=motion.root_positions[::EVERY],
        fps=motion.fps / EVERY,
    )
    poses = encode_motion(few).features[:, _POSE]
    out: dict[str, list[Array]] = {}
    for start, end, kind in spans:
        out.setdefault(kind, []).append(poses[-(-start // EVERY) : -(-end // EVERY)])
    return {kind: np.concatenate(parts) for kind, parts in out.items()}


def mirrored_types(types: Sequence[str], poses: Mapping[str, Array]) -> dict[str, str]:
    """For each type the type of its mirror image: itself, or the other side's, which may be none of the types.

    A side in the name tells, as in kick-l. Else two types are twins if the mirror image of each is nearer to the other
    than to itself.

    Args:
        poses: (N, D) poses of each type, of type_poses.
    """
    out = {kind: mirrored_type(kind) for kind in types}
    told = [kind for kind in types if out[kind] == kind and len(poses.get(kind, ())) >= LEAST_POSES]
    shown = {kind: _spread(poses[kind]) for kind in told}
    images = {kind: _mirrored(some) for kind, some in shown.items()}
    nearest: dict[str, str] = {}
    for kind, image in images.items():
        own = _apart(image, shown[kind])
        others = {other: _apart(image, some) for other, some in shown.items() if other != kind}
        if own < ONE_SIDED or not others:
            continue
        other = min(others, key=lambda name: others[name])
        if others[other] < NEARER * min(own, _apart(shown[kind], shown[other])):
            nearest[kind] = other
    return out | {kind: other for kind, other in nearest.items() if nearest.get(other) == kind}


def _spread(poses: Array) -> Array:
    """At most MOST_POSES poses, from all over."""
    return poses[:: -(-len(poses) // MOST_POSES)]


def _mirrored(poses: Array) -> Array:
    indices, signs = _LAYOUT.mirror_map()
    return poses[:, indices[_POSE] - _POSE.start] * signs[_POSE]


def _apart(poses: Array, others: Array) -> float:
    """How far poses (N, D) are from the nearest of others (M, D), in cm per joint."""
    nearest = distances_between(poses, others).min(axis=1) / JOINT_COUNT**0.5
    return float(np.quantile(nearest, QUANTILE))
