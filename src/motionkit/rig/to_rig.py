"""Puts motion of the canonical joints on a user's rig, with its rest pose, axes and lengths.

This is the inverse of retarget.py: the global rotation of a rig's joint is that of its canonical joint times the
inverse of the rest-pose difference. The motion first goes to a body with the canonical joints and the bones of the rig,
scaled to canonical legs. The joints of the rig are where those of this body are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motionkit.arrays import Array, Doubles
from motionkit.errors import SkeletonError
from motionkit.motion.bvh import BvhFile, motion_to_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_identity, quat_inverse, quat_multiply, quat_normalize, quat_rotate
from motionkit.motion.skeleton import JOINT_NAMES, PARENTS, Skeleton, canonical_skeleton, leg_length
from motionkit.rig.rest_pose import SIDES, SourceRig
from motionkit.rig.retarget import to_local
from motionkit.rig.rig import STANCE_QUANTILE, Rig, mover, stance_part, top_joint
from motionkit.rig.twist import spread_twist
from motionkit.rig.up_axis import up_turn

THIGHS = [JOINT_NAMES.index(f"{side}UpLeg") for side in SIDES]


def to_rig(motion: Motion, rig: Rig, clip: Motion | None = None) -> Motion:
    """Put a motion on a rig without foot locking; finish/on_rig.py also locks the feet.

    Args:
        motion: T frames on the canonical joints, in cm, the floor at height zero.
        rig: the rig.
        clip: motion of the rig, at the rate of motion, that moves the joints without a canonical joint; its last frame
            lasts. By default these joints stay in their rest pose.

    Returns:
        T frames on the rig's skeleton, in its unit and axes.

    Raises:
        SkeletonError: clip has other joints than the rig.
    """
    return from_body(on_body(motion, rig), rig, clip)


def rig_bvh(motion: Motion, rig: Rig) -> BvhFile:
    """Convert a motion on the rig's skeleton to a file with the rig's hierarchy and channels."""
    return replace(motion_to_bvh(motion, rig.channels), hierarchy=rig.hierarchy)


def rig_body(rig: Rig) -> Skeleton:
    """The body of a rig: canonical joints with the bones of the rig, scaled to canonical legs.

    Its offsets are those of the rig, turned to canonical rest directions. A joint that the rig lacks is at the place of
    its parent. Beyond the last joint of a limb, it is as in the canonical skeleton.
    """
    source = SourceRig(rig.skeleton, rig.joints, rig.skeleton.rest_positions())
    canonical = canonical_skeleton()
    back = quat_inverse(rig.differences)
    offsets = np.zeros((len(JOINT_NAMES), 3), np.float64)
    for joint, name in enumerate(JOINT_NAMES[1:], start=1):
        above = PARENTS[joint]
        while JOINT_NAMES[above] not in rig.joints.places:
            above = PARENTS[above]
        place, bone = source.place(name), source.bone(JOINT_NAMES[above])
        footless = name.endswith("Foot") and name.replace("Foot", "ToeBase") not in rig.joints.places
        if place is None and (footless or not canonical.children(joint)):
            # Toes of a leg that ends in its shin are those of the canonical foot.
            if bone is None or name == "Head" or (above != PARENTS[joint] and name.endswith("ToeBase")):
                offsets[joint] = canonical.offsets[joint]
                continue
            place = source.place(JOINT_NAMES[above]) + bone[1]
        if place is not None:
            offset = place - source.place(JOINT_NAMES[above])
            offsets[joint] = quat_rotate(back[above], offset) * rig.scale
    return canonical_skeleton(offsets)


def on_body(motion: Motion, rig: Rig) -> Motion:
    """Put the global rotations of a motion on the body of a rig (rig_body), with the thighs in the same place.

    Positions are scaled to canonical leg length. Joints that the rig lacks turn with their parents.
    """
    rotations, positions = motion_kinematics(motion)
    carriers = [0] * len(JOINT_NAMES)
    for joint, name in enumerate(JOINT_NAMES[1:], start=1):
        carriers[joint] = joint if name in rig.joints.places else carriers[PARENTS[joint]]
    rotations = rotations[:, carriers]
    body = rig_body(rig)
    share = leg_length(canonical_skeleton()) / leg_length(motion.skeleton)
    middle = positions[:, THIGHS].mean(axis=1) * share
    socket = body.offsets[THIGHS].mean(axis=0)
    roots = middle - quat_rotate(rotations[:, 0], np.broadcast_to(socket, middle.shape))
    return Motion(body, to_local(rotations), roots.astype(np.float32), motion.fps)


def stance(motion: Motion, rig: Rig, contacts: Array) -> float | None:
    """The standing height of toes (ankles for a rig without toes), for canonical legs; None if they never stand."""
    part = stance_part(rig.joints)
    joints = [JOINT_NAMES.index(f"{side}{part}") for side in SIDES]
    heights = motion_kinematics(motion)[1][:, joints, 1]
    standing = heights[contacts[:, [1, 3] if part == "ToeBase" else [0, 2]] > 0.5]
    share = leg_length(canonical_skeleton()) / leg_length(motion.skeleton)
    return float(np.quantile(standing, STANCE_QUANTILE)) * share if len(standing) else None


def standing_height(rig: Rig, usual: float) -> float:
    """The standing height in cm of a rig's toes or ankles, for canonical legs; `usual` if its file shows none."""
    return max(usual if rig.stance is None else rig.stance, _depth(rig))


def _depth(rig: Rig) -> float:
    """Depth of the lowest point of a flat foot below its toe, or its ankle, in cm of the rig's body."""
    rest, skeleton = rig.skeleton.rest_positions(), rig.skeleton
    depths = [0.0]
    for side in SIDES:
        foot, joint = rig.place(f"{side}Foot"), rig.place(f"{side}{stance_part(rig.joints)}")
        if foot is None or joint is None:
            continue
        flat = quat_inverse(rig.differences[JOINT_NAMES.index(f"{side}Foot")])
        points = [rest[j] for j in range(len(skeleton)) if skeleton.descends(j, foot)]
        points += [
            rest[j] + np.array(end) for j, end in skeleton.end_sites.items() if skeleton.descends(j, foot)
        ]
        below = quat_rotate(flat, (np.stack(points) - rest[joint]).astype(np.float32))[:, 1]
        depths.append(-float(below.min()) * rig.scale)
    return max(depths)


def from_body(body: Motion, rig: Rig, clip: Motion | None = None) -> Motion:
    """Convert a motion of a rig's body (rig_body) to the rig; clip is as for to_rig."""
    skeleton, frames = rig.skeleton, len(body)
    rotations, _ = motion_kinematics(body)
    down = quat_inverse(up_turn(rig.up)).astype(np.float64)
    target = quat_multiply(
        np.broadcast_to(down, rotations.shape),
        quat_multiply(
            rotations.astype(np.float64), np.broadcast_to(quat_inverse(rig.differences), rotations.shape)
        ),
    )
    local, places = _kept(rig, frames, clip)
    turn = _turn_from_rest if clip is None else _turn_from_clip
    turned = turn(rig, turning_joints(rig), target, local)
    hips = quat_rotate(down, body.root_positions.astype(np.float64)) / rig.scale
    _move(rig, places, turned, hips)
    if clip is None:
        spread_twist(rig, local)
    translates = clip is not None and clip.local_positions is not None
    translates = translates or mover(skeleton, rig.channels, rig.joints) != 0
    return Motion(
        skeleton,
        local.astype(np.float32),
        places[:, 0].astype(np.float32),
        body.fps,
        places.astype(np.float32) if translates else None,
    )


def turning_joints(rig: Rig) -> dict[int, int]:
    """The joints of a rig that turn, and the canonical joint whose rotation each takes."""
    out = {joint: JOINT_NAMES.index(name) for name, joint in rig.joints.places.items()}
    out.setdefault(top_joint(rig.skeleton, rig.joints), 0)  # a joint above hips and spine turns as the hips
    return {joint: carrier for joint, carrier in out.items() if _turns(rig, joint)}


def _turn_from_rest(rig: Rig, carriers: dict[int, int], target: Doubles, local: Doubles) -> Doubles:
    """Global rotations (T, J, 4) of the rig, with joints that have no canonical joint in their rest pose.

    Args:
        carriers: rig joint to the canonical joint whose rotation it takes.
        target: (T, 23, 4) global rotations of the canonical joints on the rig.
        local: (T, J, 4) local rotations of the rest pose; those of the carriers are set in place.
    """
    parents = rig.skeleton.parents
    every = np.concatenate([target, quat_identity((len(target), 1), np.float64)], axis=1)
    sources: list[int] = []
    for joint, parent in enumerate(parents):
        sources.append(carriers.get(joint, sources[parent] if parent >= 0 else -1))
    turned = every[:, sources]
    mine = list(carriers)
    outer = every[:, [sources[parents[joint]] if parents[joint] >= 0 else -1 for joint in mine]]
    local[:, mine] = quat_normalize(quat_multiply(quat_inverse(outer), turned[:, mine]))
    return turned


def _turn_from_clip(rig: Rig, carriers: dict[int, int], target: Doubles, local: Doubles) -> Doubles:
    """Like _turn_from_rest, but joints without a canonical joint keep the local rotations of a clip."""
    skeleton = rig.skeleton
    turned = quat_identity((len(target), len(skeleton)), np.float64)
    above = quat_identity((len(target),), np.float64)
    for joint, parent in enumerate(skeleton.parents):
        outer = turned[:, parent] if parent >= 0 else above
        if joint in carriers:
            name = JOINT_NAMES[carriers[joint]]
            aim = target[:, carriers[joint]]
            last = rig.joints.turns[name] if rig.joints.places.get(name) == joint else joint
            for between in skeleton.between(joint, last)[::-1]:
                aim = quat_multiply(aim, quat_inverse(local[:, between]))
            local[:, joint] = quat_normalize(quat_multiply(quat_inverse(outer), aim))
        turned[:, joint] = quat_multiply(outer, local[:, joint])
    return turned


def _turns(rig: Rig, joint: int) -> bool:
    return any(channel.endswith("rotation") for channel in rig.channels[joint])


def _kept(rig: Rig, frames: int, clip: Motion | None) -> tuple[Doubles, Doubles]:
    """Initial local rotations (T, J, 4) and positions (T, J, 3), from the rest pose or a clip."""
    places = np.broadcast_to(rig.skeleton.offsets.astype(np.float64), (frames, len(rig.skeleton), 3)).copy()
    if clip is None:
        return quat_identity((frames, len(rig.skeleton)), np.float64), places
    if not clip.skeleton.same_hierarchy(rig.skeleton):
        raise SkeletonError(f"the clip has other joints than the rig {rig.name}")
    at = np.minimum(np.arange(frames), len(clip) - 1)
    if clip.local_positions is not None:
        places = clip.local_positions[at].astype(np.float64)
    places[:, 0] = clip.root_positions[at]
    return clip.local_rotations[at].astype(np.float64), places


def _move(rig: Rig, places: Doubles, turned: Doubles, hips: Doubles) -> None:
    """Move the body so that its hips are at hips (T, 3), by local positions, changed in place."""
    skeleton = rig.skeleton
    now = places[:, 0]
    for joint in skeleton.between(0, rig.joints.places["Hips"]):
        now = now + quat_rotate(turned[:, skeleton.parents[joint]], places[:, joint])
    carry(rig, places, turned, hips - now)


def carry(rig: Rig, places: Array, turned: Array, shift: Array) -> None:
    """Move the body by shift (T, 3): the local positions (T, J, 3) of those joints that carry it, in place.

    turned (T, J, 4) are the joints' global rotations.
    """
    moved = mover(rig.skeleton, rig.channels, rig.joints)
    assert moved is not None  # make_rig has checked it
    if rig.character is not None and rig.character.under:
        down = np.minimum(shift @ rig.up, 0.0)[:, None] * rig.up
        places[:, 0] += shift - down
        shift = down
    above = rig.skeleton.parents[moved]
    places[:, moved] += shift if above < 0 else quat_rotate(quat_inverse(turned[:, above]), shift)
