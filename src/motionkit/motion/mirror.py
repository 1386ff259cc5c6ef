"""The mirror image of a motion on the same skeleton, for any rig with left and right joints.

The world is reflected in a vertical plane through the origin. The frame of each joint becomes the mirror image of
its twin's frame. A mirror image of a frame is left-handed, so it is reflected again, by signs of the joint: with the
world's reflection M and R(j) = diag(+-1, +-1, +-1) of determinant -1, the mirrored global rotation of joint j is
M G(twin) R(j), and its local rotation is R(parent) L(twin) R(j). With signs that map the bones of one side to those
of the other, all positions are exactly mirrored if both sides have equal lengths.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import Array
from motionkit.errors import MotionkitError, OverwriteError, SkeletonError
from motionkit.files import check_outputs, files_below
from motionkit.motion.bvh import BvhFile, bvh_to_motion, motion_to_bvh, read_bvh, write_bvh
from motionkit.motion.bvh_text import read_hierarchy
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rig_shape import twins_by_shape
from motionkit.motion.rotations import mean_rotation, quat_angle, quat_multiply
from motionkit.motion.sides import LEFT_WORDS, LONG_WORDS, other_side
from motionkit.motion.skeleton import Skeleton
from motionkit.motion.up_axis import up_axis

# How rigs mark a side, from the clearest to the vaguest. A mark counts only if the name with the other side exists
# too, so that names such as "lowerback" or "rib" have no side.
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


def _other_side(match: re.Match[str]) -> str:
    return other_side(match.group())


def _paired_marks(names: Sequence[str]) -> dict[int, tuple[int, bool]]:
    """For each joint with a twin: the twin's index, and whether the joint is a left one."""
    indices = {name: index for index, name in enumerate(names)}
    paired: dict[int, tuple[int, bool]] = {}
    for mark in _SIDE_MARKS:
        for index, name in enumerate(names):
            match = mark.search(name)
            twin = indices.get(mark.sub(_other_side, name)) if match else None
            if match and twin is not None and twin != index and index not in paired and twin not in paired:
                left = match.group().lower() in LEFT_WORDS
                paired[index], paired[twin] = (twin, left), (index, not left)
    return paired


def left_right_twins(names: Sequence[str]) -> tuple[int, ...]:
    """The index of each joint's twin on the other side of the body; central joints are their own twins."""
    paired = _paired_marks(names)
    return tuple(paired[index][0] if index in paired else index for index in range(len(names)))


def joint_sides(names: Sequence[str]) -> tuple[str, ...]:
    """The side of each joint: "left", "right", or "" without a twin."""
    paired = _paired_marks(names)
    return tuple(("left" if paired[i][1] else "right") if i in paired else "" for i in range(len(names)))


# The possible reflections of a joint's frame: of one axis, or of all three, for rigs whose right side is built so
# that equal angles make mirrored poses.
Signs = tuple[float, float, float]
_REFLECTIONS: tuple[Signs, ...] = ((-1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, -1.0), (-1.0, -1.0, -1.0))
# A bone votes against a reflection if its error, as a share of its length, exceeds another reflection's by this much;
# the sides of real subjects differ by far less.
_SPEAKS_AGAINST = 0.5
# Share of bones that must vote against it; a single prop or mesh node does not count as the rig.
_ODD_SHARE = 0.15
# Bones shorter than this share of the mean bone do not vote: their direction is noise.
_SHORT_SHARE = 0.05
# A joint whose place varies by less than this share of the mean bone is at the end of a rigid bone.
_RIGID_SHARE = 0.01
_SAMPLES = 32  # poses that show the shape of a rig without names


@dataclass(frozen=True)
class MirrorPlan:
    """How to mirror a rig: the twin and the reflection of each joint, and the reflection of the world."""

    twins: tuple[int, ...]
    world: Signs
    joints: tuple[Signs, ...]

    def outer(self, skeleton: Skeleton, joint: int) -> Signs:
        """The reflection on the parent's side of a joint."""
        return self.joints[skeleton.parents[joint]] if joint else self.world


def mirror_plan(motion: Motion) -> MirrorPlan:
    """Find twins by name, or by shape where no name has a side, and reflections by rest pose and mean pose.

    The plan of a motion and of its mirror image are equal.

    Raises:
        SkeletonError: the rig has no left and right, or its sides have different hierarchies.
    """
    skeleton = motion.skeleton
    twins = _checked_twins(motion)
    places, rigid = _mean_places(motion)
    axis = _common_axis(twins, places, rigid)
    up = int(np.abs(up_axis(motion_kinematics(motion)[1], skeleton)).argmax())
    world = _REFLECTIONS[2 if up == 0 else 0]  # level, whatever the rig
    if axis is not None:
        signs = _REFLECTIONS[axis]
        return MirrorPlan(twins, world if axis == up else signs, (signs,) * len(skeleton))
    return MirrorPlan(twins, world, _own_reflections(motion, twins, places, rigid, world))


def _checked_twins(motion: Motion) -> tuple[int, ...]:
    names, parents = motion.skeleton.names, motion.skeleton.parents
    twins = left_right_twins(names)
    if all(twin == joint for joint, twin in enumerate(twins)):
        found = twins_by_shape(motion.skeleton, motion_kinematics(_some_poses(motion))[1])
        if found is None:
            some = ", ".join(names[:6]) + (", ..." if len(names) > 6 else "")
            raise SkeletonError(
                "no joint name has a left and a right, expected some such as LeftArm, and the rig does not have "
                f"the shape of a human; found {some}"
            )
        twins = found
    for joint, twin in enumerate(twins):
        if twin == joint:
            continue
        parent, other = parents[joint], parents[twin]
        if parent < 0 or other < 0 or twins[parent] != other:
            hangs = [names[p] if p >= 0 else "nothing" for p in (parent, other)]
            raise SkeletonError(
                f"{names[joint]} has the parent {hangs[0]} but {names[twin]} has {hangs[1]}; "
                "mirroring needs the same hierarchy on both sides"
            )
    return twins


def _some_poses(motion: Motion) -> Motion:
    """A few frames from all over a motion, which show the shape of its rig."""
    some = slice(None, None, max(1, len(motion) // _SAMPLES))
    places = None if motion.local_positions is None else motion.local_positions[some]
    return replace(
        motion,
        local_rotations=motion.local_rotations[some],
        root_positions=motion.root_positions[some],
        local_positions=places,
    )


def _mean_places(motion: Motion) -> tuple[Array, tuple[bool, ...]]:
    """Mean positions (J, 3) in parent space, and whether each joint stays at its position."""
    count = len(motion.skeleton)
    if motion.local_positions is None:
        return motion.skeleton.offsets.astype(np.float64), (False,) + (True,) * (count - 1)
    places = motion.local_positions.astype(np.float64)
    mean = places.mean(axis=0)
    size = float(np.linalg.norm(mean[1:], axis=-1).mean()) if count > 1 else 1.0
    wander = np.linalg.norm(places - mean, axis=-1).max(axis=0)
    return mean, (False, *(bool(w < _RIGID_SHARE * size) for w in wander[1:]))


def _common_axis(twins: tuple[int, ...], places: Array, rigid: tuple[bool, ...]) -> int | None:
    """The axis along which all bones mirror their twins; None for a rig whose joints have individual axes."""
    own = places[[joint for joint, stays in enumerate(rigid) if stays]]
    other = places[[twins[joint] for joint, stays in enumerate(rigid) if stays]]
    reflections = np.array(_REFLECTIONS, own.dtype)
    misses = np.linalg.norm(own - other * reflections[:, None], axis=-1)
    axis = int(misses[:3].sum(axis=-1).argmin())
    length = np.maximum(np.linalg.norm(own, axis=-1), np.linalg.norm(other, axis=-1))
    against = misses[axis] > misses.min(axis=0) + _SPEAKS_AGAINST * length
    heard = length > _SHORT_SHARE * length.mean() if length.size else length > 0.0
    return None if int((against & heard).sum()) > _ODD_SHARE * int(heard.sum()) else axis


def _own_reflections(
    motion: Motion, twins: tuple[int, ...], places: Array, rigid: tuple[bool, ...], world: Signs
) -> tuple[Signs, ...]:
    """The reflection of each joint that best maps its twin's bones and mean rotation to its own.

    Bones do not determine the rotation about themselves. A reflection that is wrong there turns the mean pose by
    half a turn, which no natural asymmetry does.
    """
    skeleton = motion.skeleton
    rotations = motion.local_rotations.astype(np.float64)
    means = mean_rotation(np.einsum("tji,tjk->jik", rotations, rotations))
    found: list[Signs] = []
    for joint, parent in enumerate(skeleton.parents):
        twin = twins[joint]
        if twin < joint:
            found.append(found[twin])
            continue
        outer = found[parent] if joint else world
        known = not joint or not rigid[joint]  # a joint that travels has no meaningful mean rotation
        costs = []
        # The parent's reflection comes first, so that it wins ties.
        for signs in sorted(_REFLECTIONS, key=lambda candidate: candidate != outer):
            bones = _bone_misfit(skeleton, joint, signs, twins, places, rigid)
            turned = reflect_rotations(means[twin], outer, signs)
            pose = 0.0 if known else float(quat_angle(means[joint], turned)) / np.pi
            costs.append((bones + 0.5 * pose, signs))
        best = min(cost for cost, _ in costs)
        found.append(next(signs for cost, signs in costs if cost <= best + 1e-3))
    return tuple(found)


def _bone_misfit(
    skeleton: Skeleton,
    joint: int,
    signs: Signs,
    twins: tuple[int, ...],
    places: Array,
    rigid: tuple[bool, ...],
) -> float:
    """The difference of the bones below a joint from their reflected twins, as a share of their length."""
    twin = twins[joint]
    below = [child for child in skeleton.children(joint) if rigid[child]]
    pairs = [(places[child], places[twins[child]]) for child in below]
    if not joint and all(twins[child] == child for child in below):
        return 0.0  # the place of the hips above a root on the floor says nothing about left and right
    if joint in skeleton.end_sites and twin in skeleton.end_sites:
        own, other = (np.array(skeleton.end_sites[j], places.dtype) for j in (joint, twin))
        pairs.append((own, other))
    reflection = np.array(signs, places.dtype)
    length = sum(float(np.linalg.norm(own)) for own, _ in pairs)
    return sum(float(np.linalg.norm(own - reflection * other)) for own, other in pairs) / max(length, 1e-9)


def reflect_rotations(quat: Array, outer: Signs, inner: Signs) -> Array:
    """The rotations (..., 4) diag(outer) q diag(inner) for unit quaternions q (..., 4)."""
    conjugated = quat * np.array([1.0, *(-sign for sign in outer)], quat.dtype)
    half_turn = _half_turn_axis(outer, inner)
    if half_turn is None:
        return conjugated
    turn = np.zeros(4, quat.dtype)
    turn[1 + half_turn] = 1.0
    return quat_multiply(conjugated, np.broadcast_to(turn, conjugated.shape))


def _half_turn_axis(outer: Signs, inner: Signs) -> int | None:
    """The axis of the half turn diag(outer) diag(inner), or None if both are equal."""
    return None if outer == inner else [a * b for a, b in zip(outer, inner, strict=True)].index(1.0)


def mirror_motion(motion: Motion) -> Motion:
    """Mirror a motion: left and right swapped, on the same skeleton, for any rig with left and right joints.

    The world is reflected along the rig's left-right axis, which is X for the canonical skeleton.

    Raises:
        SkeletonError: the rig has no left and right.
    """
    plan = mirror_plan(motion)
    skeleton, twins = motion.skeleton, plan.twins
    rotations = [
        reflect_rotations(motion.local_rotations[:, twin], plan.outer(skeleton, joint), plan.joints[joint])
        for joint, twin in enumerate(twins)
    ]
    world = np.array(plan.world, motion.root_positions.dtype)
    places = motion.local_positions
    if places is not None:
        signs = np.array([plan.outer(skeleton, j) for j in range(len(twins))], places.dtype)
        places = places[:, list(twins)] * signs
    return replace(
        motion,
        local_rotations=np.stack(rotations, axis=1),
        root_positions=motion.root_positions * world,
        local_positions=places,
    )


def mirror_bvh(bvh: BvhFile) -> BvhFile:
    """Mirror a BVH file: left and right swapped, with the same hierarchy and channels.

    If twins have their channels in the same order, angles only change signs or shift by half turns, so mirroring
    twice restores the file.

    Raises:
        SkeletonError: the rig has no left and right, or twins have different channels.
    """
    motion = bvh_to_motion(bvh)
    plan = mirror_plan(motion)
    columns = bvh.columns()
    values = np.empty_like(bvh.values)
    rebuilt: BvhFile | None = None
    for joint, twin in enumerate(plan.twins):
        names, twin_names = bvh.channels[joint], bvh.channels[twin]
        _check_channels(bvh, joint, twin)
        outer = plan.outer(bvh.skeleton, joint)
        source = dict(zip(twin_names, columns[twin], strict=True))
        for name, column in zip(names, columns[joint], strict=True):
            if name.endswith("position"):
                values[:, column] = outer["XYZ".index(name[0])] * bvh.values[:, source[name]]
        own = [c for n, c in zip(names, columns[joint], strict=True) if n.endswith("rotation")]
        theirs = [c for n, c in zip(twin_names, columns[twin], strict=True) if n.endswith("rotation")]
        order = _rotation_order(names)
        if order == _rotation_order(twin_names):
            turned = _reflect_angles(bvh.values[:, theirs], order, outer, plan.joints[joint])
            if turned is None:
                raise SkeletonError(
                    f"{bvh.skeleton.names[joint]} has only the rotation channels {order or 'none'}; "
                    "its mirror image needs all three"
                )
            values[:, own] = turned
        else:
            rebuilt = rebuilt or motion_to_bvh(mirror_motion(motion), bvh.channels)
            values[:, own] = rebuilt.values[:, own]
    return replace(bvh, values=values)


def _rotation_order(channels: tuple[str, ...]) -> str:
    return "".join(name[0] for name in channels if name.endswith("rotation"))


def _check_channels(bvh: BvhFile, joint: int, twin: int) -> None:
    own, other = bvh.channels[joint], bvh.channels[twin]
    whole = len(_rotation_order(own)) == 3 or _rotation_order(own) == _rotation_order(other)
    if set(own) != set(other) or not whole:
        names = bvh.skeleton.names
        raise SkeletonError(
            f"{names[joint]} has the channels {' '.join(own) or 'none'} but {names[twin]} "
            f"{' '.join(other) or 'none'}; mirroring needs the same on both sides"
        )


def _reflect_angles(
    angles: NDArray[np.float64], order: str, outer: Signs, inner: Signs
) -> NDArray[np.float64] | None:
    """Euler angles (T, len(order)) in degrees of diag(outer) q diag(inner), or None if order has too few axes.

    A reflection multiplies an angle about axis k by -outer[k]. A half turn after the rotation commutes past the
    angles that follow its axis and negates them. A half turn about the middle axis is expressed by half turns about
    the other two, so that the middle angle stays within a quarter turn.
    """
    signs = np.array([-outer["XYZ".index(axis)] for axis in order])
    half_turn = _half_turn_axis(outer, inner)
    if half_turn is None:
        return angles * signs
    if len(order) != 3:
        return None
    at = order.index("XYZ"[half_turn])
    signs = signs * np.array([(1.0, -1.0, -1.0), (1.0, -1.0, -1.0), (1.0, 1.0, 1.0)][at])
    turned = angles * signs
    for column in ((0,), (0, 2), (2,))[at]:
        turned[:, column] += _half_turn_shift(angles[:, column], signs[column])
    return turned


def _half_turn_shift(angles: NDArray[np.float64], sign: float) -> float:
    """A shift of 180 degrees up or down for a whole column, chosen so that a second shift undoes the first.

    The mean angle selects a half circle. Unreflected angles move up from even halves and down from odd ones;
    reflected angles are reflected about the middle of their half.
    """
    mean = float(angles.mean())
    if sign > 0:
        return 180.0 if np.floor(mean / 180.0 + 0.5) % 2 == 0 else -180.0
    return 180.0 * (2.0 * np.floor(mean / 180.0) + 1.0)


def mirror_file(source: str | Path, target: str | Path) -> None:
    """Write the mirror image of a BVH file under its hierarchy; raises MotionkitError, naming it, if that cannot be."""
    check_outputs([target], [source])
    bvh = read_bvh(source)
    try:
        mirrored = mirror_bvh(bvh)
    except SkeletonError as error:
        raise SkeletonError(f"{source}: {error}") from None
    if mirrored.skeleton is bvh.skeleton:
        mirrored = replace(mirrored, hierarchy=read_hierarchy(source))
    write_bvh(target, mirrored)


def mirror_folder(
    source: str | Path,
    target: str | Path,
    strict: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[tuple[Path, MotionkitError | None]]:
    """Mirror every BVH file below a folder to the same place below another, one at a time.

    Args:
        source: folder to read.
        target: folder to write, outside source.
        strict: raise the error of a file instead of yielding it.
        progress: called with the number of files done and of all files.

    Yields:
        Each file with None, or with its error if it could not be mirrored.

    Raises:
        OverwriteError: a target is also a source, or lies in it; nothing has been written.
        MotionkitError: there is no BVH file.
    """
    source, target = Path(source), Path(target)
    if target.resolve().is_relative_to(source.resolve()):
        raise OverwriteError(f"{target}: is inside the input folder {source}; choose another output folder")
    found = files_below(source, ".bvh")
    if not found:
        raise MotionkitError(f"{source}: no .bvh files found")
    places = [target / path.relative_to(source) for path in found]
    check_outputs(places, found)
    for done, (path, place) in enumerate(zip(found, places, strict=True)):
        if progress:
            progress(done, len(found))
        try:
            mirror_file(path, place)
        except MotionkitError as error:
            if strict:
                raise
            yield path, error
        else:
            yield path, None
