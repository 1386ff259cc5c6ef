"""Retargeting of any human rig to the canonical skeleton of 23 joints, in cm, Y up.

Joints are found by name and hierarchy (rig_names), rest poses are compared (rest_pose), and the unit is detected
(units). Rotations are transferred in world space, so joints in between (a hip joint, a second root, extra spine
joints) are included.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from motionkit.arrays import Array, length, lower_median, normalized
from motionkit.errors import SkeletonError
from motionkit.motion.bvh import BvhFile, bvh_to_motion, read_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rest_pose import (
    SIDES,
    SourceRig,
    body_frame,
    bone_end,
    posed_differences,
    rest_differences,
    stands,
    tiny_length,
)
from motionkit.motion.rig_names import RigMap, map_rig
from motionkit.motion.rotations import (
    quat_angle,
    quat_between,
    quat_continuous,
    quat_inverse,
    quat_multiply,
    quat_normalize,
    quat_rotate,
)
from motionkit.motion.skeleton import JOINT_NAMES, PARENTS, Skeleton, canonical_skeleton, leg_length
from motionkit.motion.units import check_leg, guess_scale

_TORSO = ("LowerBack", "Spine", "Spine1", "Neck", "LeftShoulder", "RightShoulder")
# A source bone shorter than this share of its canonical length is a gap in the rig, not a short bone.
_GAP = 0.01


@dataclass(frozen=True, eq=False)
class RetargetReport:
    """What retargeting found in a rig, and what it changed.

    Attributes:
        source_joints: number of joints in the file.
        mapped: canonical joint name to source joint name.
        missing: canonical joints without a source; they keep their rest pose relative to their parents.
        ignored: unused source joints.
        scale: cm per file unit.
        scale_source: how the scale was determined.
        leg_length: thigh plus shin of this body, cm.
        root_scale: extra factor of root positions (canonical leg length / this body's).
        notes: rest-pose differences, a changed up axis and the like.
        body: (23, 3) offsets of this body in cm: its bone lengths in canonical rest directions.
    """

    source_joints: int
    mapped: dict[str, str]
    missing: tuple[str, ...]
    ignored: tuple[str, ...]
    scale: float
    scale_source: str
    leg_length: float
    root_scale: float
    notes: tuple[str, ...]
    body: Array


def retarget_file(
    path: str | Path, scale: float | None = None, fps: float | None = None, own_body: bool = False
) -> tuple[Motion, RetargetReport]:
    """Read a BVH file and retarget it; arguments as for retarget. Raises BvhError or SkeletonError."""
    bvh = read_bvh(path)
    try:
        return retarget(bvh, scale, fps, own_body)
    except SkeletonError as error:
        raise SkeletonError(f"{path}: {error}") from None


def retarget(
    bvh: BvhFile, scale: float | None = None, fps: float | None = None, own_body: bool = False
) -> tuple[Motion, RetargetReport]:
    """Retarget a BVH file to the canonical skeleton, at its own frame rate.

    Args:
        bvh: any human rig.
        scale: cm per file unit; detected from the leg length by default.
        fps: frame rate, if the file's header is wrong.
        own_body: keep this body's bone lengths. Otherwise the motion has the canonical body, and root positions are
            scaled about the world's origin by the ratio of leg lengths.

    Returns:
        The motion and a report.

    Raises:
        SkeletonError: the rig is not a known human rig.
    """
    bvh = _median_offsets(bvh)
    names = bvh.skeleton.names
    full_rig = map_rig(bvh.skeleton)
    bvh, rig = _keep_needed(bvh, full_rig)
    source = SourceRig(bvh.skeleton, rig, bvh.skeleton.rest_positions())
    rotations, positions = motion_kinematics(bvh_to_motion(bvh, fps=fps))
    frame = body_frame(source)
    standing = stands(source, frame)
    up = _up_axis(source, positions, frame if standing else None)
    turn = quat_between(up, np.array([0.0, 1.0, 0.0], np.float32))
    if float(up[1]) < 1.0:
        rotations, positions = (
            quat_multiply(np.broadcast_to(turn, rotations.shape), rotations),
            quat_rotate(turn, positions),
        )
    if standing:
        differences = rest_differences(source, frame)
    else:
        differences = posed_differences(source, rotations, positions)
    leg = _leg(source)
    check_leg(leg)
    scale, scale_source = (scale, "given") if scale is not None else guess_scale(leg)
    root_scale = leg_length(canonical_skeleton()) / (leg * scale)
    shape = source.rest[None] if standing else positions
    body, body_notes = _body(source, shape * scale, scale)
    target = canonical_skeleton(body) if own_body else canonical_skeleton()
    turned = _canonical_rotations(rig, rotations, differences)
    places = positions * (scale if own_body else scale * root_scale)
    roots = _root_positions(rig, places, turned[:, 0], target)
    motion = Motion(target, _to_local(turned), roots, bvh.fps if fps is None else fps)
    notes = _pose_notes(up, frame, standing, differences) + body_notes
    report = RetargetReport(
        source_joints=len(names),
        mapped={name: names[joint] for name, joint in full_rig.places.items()},
        missing=rig.missing(),
        ignored=tuple(name for j, name in enumerate(names) if j not in full_rig.places.values()),
        scale=scale,
        scale_source=scale_source,
        leg_length=leg * scale,
        root_scale=root_scale,
        notes=notes,
        body=body,
    )
    return motion, report


def _median_offsets(bvh: BvhFile) -> BvhFile:
    """Replace the OFFSET of six-channel joints by the median of their position channels."""
    offsets = bvh.skeleton.offsets.copy()
    for joint, (names, columns) in enumerate(zip(bvh.channels, bvh.columns(), strict=True)):
        for name, column in zip(names, columns, strict=True):
            if joint and name.endswith("position"):
                offsets[joint, "XYZ".index(name[0])] = float(np.median(bvh.values[:, column]))
    return replace(bvh, skeleton=replace(bvh.skeleton, offsets=offsets))


def _keep_needed(bvh: BvhFile, rig: RigMap) -> tuple[BvhFile, RigMap]:
    """Remove joints that no canonical joint needs (fingers, meshes, helpers).

    Bones that ended in such joints get an End Site instead.
    """
    skeleton = bvh.skeleton
    needed: set[int] = set()
    for joint in (*rig.places.values(), *rig.turns.values()):
        while joint >= 0 and joint not in needed:
            needed.add(joint)
            joint = skeleton.parents[joint]
    keep = sorted(needed)
    new = {joint: index for index, joint in enumerate(keep)}
    parents = tuple(new[skeleton.parents[j]] if skeleton.parents[j] >= 0 else -1 for j in keep)
    ends: dict[int, tuple[float, float, float]] = {}
    tiny = tiny_length(skeleton)
    for joint in keep:
        if new[joint] in parents:
            continue
        end = bone_end(skeleton, joint, tiny)
        if end is not None:
            ends[new[joint]] = (float(end[0]), float(end[1]), float(end[2]))
    kept = Skeleton(tuple(skeleton.names[j] for j in keep), parents, skeleton.offsets[keep], ends)
    columns = bvh.columns()
    values = bvh.values[:, [column for j in keep for column in columns[j]]]
    small = BvhFile(kept, tuple(bvh.channels[j] for j in keep), values, bvh.frame_time)
    places = {name: new[j] for name, j in rig.places.items()}
    return small, RigMap(places, {name: new[j] for name, j in rig.turns.items()})


def _up_axis(source: SourceRig, positions: Array, frame: Array | None) -> Array:
    """The up axis (3,) of the world, by the recorded poses, with a preference for Y and the rest pose."""
    places = source.rig.places
    arms = (positions[:, places["LeftArm"]] + positions[:, places["RightArm"]]) / 2
    hips = (positions[:, places["LeftUpLeg"]] + positions[:, places["RightUpLeg"]]) / 2
    mean = normalized(arms - hips).mean(0)
    votes = np.abs(mean) + np.array([0.0, 0.3, 0.0], np.float32)
    sign = np.where(mean < 0, -1.0, 1.0)
    if frame is not None:  # the body may be on the floor or upside down for a whole clip
        rest = quat_rotate(frame, np.array([0.0, 1.0, 0.0], np.float32))
        axis = int(np.abs(rest).argmax())
        votes[axis] += 0.4
        sign[axis] = 1.0 if rest[axis] > 0 else -1.0
    best = int(votes.argmax())
    return np.eye(3, dtype=np.float32)[best] * sign[best].astype(np.float32)


def _leg(source: SourceRig) -> float:
    """Thigh plus shin in file units, the mean of both sides."""
    total = 0.0
    for side in SIDES:
        for part in ("UpLeg", "Leg"):
            bone = source.bone(f"{side}{part}")
            if bone is None:
                raise SkeletonError(
                    f"{side}{part} is a bone of zero length, so the scale cannot be determined"
                )
            total += float(np.linalg.norm(bone[1]))
    return total / 2.0


def _canonical_rotations(rig: RigMap, rotations: Array, differences: Array) -> Array:
    """Global rotations (T, 23, 4) of the canonical joints; joints without a source follow their parent."""
    carriers: list[int] = []  # the canonical joint whose source moves each canonical joint
    for joint, name in enumerate(JOINT_NAMES):
        carriers.append(joint if name in rig.turns else carriers[PARENTS[joint]])
    sources = [rig.turns[JOINT_NAMES[joint]] for joint in carriers]
    return quat_multiply(rotations[:, sources], differences[carriers])


def _to_local(rotations: Array) -> Array:
    """Local rotations (T, 23, 4) of global ones, with signs continuous in time."""
    parents = rotations[:, list(PARENTS[1:])]
    local = quat_multiply(quat_inverse(parents), rotations[:, 1:])
    return quat_continuous(quat_normalize(np.concatenate([rotations[:, :1], local], axis=1)))


def _root_positions(rig: RigMap, positions: Array, hips: Array, target: Skeleton) -> Array:
    """Hip positions (T, 3) that put the middle between the thighs where the source has it.

    Rigs place their hip joint anywhere between thighs and navel; this must not move the legs.
    """
    thighs = [positions[:, rig.places[f"{side}UpLeg"]] for side in SIDES]
    sockets = [target.offsets[target.index(f"{side}UpLeg")] for side in SIDES]
    middle, socket = (thighs[0] + thighs[1]) / 2, (sockets[0] + sockets[1]) / 2
    return middle - quat_rotate(hips, np.broadcast_to(socket, middle.shape))


def _body(source: SourceRig, shape: Array, scale: float) -> tuple[Array, tuple[str, ...]]:
    """This body's offsets (23, 3) in cm, in canonical directions, and notes on assumed lengths.

    A length missing in the rig is the canonical one, in proportion to the legs. If the rig's torso lacks joints, the
    torso is scaled as a whole, by its height and widths in shape (T, J, 3), cm.
    """
    canonical = canonical_skeleton()
    rest = canonical.rest_positions()
    share = _leg(source) * scale / leg_length(canonical)
    ratios = np.full(len(JOINT_NAMES), share, np.float32)
    assumed: list[str] = []
    for joint, name in enumerate(JOINT_NAMES[1:], start=1):
        above = PARENTS[joint]
        while above > 0 and JOINT_NAMES[above] not in source.rig.places:
            above = PARENTS[above]
        own = _own_length(source, JOINT_NAMES[above], name)
        usual = float(np.linalg.norm(rest[joint] - rest[above]))
        if own is None or usual == 0.0:
            continue
        if own * scale < _GAP * share * usual:
            assumed.append(name)
            continue
        while joint != above:  # joints missing in the rig share the length with the one below them
            ratios[joint] = own * scale / usual
            joint = PARENTS[joint]
    if not all(name in source.rig.places for name in _TORSO):
        for names, ratio in _torso_ratios(source, shape, rest):
            for name in names:
                ratios[JOINT_NAMES.index(name)] = ratio
        assumed = [name for name in assumed if name not in _TORSO]
    body = canonical.offsets * ratios[:, None]
    if not assumed:
        return body, ()
    return body, (f"the file has no length for {', '.join(assumed)}; assumed in proportion to the legs",)


def _own_length(source: SourceRig, above: str, name: str) -> float | None:
    """The rest length of a bone in file units, or None if the rig does not have it."""
    top, bottom = source.place(above), source.place(name)
    if top is not None and bottom is not None:
        return float(np.linalg.norm(bottom - top))
    if above.endswith(("ForeArm", "Foot")):  # a hand or toe that is only an End Site
        bone = source.bone(above)
        return None if bone is None else float(np.linalg.norm(bone[1]))
    return None


def _torso_ratios(source: SourceRig, shape: Array, rest: Array) -> list[tuple[tuple[str, ...], float]]:
    """The size of the torso relative to the canonical one: height, shoulder width, hip width, head height."""

    places = source.rig.places

    def corners(at: Array, index: dict[str, int]) -> list[Array]:
        return [at[..., index[f"{side}{part}"], :] for part in ("UpLeg", "Arm") for side in SIDES]

    def sizes(left_hip: Array, right_hip: Array, left_arm: Array, right_arm: Array) -> Array:
        spine = (left_arm + right_arm - left_hip - right_hip) / 2
        widths = [left_arm - right_arm, left_hip - right_hip]
        return np.stack([np.linalg.norm(v, axis=-1) for v in (spine, *widths)], axis=-1)

    own = lower_median(sizes(*corners(shape, places)).reshape(-1, 3), axis=0)
    ours = sizes(*corners(rest, {name: j for j, name in enumerate(JOINT_NAMES)}))
    height, arms, hips = (float(ratio) for ratio in own / ours)
    ratios = [
        (("LowerBack", "Spine", "Spine1", "Neck", "LeftShoulder", "RightShoulder"), height),
        (("LeftArm", "RightArm"), arms),
        (("LeftUpLeg", "RightUpLeg"), hips),
    ]
    if "Head" in places:  # necks begin at different heights: keep the head's height above the shoulders
        middle = (shape[:, places["LeftArm"]] + shape[:, places["RightArm"]]) / 2
        above = float(lower_median(length(shape[:, places["Head"]] - middle)))
        neck, head = rest[JOINT_NAMES.index("Neck")], rest[JOINT_NAMES.index("Head")]
        below = height * float(rest[JOINT_NAMES.index("LeftArm")][1] - neck[1])
        ratios.append((("Neck1", "Head"), (above + below) / float(head[1] - neck[1])))
    return ratios


def _pose_notes(up: Array, frame: Array, standing: bool, differences: Array) -> tuple[str, ...]:
    """Notes on how the source's axes and rest pose differ."""
    notes = []
    if float(up[1]) < 0.5:
        axis = int(np.abs(up).argmax())
        notes.append(f"up axis {'+' if float(up[axis]) > 0 else '-'}{'XYZ'[axis]} turned to +Y")
    if not standing:
        notes.append("the rest pose is not a standing human; rest rotations were taken from the motion")
        return tuple(notes)
    facing = quat_rotate(frame, np.array([0.0, 0.0, 1.0], np.float32))
    axis = int(np.abs(facing).argmax())
    if axis != 2 or float(facing[axis]) < 0:
        notes.append(f"the rest pose faces {'+' if float(facing[axis]) > 0 else '-'}{'XYZ'[axis]}")
    apart = np.rad2deg(quat_angle(np.broadcast_to(frame, differences.shape), differences))
    turned = [
        f"{name} {angle:.0f}" for name, angle in zip(JOINT_NAMES, apart.tolist(), strict=True) if angle > 5
    ]
    if turned:
        notes.append(f"the rest pose differs, in degrees: {', '.join(turned)}")
    return tuple(notes)
