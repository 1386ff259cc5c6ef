"""Retargeting of any human rig to the canonical skeleton of 23 joints, in cm, Y up.

It finds joints by name, shape and hierarchy (names.py), compares rest poses (rest_pose.py) and detects the unit
(units.py). Rotations are transferred in world space, so they include joints in between (a hip joint, a second root,
extra spine joints).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motionkit.arrays import Array, length, lower_median
from motionkit.errors import SkeletonError, naming
from motionkit.motion.bvh import BvhFile
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    quat_continuous,
    quat_inverse,
    quat_multiply,
    quat_normalize,
    quat_rotate,
)
from motionkit.motion.skeleton import JOINT_NAMES, PARENTS, Skeleton, canonical_skeleton, leg_length
from motionkit.rig.names import RigMap
from motionkit.rig.planting import plant_feet
from motionkit.rig.pose import RigPose, map_file, median_offsets, pose_notes, study_rig
from motionkit.rig.read_file import read_file
from motionkit.rig.rest_pose import SIDES, SourceRig
from motionkit.rig.rig import Rig
from motionkit.rig.units import check_leg, guess_scale

_TORSO = ("LowerBack", "Spine", "Spine1", "Neck", "LeftShoulder", "RightShoulder")
_GAP = 0.01  # share of its canonical length below which a source bone counts as missing


@dataclass(frozen=True, eq=False)
class RetargetReport:
    """What retargeting found in a rig, and what it changed.

    Attributes:
        source_joints: number of joints in the file.
        mapped: canonical joint name to source joint name.
        missing: canonical joints without a source; they keep their rest pose relative to their parents.
        scale: cm per file unit.
        scale_source: how the scale was determined.
        leg_length: thigh plus shin of this body, cm.
        root_scale: extra factor on root positions (canonical leg length / that of this body).
        notes: rest-pose differences, a turned up axis and the like.
        body: (23, 3) offsets in cm with the bone lengths of this body in canonical rest directions.
    """

    source_joints: int
    mapped: dict[str, str]
    missing: tuple[str, ...]
    scale: float
    scale_source: str
    leg_length: float
    root_scale: float
    notes: tuple[str, ...]
    body: Array


def retarget_file(
    path: str | Path,
    scale: float | None = None,
    fps: float | None = None,
    own_body: bool = False,
    plant: bool = False,
    clip: str | None = None,
) -> tuple[Motion, RetargetReport]:
    """Read a file and retarget it; clip as for read_file, other arguments as for retarget.

    Raises BvhError, MotionkitError or SkeletonError.
    """
    bvh = read_file(path, clip)
    with naming(path):
        return retarget(bvh, scale, fps, own_body, plant=plant)


def retarget(
    bvh: BvhFile,
    scale: float | None = None,
    fps: float | None = None,
    own_body: bool = False,
    rig: Rig | None = None,
    plant: bool = False,
) -> tuple[Motion, RetargetReport]:
    """Retarget a BVH file to the canonical skeleton, at its own frame rate.

    Args:
        bvh: any human rig.
        scale: cm per file unit; detected from the leg length by default.
        fps: frame rate, if the file's header is wrong.
        own_body: keep the bone lengths of this body. Otherwise the motion has the canonical body, and root positions
            are scaled about the origin of the world by the ratio of leg lengths.
        rig: the rig of the file, if known (rig/on_rig.py). Its joint map, up axis and rest pose replace those found in
            the file.
        plant: move the feet to where the source has them, so that they slide no more than there (planting.py).

    Returns:
        The motion and a report.

    Raises:
        SkeletonError: the file has no known human rig, or has other joints than rig.
    """
    bvh = median_offsets(bvh)
    names = bvh.skeleton.names
    if rig is not None and not rig.skeleton.same_hierarchy(bvh.skeleton):
        raise SkeletonError(f"has other joints than the rig {rig.name}")
    full_map = map_file(bvh) if rig is None else rig.joints
    pose = study_rig(bvh, full_map, fps, None if rig is None else (rig.up, rig.differences))
    leg = pose.leg()
    check_leg(leg)
    scale, scale_source = (scale, "given") if scale is not None else guess_scale(leg, bvh.skeleton.cm)
    root_scale = leg_length(canonical_skeleton()) / (leg * scale)
    body, body_notes = _body(pose, scale)
    target = canonical_skeleton(body) if own_body else canonical_skeleton()
    turned = _canonical_rotations(pose.source.rig, pose.rotations, pose.differences)
    places = pose.positions * (scale if own_body else scale * root_scale)
    roots = _root_positions(pose.source.rig, places, turned[:, 0], target)
    motion = Motion(target, to_local(turned), roots, bvh.fps if fps is None else fps)
    feet = _foot_places(pose.source.rig, places) if plant else None
    if feet is not None:
        motion = plant_feet(motion, *feet)
    report = RetargetReport(
        source_joints=len(names),
        mapped={name: names[joint] for name, joint in full_map.places.items()},
        missing=full_map.missing(),
        scale=scale,
        scale_source=scale_source,
        leg_length=leg * scale,
        root_scale=root_scale,
        notes=_map_notes(full_map, names) + pose_notes(pose, rig is not None) + body_notes,
        body=body,
    )
    return motion, report


def _map_notes(joints: RigMap, names: tuple[str, ...]) -> tuple[str, ...]:
    """A note on joints that were found by shape."""
    if not joints.by_shape:
        return ()
    listed = ", ".join(f"{names[joints.places[name]]} {name}" for name in sorted(joints.by_shape))
    return (
        f"unknown names; found by shape, {100 * min(map(joints.sure, joints.by_shape)):.0f} % sure or more: {listed}",
    )


def _canonical_rotations(rig: RigMap, rotations: Array, differences: Array) -> Array:
    """Global rotations (T, 23, 4) of the canonical joints; joints without a source follow their parent."""
    carriers: list[int] = []  # for each canonical joint, the one whose source it follows
    for joint, name in enumerate(JOINT_NAMES):
        carriers.append(joint if name in rig.turns else carriers[PARENTS[joint]])
    sources = [rig.turns[JOINT_NAMES[joint]] for joint in carriers]
    return quat_multiply(rotations[:, sources], differences[carriers])


def to_local(rotations: Array) -> Array:
    """Local rotations (T, 23, 4) of global ones, with signs continuous in time."""
    parents = rotations[:, list(PARENTS[1:])]
    local = quat_multiply(quat_inverse(parents), rotations[:, 1:])
    return quat_continuous(quat_normalize(np.concatenate([rotations[:, :1], local], axis=1)))


def _root_positions(rig: RigMap, positions: Array, hips: Array, target: Skeleton) -> Array:
    """Hip positions (T, 3) that put the midpoint between the thighs where the source has it.

    Rigs place their hip joint anywhere between thighs and navel, and this must not move the legs.
    """
    thighs = positions[:, rig.pair("UpLeg")].swapaxes(0, 1)
    sockets = [target.offsets[target.index(f"{side}UpLeg")] for side in SIDES]
    middle, socket = (thighs[0] + thighs[1]) / 2, (sockets[0] + sockets[1]) / 2
    return middle - quat_rotate(hips, np.broadcast_to(socket, middle.shape))


def _foot_places(rig: RigMap, positions: Array) -> tuple[str, Array] | None:
    """The joint by which to place the feet, and its positions (T, 2, 3), left and right, from positions (T, J, 3).

    The joint is the toe, or the ankle of a rig without toes.
    """
    for part in ("ToeBase", "Foot"):
        found = [rig.places[name] for side in SIDES if (name := f"{side}{part}") in rig.places]
        if len(found) == len(SIDES):
            return part, positions[:, found]
    return None


def _body(pose: RigPose, scale: float) -> tuple[Array, tuple[str, ...]]:
    """Offsets (23, 3) of this body in cm, in canonical directions, and notes on assumed lengths.

    A length missing in the rig is the canonical one, in proportion to the legs. If the torso of the rig lacks joints,
    it is scaled as a whole, by its height and widths in the rest pose, or in the recorded poses if the rest pose does
    not stand.
    """
    source = pose.source
    shape = (source.rest[None] if pose.standing else pose.positions) * scale
    canonical = canonical_skeleton()
    rest = canonical.rest_positions()
    share = pose.leg() * scale / leg_length(canonical)
    ratios = np.full(len(JOINT_NAMES), share, np.float32)
    assumed: list[str] = []
    for joint, name in enumerate(JOINT_NAMES[1:], start=1):
        above = PARENTS[joint]
        while above > 0 and JOINT_NAMES[above] not in source.rig.places:
            above = PARENTS[above]
        size = _bone_length(source, JOINT_NAMES[above], name)
        usual = float(np.linalg.norm(rest[joint] - rest[above]))
        if size is None or usual == 0.0:
            continue
        if size * scale < _GAP * share * usual:
            assumed.append(name)
            continue
        while joint != above:  # joints missing in the rig get the same ratio as the joint below them
            ratios[joint] = size * scale / usual
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


def _bone_length(source: SourceRig, above: str, name: str) -> float | None:
    """The rest length of a bone in file units; None if the rig does not have it."""
    top, bottom = source.place(above), source.place(name)
    if top is not None and bottom is not None:
        return float(np.linalg.norm(bottom - top))
    if above.endswith(("ForeArm", "Foot")):  # a hand or toe may be only an End Site
        bone = source.bone(above)
        return None if bone is None else float(np.linalg.norm(bone[1]))
    return None


def _torso_ratios(source: SourceRig, shape: Array, rest: Array) -> list[tuple[tuple[str, ...], float]]:
    """Ratios of the torso to the canonical one by joints: height, shoulder width, hip width, head height."""

    places = source.rig.places

    def corners(at: Array, index: dict[str, int]) -> list[Array]:
        return [at[..., index[f"{side}{part}"], :] for part in ("UpLeg", "Arm") for side in SIDES]

    def sizes(left_hip: Array, right_hip: Array, left_arm: Array, right_arm: Array) -> Array:
        spine = (left_arm + right_arm - left_hip - right_hip) / 2
        widths = [left_arm - right_arm, left_hip - right_hip]
        return np.stack([np.linalg.norm(v, axis=-1) for v in (spine, *widths)], axis=-1)

    measured = lower_median(sizes(*corners(shape, places)).reshape(-1, 3), axis=0)
    ours = sizes(*corners(rest, {name: j for j, name in enumerate(JOINT_NAMES)}))
    height, arms, hips = (float(ratio) for ratio in measured / ours)
    ratios = [
        (("LowerBack", "Spine", "Spine1", "Neck", "LeftShoulder", "RightShoulder"), height),
        (("LeftArm", "RightArm"), arms),
        (("LeftUpLeg", "RightUpLeg"), hips),
    ]
    if "Head" in places:  # keep its height above the shoulders, because necks begin at different heights
        middle = (shape[:, places["LeftArm"]] + shape[:, places["RightArm"]]) / 2
        above = float(lower_median(length(shape[:, places["Head"]] - middle)))
        neck, head = rest[JOINT_NAMES.index("Neck")], rest[JOINT_NAMES.index("Head")]
        below = height * float(rest[JOINT_NAMES.index("LeftArm")][1] - neck[1])
        ratios.append((("Neck1", "Head"), (above + below) / float(head[1] - neck[1])))
    return ratios
