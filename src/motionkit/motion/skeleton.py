"""Joint hierarchies, and the canonical skeleton of 23 joints to which every motion is retargeted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import SkeletonError


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A joint hierarchy in its rest pose.

    Attributes:
        names: J joint names, parents before children; the first is the root.
        parents: J parent indices; the root's is -1.
        offsets: (J, 3) positions relative to the parent in the rest pose; all its rotations are identity.
        end_sites: joint index to the offset (3,) of its bone's end.
        cm: cm per unit of length, where the file's format says it; else None.
        up: the axis of the world that points up, such as "+Z", where the file's format says it; else None.
        humanoid: canonical limb joints, hips and head to joint indices, where an avatar's bone table or the bone map of
            a rig says it; else empty.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Array
    end_sites: dict[int, tuple[float, float, float]] = field(default_factory=dict)
    cm: float | None = None
    up: str | None = None
    humanoid: dict[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.names)

    def index(self, name: str) -> int:
        """The index of a joint by name; raises SkeletonError if it is unknown."""
        try:
            return self.names.index(name)
        except ValueError:
            raise SkeletonError(f"unknown joint {name!r}, expected one of {', '.join(self.names)}") from None

    def children(self, joint: int) -> list[int]:
        """Indices of the joint's children."""
        return [j for j, parent in enumerate(self.parents) if parent == joint]

    def branch_sizes(self) -> list[int]:
        """How many joints are below each joint, itself included."""
        sizes = [1] * len(self.parents)
        for joint in range(len(sizes) - 1, 0, -1):
            if self.parents[joint] >= 0:
                sizes[self.parents[joint]] += sizes[joint]
        return sizes

    def descends(self, joint: int, above: int) -> bool:
        """Whether a joint descends from the joint `above`, or is the same."""
        while joint > above:
            joint = self.parents[joint]
        return joint == above

    def path(self, joint: int) -> list[int]:
        """The joints from the root to a joint, both included."""
        out = [joint]
        while self.parents[out[-1]] >= 0:
            out.append(self.parents[out[-1]])
        return out[::-1]

    def between(self, above: int, joint: int) -> list[int]:
        """The joints below `above` down to a joint that descends from it, the last one included."""
        path = self.path(joint)
        return path[path.index(above) + 1 :]

    def picked(self, joints: Sequence[int]) -> Skeleton:
        """Some joints, with the parents of each, in another order."""
        place = {joint: index for index, joint in enumerate(joints)}
        whole = set(self.humanoid.values()) <= set(joints)
        return Skeleton(
            tuple(self.names[joint] for joint in joints),
            tuple(place.get(self.parents[joint], -1) for joint in joints),
            self.offsets[list(joints)],
            {place[joint]: end for joint, end in self.end_sites.items() if joint in place},
            self.cm,
            self.up,
            {name: place[joint] for name, joint in self.humanoid.items()} if whole else {},
        )

    def rest_positions(self) -> Array:
        """Joint positions (J, 3) of the rest pose, the root at the origin."""
        positions = [np.zeros(3, self.offsets.dtype)]
        for joint in range(1, len(self)):
            positions.append(positions[self.parents[joint]] + self.offsets[joint])
        return np.stack(positions)

    def scaled(self, factor: float) -> Skeleton:
        """The same skeleton with every length multiplied by a factor."""
        ends = {j: (x * factor, y * factor, z * factor) for j, (x, y, z) in self.end_sites.items()}
        cm = None if self.cm is None else self.cm / factor
        return replace(self, offsets=self.offsets * factor, end_sites=ends, cm=cm)

    def same_hierarchy(self, other: Skeleton) -> bool:
        """Whether names and parents are equal (lengths may differ)."""
        return self.names == other.names and self.parents == other.parents


# Name, parent and offset in cm. The rest pose is that of CMU (arms level, legs spread by 20 degrees). The offsets are
# medians over the CMU subjects, made symmetric (docs/measure_offsets.py).
_CANONICAL: tuple[tuple[str, str, tuple[float, float, float]], ...] = (
    ("Hips", "", (0.0, 0.0, 0.0)),
    ("LeftUpLeg", "Hips", (9.14, -10.04, 4.01)),
    ("LeftLeg", "LeftUpLeg", (13.61, -37.4, 0.0)),
    ("LeftFoot", "LeftLeg", (14.92, -40.98, 0.0)),
    ("LeftToeBase", "LeftFoot", (1.02, -2.8, 11.75)),
    ("RightUpLeg", "Hips", (-9.14, -10.04, 4.01)),
    ("RightLeg", "RightUpLeg", (-13.61, -37.4, 0.0)),
    ("RightFoot", "RightLeg", (-14.92, -40.98, 0.0)),
    ("RightToeBase", "RightFoot", (-1.02, -2.8, 11.75)),
    ("LowerBack", "Hips", (0.0, 0.0, 0.0)),
    ("Spine", "LowerBack", (0.0, 11.38, -0.8)),
    ("Spine1", "Spine", (0.0, 11.46, 0.04)),
    ("Neck", "Spine1", (0.0, 10.8, 0.27)),
    ("Neck1", "Neck", (0.0, 9.81, 0.66)),
    ("Head", "Neck1", (0.0, 9.73, -1.39)),
    ("LeftShoulder", "Spine1", (0.0, 10.8, 0.27)),
    ("LeftArm", "LeftShoulder", (18.12, 6.97, -0.31)),
    ("LeftForeArm", "LeftArm", (30.09, 0.0, 0.0)),
    ("LeftHand", "LeftForeArm", (18.51, 0.0, 0.0)),
    ("RightShoulder", "Spine1", (0.0, 10.8, 0.27)),
    ("RightArm", "RightShoulder", (-18.12, 6.97, -0.31)),
    ("RightForeArm", "RightArm", (-30.09, 0.0, 0.0)),
    ("RightHand", "RightForeArm", (-18.51, 0.0, 0.0)),
)
_CANONICAL_ENDS: dict[str, tuple[float, float, float]] = {
    "LeftToeBase": (0.0, 0.0, 6.07),
    "RightToeBase": (0.0, 0.0, 6.07),
    "Head": (0.0, 9.99, -0.59),
    "LeftHand": (8.0, 0.0, 0.0),
    "RightHand": (-8.0, 0.0, 0.0),
}

JOINT_NAMES: tuple[str, ...] = tuple(name for name, _, _ in _CANONICAL)
JOINT_COUNT = len(JOINT_NAMES)
PARENTS: tuple[int, ...] = tuple(JOINT_NAMES.index(p) if p else -1 for _, p, _ in _CANONICAL)
# The four joints with contact labels, in the order of the contact columns.
FOOT_JOINTS: tuple[int, ...] = tuple(
    JOINT_NAMES.index(name) for name in ("LeftFoot", "LeftToeBase", "RightFoot", "RightToeBase")
)
STANDING_HEIGHTS = (10.5, 4.1, 10.5, 4.1)  # heights of these joints while the feet stand flat, cm
# Thigh plus shin as a share of standing height (anthropometric tables; also the CMU subjects).
LEG_TO_STATURE = 0.491


def mirrored_name(name: str) -> str:
    """The canonical joint name on the other side of the body; central joints map to themselves."""
    if name.startswith("Left"):
        return "Right" + name[4:]
    if name.startswith("Right"):
        return "Left" + name[5:]
    return name


_SPOKEN = {
    "UpLeg": "hip", "Leg": "knee", "Foot": "ankle", "ToeBase": "toes", "Shoulder": "collar", "Arm": "shoulder",
    "ForeArm": "elbow", "Hand": "wrist",
}  # fmt: skip


def spoken(name: str) -> str:
    """A canonical joint in words, such as "left knee"; other names stay."""
    for side in ("Left", "Right"):
        if name.removeprefix(side) in _SPOKEN and name != name.removeprefix(side):
            return f"{side.lower()} {_SPOKEN[name.removeprefix(side)]}"
    return name.lower() if name in JOINT_NAMES else name


# The index of each canonical joint's opposite on the other side.
MIRROR_JOINTS: tuple[int, ...] = tuple(JOINT_NAMES.index(mirrored_name(name)) for name in JOINT_NAMES)


def canonical_skeleton(offsets: Array | None = None) -> Skeleton:
    """The canonical skeleton of 23 joints in cm, facing +Z with left along +X.

    offsets (23, 3) are those of another body in cm; each end site is scaled with its joint's offset. Raises
    SkeletonError for another shape.
    """
    default = np.array([offset for _, _, offset in _CANONICAL], np.float32)
    ends = {JOINT_NAMES.index(name): end for name, end in _CANONICAL_ENDS.items()}
    if offsets is not None:
        if tuple(offsets.shape) != (JOINT_COUNT, 3):
            raise SkeletonError(f"expected offsets of shape ({JOINT_COUNT}, 3), found {tuple(offsets.shape)}")
        for joint, end in ends.items():
            share = float(np.linalg.norm(offsets[joint]) / np.maximum(np.linalg.norm(default[joint]), 1e-6))
            ends[joint] = (end[0] * share, end[1] * share, end[2] * share)
        default = offsets.astype(np.float32)
    return Skeleton(JOINT_NAMES, PARENTS, default, ends)


def leg_length(skeleton: Skeleton) -> float:
    """Thigh plus shin of a canonical skeleton in its unit, the mean of both sides."""
    lengths = np.linalg.norm(skeleton.offsets, axis=-1)
    names = ("LeftLeg", "LeftFoot", "RightLeg", "RightFoot")
    return float(sum(lengths[skeleton.index(name)] for name in names)) / 2.0
