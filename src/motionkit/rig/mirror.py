"""Mirrors motions, files and folders of any rig with left and right joints: finds opposite joints and reflections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import SkeletonError, naming
from motionkit.files import check_outputs
from motionkit.motion.bvh import BvhFile, bvh_to_motion, write_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.mirror import REFLECTIONS, MirrorPlan, Signs, mirrored, mirrored_bvh, reflect_rotations
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import matrix_to_quat, mean_rotation, quat_angle
from motionkit.motion.skeleton import Skeleton
from motionkit.rig.names import map_rig, user_places
from motionkit.rig.pose import SAMPLES
from motionkit.rig.read_file import read_file
from motionkit.rig.shape import opposites_by_shape
from motionkit.rig.sides import opposite_joints
from motionkit.rig.up_axis import up_axis

# A bone votes against a reflection if its error, as a share of its length, exceeds that of another reflection by this
# much. The sides of real subjects differ by far less.
_SPEAKS_AGAINST = 0.5
_ODD_SHARE = 0.15  # share of bones that must vote against it; a single prop or mesh node must not decide
_SHORT_SHARE = 0.05  # of the mean bone; shorter bones do not vote, because their direction is noise
_SYMMETRIC = 0.02  # of the body's size; mean error up to which reflections alone mirror a rig
_LEAST_TURN = 1e-3  # weight of turning least beside that of the bones
_RIGID_SHARE = 0.01  # of the mean bone; a joint whose position varies by less ends a rigid bone


def mirror_plan(motion: Motion) -> MirrorPlan:
    """Find opposite joints by name, or by shape if no name has a side, and reflections by rest pose and mean pose.

    Limbs whose names have no side, beside others that have one, are those of the bone map (map_rig). A motion and its
    mirror image get the same plan.

    Raises:
        SkeletonError: the rig has no left and right, or its sides have different hierarchies.
    """
    skeleton = motion.skeleton
    opposites = _checked_opposites(motion)
    places, rigid = _mean_places(motion)
    axis = _common_axis(opposites, places, rigid)
    up = int(np.abs(up_axis(motion_kinematics(motion)[1], skeleton)).argmax())
    world = REFLECTIONS[2 if up == 0 else 0]  # a horizontal axis for every rig
    some = _sampled(motion)
    plans = [MirrorPlan(opposites, world, _joint_reflections(motion, opposites, places, rigid, world))]
    if axis is not None:
        signs = REFLECTIONS[axis]
        plans.insert(0, MirrorPlan(opposites, world if axis == up else signs, (signs,) * len(skeleton)))
    errors = [_error(some, plan) for plan in plans]
    least = min(errors)
    if least <= _SYMMETRIC:
        return next(plan for plan, error in zip(plans, errors, strict=True) if error <= _SYMMETRIC)
    turned = replace(
        plans[-1], joints=(world,) * len(skeleton), turns=_turns(skeleton, opposites, places, world)
    )
    return turned if _error(some, turned) < least else plans[errors.index(least)]


def _sampled(motion: Motion) -> Motion:
    return motion.cut(0, len(motion), max(1, len(motion) // SAMPLES))


def _error(motion: Motion, plan: MirrorPlan) -> float:
    """The mean distance of joints from the mirror images of their opposites, as a share of the body's size."""
    recorded = motion_kinematics(motion)[1]
    image = recorded[:, list(plan.opposites)] * np.array(plan.world, recorded.dtype)
    size = max(float((recorded.max(axis=1) - recorded.min(axis=1)).max()), 1e-9)
    return float(np.linalg.norm(motion_kinematics(mirrored(motion, plan))[1] - image, axis=-1).mean()) / size


def _turns(skeleton: Skeleton, opposites: tuple[int, ...], places: Array, world: Signs) -> Array:
    """The rotations (J, 4) that best map the bones of each joint to the reflected bones of its opposite.

    Bones in one line leave the turn about them open; then it is the least.
    """
    reflected = places[list(opposites)] * np.array(world)
    found: list[Array] = []
    for joint, parent in enumerate(skeleton.parents):
        below = skeleton.children(joint)
        mine, other = places[below], reflected[below]
        if joint in skeleton.end_sites and opposites[joint] in skeleton.end_sites:
            ends = [np.array(skeleton.end_sites[j]) for j in (joint, opposites[joint])]
            mine, other = np.vstack([mine, ends[:1]]), np.vstack([other, ends[1:] * np.array(world)])
        if not len(mine):
            found.append(found[parent] if joint else np.eye(3))
            continue
        spread = other.T @ mine
        u, _, vt = np.linalg.svd(spread + _LEAST_TURN * float(np.square(mine).sum()) * np.eye(3))
        found.append(u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt)
    return matrix_to_quat(np.stack(found))


def _checked_opposites(motion: Motion) -> tuple[int, ...]:
    names, parents = motion.skeleton.names, motion.skeleton.parents
    opposites = opposite_joints(names)
    poses = motion_kinematics(_sampled(motion))[1]
    known = user_places(motion.skeleton)
    if (
        known
        or motion.skeleton.humanoid
        or any(opposite != joint for joint, opposite in enumerate(opposites))
    ):
        opposites = _with_limbs(motion.skeleton, opposites, known or _limbs(motion.skeleton, poses))
    else:
        found = opposites_by_shape(motion.skeleton, poses)
        if found is None:
            listed = ", ".join(names[:6]) + (", ..." if len(names) > 6 else "")
            raise SkeletonError(
                "no joint name has a left and a right, expected some such as LeftArm, and the rig does not have "
                f"the shape of a human; found {listed}"
            )
        opposites = found
    for joint, opposite in enumerate(opposites):
        if opposite == joint:
            continue
        parent, other = parents[joint], parents[opposite]
        if parent < 0 or other < 0 or opposites[parent] != other:
            hangs = [names[p] if p >= 0 else "nothing" for p in (parent, other)]
            raise SkeletonError(
                f"{names[joint]} has the parent {hangs[0]} but {names[opposite]} has {hangs[1]}; "
                "mirroring needs the same hierarchy on both sides"
            )
    return opposites


def _limbs(skeleton: Skeleton, poses: Array) -> Mapping[str, int]:
    """The canonical joints of a rig by its names and shape; none of a rig that is not human."""
    try:
        return map_rig(skeleton, poses).places
    except SkeletonError:
        return {}


def _with_limbs(skeleton: Skeleton, opposites: Sequence[int], places: Mapping[str, int]) -> tuple[int, ...]:
    """Opposite joints with those of the limbs that have none yet, and of the joints around these, in order."""
    out, added = list(opposites), set[int]()

    def pair(left: int, right: int) -> None:
        if left != right and out[left] == left and out[right] == right:
            out[left], out[right] = right, left
            added.update((left, right))

    for name, left in places.items():
        if name.startswith("Left") and (right := places.get(f"Right{name[4:]}")) is not None:
            while not (skeleton.descends(left, right) or skeleton.descends(right, left)):
                pair(left, right)
                left, right = skeleton.parents[left], skeleton.parents[right]
    for joint in range(len(out)):
        if joint in added and out[joint] > joint:
            sides = [[c for c in skeleton.children(side) if out[c] == c] for side in (joint, out[joint])]
            if len(sides[0]) == len(sides[1]):
                for left, right in zip(*sides, strict=True):
                    pair(left, right)
    return tuple(out)


def _mean_places(motion: Motion) -> tuple[Array, tuple[bool, ...]]:
    """Mean positions (J, 3) in parent space, and whether each joint keeps its position."""
    count = len(motion.skeleton)
    if motion.local_positions is None:
        return motion.skeleton.offsets.astype(np.float64), (False,) + (True,) * (count - 1)
    places = motion.local_positions.astype(np.float64)
    mean = places.mean(axis=0)
    size = float(np.linalg.norm(mean[1:], axis=-1).mean()) if count > 1 else 1.0
    wander = np.linalg.norm(places - mean, axis=-1).max(axis=0)
    return mean, (False, *(bool(w < _RIGID_SHARE * size) for w in wander[1:]))


def _common_axis(opposites: tuple[int, ...], places: Array, rigid: tuple[bool, ...]) -> int | None:
    """The axis along which all bones mirror their opposites; None for a rig whose joints have individual axes."""
    points = places[[joint for joint, stays in enumerate(rigid) if stays]]
    other = places[[opposites[joint] for joint, stays in enumerate(rigid) if stays]]
    reflections = np.array(REFLECTIONS, points.dtype)
    misses = np.linalg.norm(points - other * reflections[:, None], axis=-1)
    axis = int(misses[:3].sum(axis=-1).argmin())
    length = np.maximum(np.linalg.norm(points, axis=-1), np.linalg.norm(other, axis=-1))
    against = misses[axis] > misses.min(axis=0) + _SPEAKS_AGAINST * length
    heard = length > _SHORT_SHARE * length.mean() if length.size else length > 0.0
    return None if int((against & heard).sum()) > _ODD_SHARE * int(heard.sum()) else axis


def _joint_reflections(
    motion: Motion, opposites: tuple[int, ...], places: Array, rigid: tuple[bool, ...], world: Signs
) -> tuple[Signs, ...]:
    """The reflection of each joint that best maps its opposite's bones and mean rotation to its own.

    Bones do not determine the rotation about themselves. A reflection that is wrong there turns the mean pose by
    half a turn, which no natural asymmetry does.
    """
    skeleton = motion.skeleton
    rotations = motion.local_rotations.astype(np.float64)
    means = mean_rotation(np.einsum("tji,tjk->jik", rotations, rotations))
    found: list[Signs] = []
    for joint, parent in enumerate(skeleton.parents):
        opposite = opposites[joint]
        if opposite < joint:
            found.append(found[opposite])
            continue
        outer = found[parent] if joint else world
        known = not joint or not rigid[joint]  # the mean rotation of a joint that translates says nothing
        costs = []
        # The parent's reflection comes first, so it wins ties.
        for signs in sorted(REFLECTIONS, key=lambda candidate: candidate != outer):
            bones = _bone_misfit(skeleton, joint, signs, opposites, places, rigid)
            turned = reflect_rotations(means[opposite], outer, signs)
            pose = 0.0 if known else float(quat_angle(means[joint], turned)) / np.pi
            costs.append((bones + 0.5 * pose, signs))
        best = min(cost for cost, _ in costs)
        found.append(next(signs for cost, signs in costs if cost <= best + 1e-3))
    return tuple(found)


def _bone_misfit(
    skeleton: Skeleton,
    joint: int,
    signs: Signs,
    opposites: tuple[int, ...],
    places: Array,
    rigid: tuple[bool, ...],
) -> float:
    """The difference of the bones below a joint from their reflected opposites, as a share of their length."""
    opposite = opposites[joint]
    below = [child for child in skeleton.children(joint) if rigid[child]]
    pairs = [(places[child], places[opposites[child]]) for child in below]
    if not joint and all(opposites[child] == child for child in below):
        return 0.0  # an offset from a root on the floor to the hips says nothing about left and right
    if joint in skeleton.end_sites and opposite in skeleton.end_sites:
        point, other = (np.array(skeleton.end_sites[j], places.dtype) for j in (joint, opposite))
        pairs.append((point, other))
    reflection = np.array(signs, places.dtype)
    length = sum(float(np.linalg.norm(point)) for point, _ in pairs)
    return sum(float(np.linalg.norm(point - reflection * other)) for point, other in pairs) / max(
        length, 1e-9
    )


def mirror_motion(motion: Motion) -> Motion:
    """Swap left and right of a motion on the same skeleton, for any rig with left and right joints.

    The world is reflected along the rig's left-right axis, X for the canonical skeleton.

    Raises:
        SkeletonError: the rig has no left and right.
    """
    return mirrored(motion, mirror_plan(motion))


def mirror_bvh(bvh: BvhFile) -> BvhFile:
    """Mirror a BVH file, with the same hierarchy and channels.

    Raises:
        SkeletonError: the rig has no left and right, or opposite joints have different channels.
    """
    return mirrored_bvh(bvh, mirror_plan(bvh_to_motion(bvh)))


def mirror_file(source: str | Path, target: str | Path) -> BvhFile:
    """Write the mirror image of a BVH file, with its hierarchy text; returns the file that was read.

    Raises MotionkitError, naming the file.
    """
    check_outputs([target], [source])
    bvh = read_file(source)
    with naming(source):
        write_bvh(target, mirror_bvh(bvh))
    return bvh
