"""Finds the type of each type's mirror image, by the sides in the names or by the motion."""

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
# Fewest and most poses of a type that are compared. Fewer would not do: half a stride looks like the mirror image of
# the other half.
LEAST_POSES, MOST_POSES = 12, 400
# Quantile of the distances to the nearest pose (cm per joint) that is the distance between two sets of poses. It is
# high, because most poses of a kick are standing poses.
# A type is the mirror image of another if the distance from its mirrored poses to the other type is below NEARER times
# two distances: from its mirrored poses to its own type, and from its unmirrored poses to the other type.
QUANTILE, NEARER = 0.9, 0.8
_LAYOUT = feature_layout(DEFAULT_LAYOUT)
_POSE = _LAYOUT.blocks["joint_positions"]
ONE_SIDED = 10.0  # cm per joint; the poses of symmetric types differ less from their mirror images


def type_poses(motion: Motion, spans: Sequence[tuple[int, int, str]]) -> dict[str, Array]:
    """Poses (N, D) of each type in a motion with stretches (start, end, type): joints in the heading frame, in cm."""
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
    """For each type, the type of its mirror image: itself, or one of the other side, which the data may lack.

    A side in the name decides, as in kick-l. Otherwise two types are mirror images if the mirrored poses (N, D) of each
    are nearer to the other type than to their own.
    """
    named = {kind: mirrored_type(kind) for kind in types}
    # A word of one side may have two of the other: gauche, droit and droite.
    seen_from = {image: kind for kind, image in named.items() if image != kind}
    out = {kind: image if image in named else seen_from.get(kind, image) for kind, image in named.items()}
    unnamed = [kind for kind in types if out[kind] == kind and len(poses.get(kind, ())) >= LEAST_POSES]
    spread = {kind: _spread(poses[kind]) for kind in unnamed}
    images = {kind: _mirrored(some) for kind, some in spread.items()}
    nearest: dict[str, str] = {}
    for kind, image in images.items():
        distance = _apart(image, spread[kind])
        others = {other: _apart(image, some) for other, some in spread.items() if other != kind}
        if distance < ONE_SIDED or not others:
            continue
        other = min(others, key=lambda name: others[name])
        if others[other] < NEARER * min(distance, _apart(spread[kind], spread[other])):
            nearest[kind] = other
    return out | {kind: other for kind, other in nearest.items() if nearest.get(other) == kind}


def _spread(poses: Array) -> Array:
    """At most MOST_POSES of the poses, evenly spread."""
    return poses[:: -(-len(poses) // MOST_POSES)]


def _mirrored(poses: Array) -> Array:
    indices, signs = _LAYOUT.mirror_map()
    return poses[:, indices[_POSE] - _POSE.start] * signs[_POSE]


def _apart(poses: Array, others: Array) -> float:
    """QUANTILE of the distances from poses (N, D) to the nearest of others (M, D), in cm per joint."""
    nearest = distances_between(poses, others).min(axis=1) / JOINT_COUNT**0.5
    return float(np.quantile(nearest, QUANTILE))
