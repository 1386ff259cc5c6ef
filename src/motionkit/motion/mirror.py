"""The mirror image of a motion, on the same skeleton, for any rig whose joints have a left and a right."""

from __future__ import annotations

import re
from collections.abc import Sequence

# How rigs mark a side, from the plainest to the vaguest. A mark counts only when the name with the
# other side in its place exists too, so that "lowerback" or "rib" are nobody's left or right.
_SIDE_MARKS = tuple(
    re.compile(pattern)
    for pattern in (
        r"(?i:left|right)",  # LeftArm, right_hip, Character1_LeftArm, mixamorig:LeftArm
        r"(?<![A-Za-z])[LRlr](?![A-Za-z])",  # Shoulder_L, thigh.R, Bip01 L Thigh, l_foot
        r"(?<![A-Za-z])[LRlr](?=[A-Z])",  # LHipJoint, rThigh
        r"(?<=[a-z0-9])[LR](?![a-z])",  # ThighL
        r"(?<![A-Za-z])[LRlr](?=[a-z])",  # lhand
        r"(?<=[a-z])[lr](?![A-Za-z])",  # handl
    )
)
_OTHER_SIDE = {"left": "right", "right": "left", "l": "r", "r": "l"}


def _other_side(match: re.Match[str]) -> str:
    """The word or letter for the other side, in the same case."""
    word = match.group()
    other = _OTHER_SIDE[word.lower()]
    if word.isupper():
        return other.upper()
    return other.capitalize() if word[0].isupper() else other


def _paired_marks(names: Sequence[str]) -> dict[int, tuple[int, bool]]:
    """For each joint with a twin: the twin's index, and whether the joint itself is a left one."""
    indices = {name: index for index, name in enumerate(names)}
    paired: dict[int, tuple[int, bool]] = {}
    for mark in _SIDE_MARKS:
        for index, name in enumerate(names):
            match = mark.search(name)
            twin = indices.get(mark.sub(_other_side, name)) if match else None
            if match and twin is not None and twin != index and index not in paired and twin not in paired:
                left = match.group()[0] in "lL"
                paired[index], paired[twin] = (twin, left), (index, not left)
    return paired


def left_right_twins(names: Sequence[str]) -> tuple[int, ...]:
    """For every joint the index of its twin on the other side of the body; central joints give their own."""
    paired = _paired_marks(names)
    return tuple(paired[index][0] if index in paired else index for index in range(len(names)))


def joint_sides(names: Sequence[str]) -> tuple[str, ...]:
    """For every joint "left", "right", or "" where it has no twin."""
    paired = _paired_marks(names)
    return tuple(("left" if paired[i][1] else "right") if i in paired else "" for i in range(len(names)))
