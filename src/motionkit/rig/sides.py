"""Left and right: words for them in names of joints and motion types, and opposite joints by name."""

from __future__ import annotations

import re
from collections.abc import Sequence

# Words for left and right in the languages of rig and folder names; single letters in English only.
WORDS: tuple[tuple[str, str], ...] = (
    ("left", "right"),
    ("l", "r"),
    ("links", "rechts"),
    ("linke", "rechte"),
    ("linker", "rechter"),
    ("linkes", "rechtes"),
    ("linken", "rechten"),
    ("gauche", "droite"),
    ("gauche", "droit"),
    ("izquierda", "derecha"),
    ("izquierdo", "derecho"),
    ("sinistra", "destra"),
    ("sinistro", "destro"),
    ("esquerda", "direita"),
    ("esquerdo", "direito"),
    ("левая", "правая"),
    ("левый", "правый"),
    ("левое", "правое"),
    ("левой", "правой"),
    ("左", "右"),
    ("왼쪽", "오른쪽"),
    ("왼", "오른"),
    ("hidari", "migi"),
)
LEFT_WORDS = frozenset(left for left, _ in WORDS)
# The word for the other side; the first pair counts for a word in two pairs ("gauche").
OTHER = {left: right for left, right in reversed(WORDS)} | {right: left for left, right in WORDS}
LONG_WORDS = tuple(
    sorted((word for word in OTHER if len(word) > 3 or not word.isascii()), key=len, reverse=True)
)


def other_side(word: str) -> str:
    """The word for the other side, in the same case; a word without a side stays as it is."""
    other = OTHER.get(word.lower())
    if other is None:
        return word
    if word.isupper():
        return other.upper()
    return other.capitalize() if word[:1].isupper() else other


# Marks of a side in joint names, from the clearest to the vaguest. A mark counts only if the name with the other side
# exists too, so that names such as "lowerback" or "rib" have no side.
_SIDE_MARKS = tuple(
    re.compile(pattern)
    for pattern in (
        f"(?i:{'|'.join(LONG_WORDS)})",  # LeftArm, right_hip, Character1_LeftArm, mixamorig:LeftArm, Arm_links, 左腕
        r"(?<![A-Za-z])[LRlr](?![A-Za-z])",  # Shoulder_L, thigh.R, Bip01 L Thigh, l_foot
        r"(?<![A-Za-z])[LRlr](?=[A-Z])",  # LHipJoint, rThigh
        r"(?<=[a-z0-9])[LR](?![a-z])",  # ThighL
        r"(?<![A-Za-z])[LRlr](?=[a-z])",  # lhand
        r"(?<=[a-z])[lr](?![A-Za-z])",  # handl
    )
)


def _paired_marks(names: Sequence[str]) -> dict[int, tuple[int, bool]]:
    """For each joint with an opposite, its index, and whether the joint is on the left."""
    indices = {name: index for index, name in enumerate(names)}
    paired: dict[int, tuple[int, bool]] = {}
    for mark in _SIDE_MARKS:
        for index, name in enumerate(names):
            match = mark.search(name)
            opposite = indices.get(mark.sub(lambda found: other_side(found.group()), name)) if match else None
            if (
                match
                and opposite is not None
                and opposite != index
                and index not in paired
                and opposite not in paired
            ):
                left = match.group().lower() in LEFT_WORDS
                paired[index], paired[opposite] = (opposite, left), (index, not left)
    return paired


def opposite_joints(names: Sequence[str]) -> tuple[int, ...]:
    """The index of each joint's opposite on the other side of the body; of a central joint, its own."""
    paired = _paired_marks(names)
    return tuple(paired[index][0] if index in paired else index for index in range(len(names)))


def joint_sides(names: Sequence[str]) -> tuple[str, ...]:
    """The side of each joint: "left", "right", or "" for a joint without an opposite."""
    paired = _paired_marks(names)
    return tuple(("left" if paired[i][1] else "right") if i in paired else "" for i in range(len(names)))
