"""Bone maps: JSON files that a user can edit, from joint names of a rig to canonical joints.

{"joints": {"Bip01_Pelvis": "Hips", "Bip01_L_Thigh": "LeftUpLeg", "Bip01_Ponytail": null}}
"""

from __future__ import annotations

import difflib
import json
from collections import Counter
from pathlib import Path
from typing import Any

from motionkit.errors import MotionkitError, naming
from motionkit.files import atomic_write, read_text
from motionkit.motion.skeleton import JOINT_NAMES, Skeleton
from motionkit.rig.names import RigMap, user_map

_MOST_BYTES = 2**20


def write_rig_map(path: str | Path, skeleton: Skeleton, joints: RigMap) -> None:
    """Write a bone map with every joint of the rig in its order; joints without a canonical joint get null."""
    names = {joint: name for name, joint in joints.places.items()}
    value = {"joints": {name: names.get(joint) for joint, name in enumerate(skeleton.names)}}
    with atomic_write(path) as file:
        file.write(json.dumps(value, indent=2, ensure_ascii=False) + "\n")


def read_rig_map(path: str | Path, skeleton: Skeleton) -> RigMap:
    """Read a bone map for a skeleton; joints that it does not name have no canonical joint.

    Raises:
        MotionkitError: the file is not a bone map, names a joint twice, or names one that the skeleton lacks.
        SkeletonError: the map does not describe a body: a limb is missing, or a shin is not below its thigh.
    """
    for joint, _ in _pairs(path):
        if joint not in skeleton.names:
            raise MotionkitError(f"{path}: the rig has no joint {joint[:40]!r}{_near(joint, skeleton.names)}")
    joints = read_joints(path)
    with naming(path):
        return user_map(
            skeleton, {name: skeleton.index(joints[name]) for name in JOINT_NAMES if name in joints}
        )


def read_joints(path: str | Path) -> dict[str, str]:
    """The names of the canonical joints in a bone map; raises MotionkitError as read_rig_map."""
    joints: dict[str, str] = {}
    for joint, canonical in _pairs(path):
        if canonical is None:
            continue
        if canonical not in JOINT_NAMES:
            raise MotionkitError(
                f"{path}: {joint} is mapped to {str(canonical)[:40]!r}, expected a canonical joint or null"
                + _near(str(canonical), JOINT_NAMES)
            )
        if canonical in joints:
            raise MotionkitError(
                f"{path}: {canonical} is given to two joints, {joints[canonical]} and {joint}"
            )
        joints[canonical] = joint
    return joints


def _pairs(path: str | Path) -> list[tuple[str, Any]]:
    """Joint names, with spaces as read_bvh replaces them, and their targets, in the order of the file."""

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            ((name, _),) = Counter(name for name, _ in pairs).most_common(1)
            raise MotionkitError(f"{path}: {name[:40]!r} is named twice")
        return found

    text = read_text(path, "a bone map in JSON", limit=_MOST_BYTES)
    try:
        value = json.loads(text, object_pairs_hook=once)
    except (ValueError, RecursionError) as error:
        raise MotionkitError(f"{path}: not JSON ({error})") from None
    joints = value.get("joints") if isinstance(value, dict) else None
    if not isinstance(joints, dict):
        raise MotionkitError(f'{path}: expected {{"joints": {{"joint of the rig": "canonical joint"}}}}')
    return [("_".join(joint.split()), canonical) for joint, canonical in joints.items()]


def _near(word: str, words: tuple[str, ...]) -> str:
    near = difflib.get_close_matches(word, words, 1)
    return f"; did you mean {near[0]}?" if near else ""
