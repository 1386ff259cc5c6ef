"""Studies the rig of a BVH file: its mapped joints, its up axis, and how its rest pose differs from the canonical one.

Retargeting to the canonical skeleton (rig/retarget.py) and rigs to put motion on (rig/rig.py) both begin here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import SkeletonError
from motionkit.motion.bvh import BvhFile, bvh_to_motion
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.rotations import quat_angle, quat_inverse, quat_multiply, quat_rotate
from motionkit.motion.skeleton import JOINT_NAMES
from motionkit.rig.handedness import OPPOSED, handedness
from motionkit.rig.names import EXCHANGED, RigMap, map_rig
from motionkit.rig.rest_pose import (
    SIDES,
    SourceRig,
    body_frame,
    is_standing,
    longest_bone,
    named_end,
    posed_differences,
    rest_differences,
    tiny_length,
)
from motionkit.rig.up_axis import human_up, up_name, up_turn

_BACKWARDS = 0.5  # share of its length by which a foot may point backwards in the rest pose
_NOTED = 5.0  # degrees by which a rest pose differs that is reported
_POSES = 3  # frames up to which a file shows poses and no motion
SAMPLES = 32  # recorded poses from which a rig without known names is mapped


@dataclass(frozen=True, eq=False)
class RigPose:
    """The rig of a file, and its motion.

    Attributes:
        source: the mapped joints, those between them, and their rest positions in file units and axes.
        rotations: (T, J, 4) recorded global rotations of these joints, turned to Y up.
        positions: (T, J, 3) recorded positions in file units, turned to Y up.
        up: (3,) up axis of the file.
        frame: (4,) orientation of the body in the rest pose, in the file's axes.
        standing: whether the rest pose is a standing human; otherwise the differences come from the recorded poses.
        differences: (23, 4) rotations from canonical to source rest directions (rest_pose.py).
    """

    source: SourceRig
    rotations: Array
    positions: Array
    up: Array
    frame: Array
    standing: bool
    differences: Array

    def leg(self) -> float:
        """Thigh plus shin in file units, the mean of both sides; raises SkeletonError if a bone has no length."""
        total = 0.0
        for side in SIDES:
            for part in ("UpLeg", "Leg"):
                bone = self.source.bone(f"{side}{part}")
                if bone is None:
                    name, longest = longest_bone(self.source.skeleton)
                    raise SkeletonError(
                        f"{side}{part} is a bone of zero length or less than a hundredth of that of {name}, "
                        f"{longest:.6g}, so the scale cannot be determined"
                    )
                total += float(np.linalg.norm(bone[1]))
        return total / 2.0


def map_file(bvh: BvhFile) -> RigMap:
    """Map the canonical joints of a file; raises SkeletonError if it is not a human rig."""
    few = replace(bvh, values=bvh.values[:: max(1, len(bvh.values) // SAMPLES)])
    return map_rig(bvh.skeleton, motion_kinematics(bvh_to_motion(few))[1])


def study_rig(
    bvh: BvhFile, rig: RigMap, fps: float | None = None, known: tuple[Array, Array] | None = None
) -> RigPose:
    """Study the rig of a file with mapped joints; call median_offsets first.

    known has the up axis (3,) and the differences (23, 4), if they are known already. fps is for files with a wrong
    header.
    """
    bvh, rig = _keep_needed(bvh, rig)
    source = SourceRig(bvh.skeleton, rig, bvh.skeleton.rest_positions())
    rotations, positions = motion_kinematics(bvh_to_motion(bvh, fps=fps))
    if known is None:
        _check_sides(source, positions)
    frame = body_frame(source)
    standing = is_standing(source, frame)
    up = known[0] if known else human_up(source, positions)
    rotations, positions = _turned_up(up, rotations, positions)
    if known:
        differences = known[1]
    elif standing:
        _check_feet(source, frame)
        differences = rest_differences(source, frame)
    else:
        differences = _pose_differences(source, rotations, positions)
    return RigPose(source, rotations, positions, up, frame, standing, differences)


def _pose_differences(source: SourceRig, rotations: Array, positions: Array) -> Array:
    """The differences (23, 4) of a rig whose rest pose does not stand: from a pose file's standing pose, or motion."""
    if len(positions) > _POSES:
        return posed_differences(source, rotations, positions)
    parents = [max(parent, 0) for parent in source.skeleton.parents]
    ends = {
        joint: tuple(quat_rotate(rotations[0, joint], np.array(end, np.float32)).tolist())
        for joint, end in source.skeleton.end_sites.items()
    }
    offsets = positions[0] - positions[0][parents]
    posed = replace(source.skeleton, offsets=offsets, end_sites=ends)
    stood = SourceRig(posed, source.rig, posed.rest_positions())
    frame = body_frame(stood)
    if not is_standing(stood, frame):
        return posed_differences(source, rotations, positions)
    turns = [source.rig.turns.get(name, source.rig.places["Hips"]) for name in JOINT_NAMES]
    return quat_multiply(quat_inverse(rotations[0, turns]), rest_differences(stood, frame))


def _turned_up(up: Array, rotations: Array, positions: Array) -> tuple[Array, Array]:
    """Turn global rotations (T, J, 4) and positions (T, J, 3) so that the up axis (3,) becomes +Y."""
    if float(up[1]) >= 1.0:
        return rotations, positions
    turn = up_turn(up)
    return (
        quat_multiply(np.broadcast_to(turn, rotations.shape), rotations),
        quat_rotate(turn, positions),
    )


def median_offsets(bvh: BvhFile) -> BvhFile:
    """Replace the OFFSET of six-channel joints by the median of their position channels."""
    offsets = bvh.skeleton.offsets.copy()
    for joint, (names, columns) in enumerate(zip(bvh.channels, bvh.columns(), strict=True)):
        for name, column in zip(names, columns, strict=True):
            if joint and name.endswith("position"):
                offsets[joint, "XYZ".index(name[0])] = float(np.median(bvh.values[:, column]))
    return replace(bvh, skeleton=replace(bvh.skeleton, offsets=offsets))


def _check_feet(source: SourceRig, frame: Array) -> None:
    """Raise SkeletonError if both feet of a standing rest pose point backwards, judged by its left and right."""
    ahead = []
    for side in SIDES:
        bone = source.bone(f"{side}Foot")
        if bone is not None:
            toe = quat_rotate(quat_inverse(frame), bone[1])
            ahead.append(float(toe[2]) > -_BACKWARDS * float(np.linalg.norm(toe)))
    if len(ahead) == len(SIDES) and not any(ahead):
        raise _backwards(source)


def _backwards(source: SourceRig) -> SkeletonError:
    left, right = _names(source, "Foot")
    return SkeletonError(
        f"the feet {left} and {right} point backwards: left and right are exchanged, or the rig is mirrored by a "
        "negative scale; `motionkit retarget --rig FILE --save-map map.json` writes a map for it, to give as --map"
    )


def _check_sides(source: SourceRig, positions: Array) -> None:
    """Raise SkeletonError if recorded positions (T, J, 3) show that left and right of legs or arms are exchanged."""
    agree, toes = handedness(source.rig.places, positions)
    if not agree < OPPOSED:
        if toes is not None and toes < OPPOSED:
            raise _backwards(source)
        return
    legs, hands = _names(source, "UpLeg"), _names(source, "Arm")
    if toes is None:
        raise SkeletonError(
            f"left and right are exchanged for the legs or for the arms: {legs[0]} (LeftUpLeg) is on the side of "
            f"{hands[1]} (RightArm), {legs[1]} (RightUpLeg) on that of {hands[0]} (LeftArm)"
        )
    limb, part, (left, right) = ("legs", "UpLeg", legs) if toes < 0.0 else ("arms", "Arm", hands)
    raise SkeletonError(
        f"left and right are exchanged for the {limb}: {left} (Left{part}) is on the right side of the body, {right} "
        f"(Right{part}) on the left, as the toes point"
    )


def _names(source: SourceRig, part: str) -> list[str]:
    """Names of the rig's left and right joint of a part."""
    return [source.skeleton.names[joint] for joint in source.rig.pair(part)]


def _keep_needed(bvh: BvhFile, rig: RigMap) -> tuple[BvhFile, RigMap]:
    """Remove joints that no canonical joint needs (fingers, meshes, helpers).

    A bone that ended in such a joint gets an End Site.
    """
    skeleton = bvh.skeleton
    mapped = {*rig.places.values(), *rig.turns.values()}
    keep = sorted({joint for one in mapped for joint in skeleton.path(one)})
    new = {joint: index for index, joint in enumerate(keep)}
    kept = bvh.picked(keep)
    ends: dict[int, tuple[float, float, float]] = {}
    tiny = tiny_length(skeleton)
    names = {joint: name for name, joint in rig.places.items()}
    for joint in keep:
        if new[joint] in kept.skeleton.parents:
            continue
        end = named_end(skeleton, names.get(joint, ""), joint, tiny)
        if end is not None:
            ends[new[joint]] = (float(end[0]), float(end[1]), float(end[2]))
    small = replace(kept, skeleton=replace(kept.skeleton, end_sites=ends))
    places = {name: new[j] for name, j in rig.places.items()}
    turns = {name: new[j] for name, j in rig.turns.items()}
    return small, RigMap(places, turns, exchanged=rig.exchanged)


def pose_notes(pose: RigPose, known: bool = False) -> tuple[str, ...]:
    """Notes on how the source's axes and rest pose differ; known: the rest pose is that of a given rig."""
    up, frame, differences = pose.up, pose.frame, pose.differences
    notes = [EXCHANGED] if pose.source.rig.exchanged else []
    if float(up[1]) < 0.5:
        notes.append(f"up axis {up_name(up)} turned to +Y")
    if not pose.standing:
        taken = "the rig" if known else "the motion"
        notes.append(f"the rest pose is not a standing human; rest rotations were taken from {taken}")
        return tuple(notes)
    facing = quat_rotate(frame, np.array([0.0, 0.0, 1.0], np.float32))
    axis = int(np.abs(facing).argmax())
    if axis != 2 or float(facing[axis]) < 0:
        notes.append(f"the rest pose faces {'+' if float(facing[axis]) > 0 else '-'}{'XYZ'[axis]}")
    apart = np.rad2deg(quat_angle(np.broadcast_to(frame, differences.shape), differences))
    most = int(apart.argmax())
    if apart[most] > _NOTED:
        notes.append(
            f"the rest pose differs from motionkit's, by up to {apart[most]:.0f} degrees ({JOINT_NAMES[most]}); "
            "this is handled"
        )
    return tuple(notes)
