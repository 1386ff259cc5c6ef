"""The difference between the rest pose of a source rig and the canonical one, as a constant rotation per joint.

The global rotation of a canonical joint is that of its source joint times this difference D, which rotates canonical to
source rest directions. D comes from the rest pose if that shows a standing human. Otherwise (in some exports all bones
lie along one axis) it comes from the recorded poses.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from motionkit.arrays import Array, cross, length, normalized
from motionkit.motion.rotations import (
    matrix_to_quat,
    mean_rotation,
    quat_between,
    quat_from_yaw,
    quat_identity,
    quat_inverse,
    quat_multiply,
    quat_rotate,
    quat_to_matrix,
)
from motionkit.motion.skeleton import JOINT_NAMES, PARENTS, Skeleton, canonical_skeleton
from motionkit.rig.names import RigMap

SIDES = ("Left", "Right")
_CANONICAL = canonical_skeleton()
_CANONICAL_REST = _CANONICAL.rest_positions()
# Each bone points to the first of these joints that the source has.
_AHEAD: dict[str, tuple[str, ...]] = {
    "LowerBack": ("Spine", "Spine1", "Neck"),
    "Spine": ("Spine1", "Neck"),
    "Spine1": ("Neck", "Head"),
    "Neck": ("Neck1", "Head"),
    "Neck1": ("Head",),
} | {
    f"{side}{part}": (f"{side}{ahead}",)
    for side in SIDES
    for part, ahead in (
        ("UpLeg", "Leg"), ("Leg", "Foot"), ("Foot", "ToeBase"),
        ("Shoulder", "Arm"), ("Arm", "ForeArm"), ("ForeArm", "Hand"),
    )
}  # fmt: skip
# Limb bones follow the source exactly. Other joints have different places inside the body on different rigs (the root
# of a collar bone, the curve of a spine). Up to these angles in degrees, a difference is anatomy and not posture.
_TOLERANCE = {"Shoulder": 60.0, "Hand": 30.0, "Neck": 45.0, "Neck1": 45.0, "Head": 60.0}
_TOLERANCE_ELSEWHERE = 40.0
_NO_POSTURE = 110.0  # degrees; an End Site at a larger angle does not show a hand or a head
_LIMBS = ("UpLeg", "Leg", "Arm", "ForeArm")
# Joints whose bone points to the top of the head if the rig has no mapped joint above them.
_TOPS = ("Neck", "Neck1", "Head")
# Names of head children that mark its top, and of face and hair joints, which do not show its direction.
_TOP_WORDS = re.compile(r"(end|nub|site|tip|top|effector)[\W\d_]*$", re.IGNORECASE)
_FACE_WORDS = re.compile(
    r"eye|jaw|ear|hair|tail|braid|bang|brow|lash|lid|lip|mouth|tongue|teeth|tooth|nose|cheek|chin|face",
    re.IGNORECASE,
)
_STEEP = 0.9  # sine of the pitch above which a toe joint, or the end of a foot, lies under its ankle
_ASIDE = 0.7  # cosine of the angle to the left-right axis above which the end of a head does not show its top
_LEFT = np.array([1.0, 0.0, 0.0], np.float32)
_ALONG_NECK = 45.0  # degrees; largest angle between the neck and a head child that continues it
# Bending axes of knees and elbows in the canonical rest pose, the same in every CMU recording.
_HINGES: dict[str, tuple[float, float, float]] = {
    "LeftLeg": (0.93969, 0.34202, 0.0),
    "RightLeg": (0.93969, -0.34202, 0.0),
    "LeftForeArm": (0.0, -0.86603, 0.5),
    "RightForeArm": (0.0, 0.86603, -0.5),
}
_BENT = math.radians(25.0)  # bend above which a joint shows its hinge axis
_UPRIGHT = math.radians(25.0)  # lean up to which a body is upright
_REFERENCE_FRAMES = 256  # recorded poses are thinned to four to eight times as many


def tables() -> dict[str, Any]:
    """The canonical rest pose and what is compared with it, as JSON values for a page (see rig/names.py)."""
    ends = {joint: list(end) for joint, end in _CANONICAL.end_sites.items()}
    return {
        "names": JOINT_NAMES, "parents": PARENTS, "offsets": _CANONICAL.offsets.tolist(), "ends": ends,
        "ahead": _AHEAD, "limbs": _LIMBS, "tops": _TOPS, "tolerance": _TOLERANCE, "elsewhere": _TOLERANCE_ELSEWHERE,
        "noPosture": _NO_POSTURE, "topWords": _TOP_WORDS.pattern, "faceWords": _FACE_WORDS.pattern,
        "steep": _STEEP, "aside": _ASIDE, "alongNeck": _ALONG_NECK,
    }  # fmt: skip


@dataclass(frozen=True, eq=False)
class SourceRig:
    """A source skeleton with its mapped joints, rest positions (J, 3) and bone ends."""

    skeleton: Skeleton
    rig: RigMap
    rest: Array

    def place(self, name: str) -> Array | None:
        """Rest position (3,) of a canonical joint, or None."""
        joint = self.rig.places.get(name)
        return None if joint is None else self.rest[joint]

    def bone(self, name: str) -> tuple[Array, Array] | None:
        """The bone of a joint as canonical and source rest vectors (3,); None if it has no end."""
        return self._bones.get(name)

    @cached_property
    def _bones(self) -> dict[str, tuple[Array, Array]]:
        tiny = tiny_length(self.skeleton)
        found = {name: self._find_bone(name, joint, tiny) for name, joint in self.rig.places.items()}
        return {name: bone for name, bone in found.items() if bone is not None}

    def _find_bone(self, name: str, joint: int, tiny: float) -> tuple[Array, Array] | None:
        index = JOINT_NAMES.index(name)
        for ahead in _AHEAD.get(name, ()):
            place = self.place(ahead)
            if place is not None and float(np.linalg.norm(place - self.rest[joint])) > tiny:
                canonical = _CANONICAL_REST[JOINT_NAMES.index(ahead)] - _CANONICAL_REST[index]
                return canonical, place - self.rest[joint]
        end = named_end(self.skeleton, name, joint, tiny)
        if end is None:
            return None
        if index in _CANONICAL.end_sites:
            return np.array(_CANONICAL.end_sites[index], np.float32), end
        return _CANONICAL.offsets[_CANONICAL.children(index)[0]], end


def bone_end(skeleton: Skeleton, joint: int, tiny: float) -> Array | None:
    """The end (3,) of a joint's bone: its End Site, or the mean of its children without thumbs."""
    end = skeleton.end_sites.get(joint)
    if end is not None and math.hypot(*end) > tiny:
        return np.array(end, np.float32)
    ends = []
    for child in skeleton.children(joint):
        offset = skeleton.offsets[child]
        if "thumb" in skeleton.names[child].lower():
            continue
        if float(np.linalg.norm(offset)) > tiny:
            ends.append(offset)
        elif (further := bone_end(skeleton, child, tiny)) is not None:
            ends.append(offset + further)
    return np.stack(ends).mean(0) if ends else None


def named_end(skeleton: Skeleton, name: str, joint: int, tiny: float) -> Array | None:
    """The end (3,) of the bone of the joint mapped to a canonical name; None if nothing shows it."""
    return (_head_end if name in _TOPS else bone_end)(skeleton, joint, tiny)


def _head_end(skeleton: Skeleton, joint: int, tiny: float) -> Array | None:
    """The end (3,) of a head: its End Site, a child named as its top, or the child that best continues the neck."""
    end = skeleton.end_sites.get(joint)
    if end is not None and math.hypot(*end) > tiny:
        return np.array(end, np.float32)
    rest = skeleton.rest_positions()
    below = skeleton.parents[joint]
    while below >= 0 and float(np.linalg.norm(rest[joint] - rest[below])) <= tiny:
        below = skeleton.parents[below]
    best, least = None, _ALONG_NECK
    for child in skeleton.children(joint):
        name, offset = skeleton.names[child], skeleton.offsets[child]
        if _FACE_WORDS.search(name) or float(np.linalg.norm(offset)) <= tiny:
            continue
        if _TOP_WORDS.search(name):
            return offset
        if below >= 0 and (angle := float(angle_between(rest[joint] - rest[below], offset))) <= least:
            best, least = offset, angle
    return best


def tiny_length(skeleton: Skeleton) -> float:
    """The length, in the skeleton's unit, below which a bone counts as zero."""
    return 1e-2 * longest_bone(skeleton)[1]


def longest_bone(skeleton: Skeleton) -> tuple[str, float]:
    """The joint that is furthest from its parent, and how far, in the skeleton's unit."""
    bones = zip(skeleton.names[1:], np.linalg.norm(skeleton.offsets[1:], axis=-1).tolist(), strict=True)
    ends = ((skeleton.names[joint], float(np.linalg.norm(end))) for joint, end in skeleton.end_sites.items())
    # A skeleton of one joint has the bone to its end, if any.
    found = list(bones) or [bone for bone in ends if bone[1] > 0.0] or [(skeleton.names[0], 1.0)]
    return max(found, key=lambda bone: bone[1])


def frame_from(lateral: Array, up: Array) -> Array:
    """Rotations (..., 4) whose Y axis is up (..., 3) and whose X axis is nearest to lateral (..., 3)."""
    y = normalized(up)
    x = normalized(lateral - (lateral * y).sum(-1, keepdims=True) * y)
    return matrix_to_quat(np.stack([x, y, cross(x, y)], axis=-1))


def body_frame(source: SourceRig) -> Array:
    """The orientation (4,) of the body in the rest pose, snapped to the axes if near them."""
    hips, arms = (source.rest[source.rig.pair(part)] for part in ("UpLeg", "Arm"))
    frame = frame_from(hips[0] - hips[1], (arms[0] + arms[1] - hips[0] - hips[1]) / 2)
    matrix = quat_to_matrix(frame)
    snapped = matrix.round()
    aligned = bool((np.abs(snapped).sum(0) == 1).all() and np.abs(matrix - snapped).max() < 0.35)
    return matrix_to_quat(snapped) if aligned else frame


def angle_between(a: Array, b: Array) -> Array:
    """The angle (...) in degrees between vectors (..., 3)."""
    return np.rad2deg(np.arctan2(length(cross(a, b)), (a * b).sum(-1)))


def is_standing(source: SourceRig, frame: Array) -> bool:
    """Whether the rest pose is a standing human: legs down, spine up, arms not crossed."""
    down, up = np.array([0.0, -1.0, 0.0], np.float32), np.array([0.0, 1.0, 0.0], np.float32)
    limits: list[tuple[str, Array, float]] = [(name, up, 60.0) for name in ("LowerBack", "Spine")]
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        outward = np.array([sign, 0.0, 0.0], np.float32)
        limits += [(f"{side}UpLeg", down, 60.0), (f"{side}Leg", down, 60.0)]
        limits += [(f"{side}Arm", outward, 105.0), (f"{side}ForeArm", outward, 120.0)]
    for name, direction, limit in limits:
        bone = source.bone(name)
        # The negation also catches a frame that is NaN.
        if bone is not None and not float(angle_between(quat_rotate(frame, direction), bone[1])) <= limit:
            return False
    return True


def rest_differences(source: SourceRig, frame: Array) -> Array:
    """The differences D (23, 4) from a standing rest pose."""
    out = np.broadcast_to(frame, (len(JOINT_NAMES), 4)).copy()
    for joint, name in enumerate(JOINT_NAMES):
        part = name.removeprefix("Left").removeprefix("Right")
        bone = source.bone(name)
        if part == "ToeBase":
            out[joint] = out[PARENTS[joint]]
        elif part == "Foot" and bone is not None and not _shows_no_toes(source, frame, name, bone[1]):
            toe = source.bone(name.replace("Foot", "ToeBase"))
            chosen = toe if toe is not None and _under(frame, bone[1], toe[1]) else bone
            out[joint] = _foot_difference(source, frame, name, *chosen)
        elif part in _LIMBS or part == "Hand":
            parent = out[PARENTS[joint]]
            if part == "Arm":  # relative to the chest, because collar bones vary between rigs
                parent = frame
            out[joint] = _turned(parent, bone, 0.0 if part in _LIMBS else _TOLERANCE["Hand"])
        elif part == "Foot" and source.place(name) is None:
            out[joint] = out[PARENTS[joint]]
        elif part == "Foot":
            out[joint] = _foot_difference(source, frame, name, _CANONICAL.offsets[joint + 1], _forward(frame))
        elif name != "Hips" and not (
            name in _TOPS and bone and _sideways(quat_rotate(frame, _LEFT), bone[1])
        ):
            out[joint] = _turned(frame, bone, _TOLERANCE.get(part, _TOLERANCE_ELSEWHERE))
    return out


def _shows_no_toes(source: SourceRig, frame: Array, name: str, bone: Array) -> bool:
    """Whether the bone (3,) of a foot without toes leads straight down, to the sole under its ankle."""
    down = quat_rotate(quat_inverse(frame), normalized(bone))
    return source.place(name.replace("Foot", "ToeBase")) is None and bool(down[1] < -_STEEP)


def _under(frame: Array, foot: Array, toe: Array) -> bool:
    """Whether the toe joint lies under the ankle and the toes (3,) extend over the ground, as no hanging foot's do."""
    down, ahead = (quat_rotate(quat_inverse(frame), normalized(direction)) for direction in (foot, toe))
    return bool(down[1] < -_STEEP and abs(ahead[1]) < 1.0 - _STEEP)


def _sideways(lateral: Array, bone: Array) -> bool:
    """Whether bones (..., 3) mostly point along the left-right axis (..., 3); no head does, so its end misleads."""
    return float(np.abs((normalized(bone) * normalized(lateral)).sum(-1)).mean()) > _ASIDE


def _forward(frame: Array) -> Array:
    """The facing direction (3,) of a body frame."""
    return quat_rotate(frame, np.array([0.0, 0.0, 1.0], np.float32))


def _turned(base: Array, bone: tuple[Array, Array] | None, tolerance: float) -> Array:
    """Turn base by the smallest rotation onto the source bone if they differ by more than tolerance degrees."""
    if bone is None:
        return base
    canonical = quat_rotate(base, bone[0])
    angle = float(angle_between(canonical, bone[1]))
    if angle <= tolerance or (tolerance > 0.0 and angle > _NO_POSTURE):
        return base
    return quat_multiply(quat_between(canonical, bone[1]), base)


def _foot_difference(source: SourceRig, frame: Array, name: str, canonical: Array, bone: Array) -> Array:
    """The difference of a foot; only heading and roll count, because it stands flat in the rest pose."""
    to_frame = quat_inverse(frame)
    in_frame = quat_rotate(to_frame, bone)
    pitch = math.degrees(math.asin(float(-in_frame[1] / np.linalg.norm(in_frame))))
    if not -30.0 < pitch < 70.0:  # the toes hang
        return _turned(frame, (canonical, bone), 0.0)
    hip, ankle = (source.place(name.replace("Foot", part)) for part in ("UpLeg", "Foot"))
    assert hip is not None and ankle is not None
    roll = _spread(quat_rotate(to_frame, ankle - hip)) - _canonical_spread(name)
    if abs(float(roll)) < math.radians(5.0):
        roll = np.zeros((), np.float32)
    flat = quat_from_roll(roll)
    yaw = _heading(in_frame) - _heading(quat_rotate(flat, canonical))
    if abs(float(yaw)) > math.radians(15.0):
        flat = quat_multiply(quat_from_yaw(yaw), flat)
    return quat_multiply(frame, flat)


def quat_from_roll(roll: Array) -> Array:
    """Rotations (..., 4) about Z by roll (...)."""
    zero = np.zeros_like(roll)
    return np.stack([np.cos(0.5 * roll), zero, zero, np.sin(0.5 * roll)], axis=-1)


def _spread(leg: Array) -> Array:
    """The angle (...) in radians of a leg vector (..., 3) to the left of straight down."""
    return np.arctan2(leg[..., 0], -leg[..., 1])


def _canonical_spread(foot: str) -> Array:
    """The spread of a canonical leg. A foot rolls with its shin when the legs come together."""
    hip = JOINT_NAMES.index(foot.replace("Foot", "UpLeg"))
    return _spread(_CANONICAL_REST[JOINT_NAMES.index(foot)] - _CANONICAL_REST[hip])


def _heading(vector: Array) -> Array:
    """The angle (...) in radians about Y that turns +Z towards a vector (..., 3)."""
    return np.arctan2(vector[..., 0], vector[..., 2])


def posed_differences(source: SourceRig, rotations: Array, positions: Array) -> Array:
    """The differences D (23, 4) from recorded global rotations (T, J, 4) and positions (T, J, 3), Y up.

    The frames of pelvis and chest come from hips, shoulders and spine while the body is upright. The frames of limbs
    come from their bones and the bending axes of knees and elbows. Feet are taken to be flat when they are lowest.
    """
    step = max(1, len(positions) // (4 * _REFERENCE_FRAMES))
    poses = _Poses(source, rotations[::step], positions[::step])
    return poses.differences()


class _Poses:
    """Recorded poses of a source rig, and the canonical global rotations computed from them."""

    def __init__(self, source: SourceRig, rotations: Array, positions: Array) -> None:
        self.source = source
        self.rotations = rotations
        self.positions = positions
        hips, arms = (positions[:, source.rig.pair(part)].swapaxes(0, 1) for part in ("UpLeg", "Arm"))
        self.hip_axis, self.arm_axis = hips[0] - hips[1], arms[0] - arms[1]
        self.up = (arms[0] + arms[1] - hips[0] - hips[1]) / 2
        self.lean = np.deg2rad(
            angle_between(self.up, np.broadcast_to(np.array([0.0, 1.0, 0.0], np.float32), self.up.shape))
        )
        limit = max(_UPRIGHT, float(np.quantile(self.lean, 0.05)))
        self.upright = self.lean <= limit
        self.geometry: dict[str, Array] = {}  # canonical global rotations (T, 4) of the joints done so far
        self.out = quat_identity((len(JOINT_NAMES),))

    def place(self, name: str) -> Array | None:
        joint = self.source.rig.places.get(name)
        return None if joint is None else self.positions[:, joint]

    def turn(self, name: str) -> Array:
        return self.rotations[:, self.source.rig.turns[name]]

    def bone(self, name: str) -> tuple[Array, Array] | None:
        """Canonical rest vector (3,) and the source bone in the world (T, 3)."""
        bone = self.source.bone(name)
        if bone is None:
            return None
        return bone[0], quat_rotate(self.turn(name), np.broadcast_to(bone[1], (len(self.up), 3)))

    def differences(self) -> Array:
        self.set_difference("Hips", frame_from(self.hip_axis, self.up), self.upright)
        hips, arms = normalized(self.hip_axis), normalized(self.arm_axis)
        for share, name in (
            (0.3, "LowerBack"),
            (0.6, "Spine"),
            (1.0, "Spine1"),
            (1.0, "Neck"),
            (1.0, "Neck1"),
        ):
            self._along_spine(name, (1 - share) * hips + share * arms)
        self._along_spine("Head", self.arm_axis)
        for side in SIDES:
            self.set_difference(f"{side}Shoulder", self.seen(f"{side}Shoulder"), self.upright)
            self._limb(f"{side}UpLeg", f"{side}Leg")
            self._limb(f"{side}Leg", f"{side}Leg")
            self._foot(side)
            self._limb(f"{side}Arm", f"{side}ForeArm")
            self._limb(f"{side}ForeArm", f"{side}ForeArm")
            self._hand(side)
        return self.out

    def seen(self, name: str) -> Array:
        """The canonical global rotation (T, 4) of the nearest ancestor that is done."""
        joint = PARENTS[JOINT_NAMES.index(name)]
        while JOINT_NAMES[joint] not in self.geometry:
            joint = PARENTS[joint]
        return self.geometry[JOINT_NAMES[joint]]

    def set_difference(self, name: str, geometry: Array, frames: Array) -> None:
        """Set a joint's difference to its mean over some frames, and compute its rotation in all frames."""
        if name not in self.source.rig.places:
            return
        difference = quat_multiply(quat_inverse(self.turn(name)), geometry)[frames]
        moment = np.einsum("ti,tj->ij", difference, difference)
        mean = mean_rotation(moment)
        self.out[JOINT_NAMES.index(name)] = mean
        self.geometry[name] = quat_multiply(self.turn(name), np.broadcast_to(mean, (len(self.up), 4)))

    def _along_spine(self, name: str, lateral: Array) -> None:
        bone = self.bone(name)
        if bone is None or (name in _TOPS and self._misleads(bone[1])):
            self.set_difference(name, self.seen(name), self.upright)
            return
        canonical, world = bone
        rest = frame_from(np.array([1.0, 0.0, 0.0], np.float32), canonical)
        self.set_difference(name, quat_multiply(frame_from(lateral, world), quat_inverse(rest)), self.upright)

    def _misleads(self, end: Array) -> bool:
        """Whether the end (T, 3) of a head points to the side or hangs in upright bodies."""
        away = angle_between(self.up[self.upright], end[self.upright])
        return float(np.median(away)) > _TOLERANCE["Head"] or _sideways(
            self.arm_axis[self.upright], end[self.upright]
        )

    def _limb(self, name: str, hinge_name: str) -> None:
        bone = self.bone(name)
        if bone is None:
            self.set_difference(name, self.seen(name), self.upright)
            return
        canonical, world = bone
        upper = self.bone(hinge_name.replace("ForeArm", "Arm").replace("Leg", "UpLeg"))
        lower = self.bone(hinge_name)
        if upper is not None and lower is not None:
            bent = np.deg2rad(angle_between(upper[1], lower[1])) > _BENT
            if int(bent.sum()) >= 3:
                axis = cross(upper[1], lower[1])
                rest = frame_from(np.array(_HINGES[hinge_name], np.float32), canonical)
                self.set_difference(name, quat_multiply(frame_from(axis, world), quat_inverse(rest)), bent)
                return
        base = self.seen(name)
        start = quat_rotate(base, np.broadcast_to(canonical, world.shape))
        self.set_difference(name, quat_multiply(quat_between(start, world), base), self.upright)

    def _foot(self, side: str) -> None:
        name, toe = f"{side}Foot", f"{side}ToeBase"
        place, bone = self.place(name), self.bone(name)
        if place is None:
            return
        if bone is None:
            roll = np.broadcast_to(quat_from_roll(-_canonical_spread(name)), (len(self.up), 4))
            self.set_difference(name, quat_multiply(quat_from_yaw(self.heading()), roll), self.upright)
            return
        canonical, world = bone
        height = place[:, 1] + 0.5 * world[:, 1]
        low = self.upright & (height <= np.quantile(height[self.upright], 0.2))
        roll = quat_from_roll(-_canonical_spread(name))
        yaw = _heading(world) - _heading(quat_rotate(roll, canonical))
        flat = quat_multiply(quat_from_yaw(yaw), np.broadcast_to(roll, (len(yaw), 4)))
        self.set_difference(name, flat, low)
        self.set_difference(toe, flat, low)

    def heading(self) -> Array:
        return _heading(
            quat_rotate(
                self.geometry["Hips"],
                np.broadcast_to(np.array([0.0, 0.0, 1.0], np.float32), (len(self.up), 3)),
            )
        )

    def _hand(self, side: str) -> None:
        name = f"{side}Hand"
        bone, base = self.bone(name), self.seen(name)
        if bone is not None:
            start = quat_rotate(base, np.broadcast_to(bone[0], bone[1].shape))
            base = quat_multiply(quat_between(start, bone[1]), base)
        self.set_difference(name, base, self.upright)
