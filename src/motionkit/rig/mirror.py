"""Mirrors motions, files and folders of any rig with left and right joints: finds its twins and reflections."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import MotionkitError, OverwriteError, SkeletonError
from motionkit.files import check_outputs, files_below
from motionkit.motion.bvh import BvhFile, bvh_to_motion, read_bvh, write_bvh
from motionkit.motion.bvh_text import read_hierarchy
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.mirror import REFLECTIONS, MirrorPlan, Signs, mirrored, mirrored_bvh, reflect_rotations
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import mean_rotation, quat_angle
from motionkit.motion.skeleton import Skeleton
from motionkit.rig.shape import twins_by_shape
from motionkit.rig.sides import left_right_twins
from motionkit.rig.up_axis import up_axis

# A bone votes against a reflection if its error, as a share of its length, exceeds that of another reflection by this
# much. The sides of real subjects differ by far less.
_SPEAKS_AGAINST = 0.5
_ODD_SHARE = 0.15  # share of bones that must vote against it; a single prop or mesh node must not decide
_SHORT_SHARE = 0.05  # of the mean bone; shorter bones do not vote, because their direction is noise
_RIGID_SHARE = 0.01  # of the mean bone; a joint whose position varies by less ends a rigid bone
_SAMPLES = 32  # poses from which a rig without known names is mapped


def mirror_plan(motion: Motion) -> MirrorPlan:
    """Find twins by name, or by shape if no name has a side, and reflections by rest pose and mean pose.

    A motion and its mirror image get the same plan.

    Raises:
        SkeletonError: the rig has no left and right, or its sides have different hierarchies.
    """
    skeleton = motion.skeleton
    twins = _checked_twins(motion)
    places, rigid = _mean_places(motion)
    axis = _common_axis(twins, places, rigid)
    up = int(np.abs(up_axis(motion_kinematics(motion)[1], skeleton)).argmax())
    world = REFLECTIONS[2 if up == 0 else 0]  # a horizontal axis for every rig
    if axis is not None:
        signs = REFLECTIONS[axis]
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
    """About _SAMPLES frames, spread over a motion."""
    some = slice(None, None, max(1, len(motion) // _SAMPLES))
    places = None if motion.local_positions is None else motion.local_positions[some]
    return replace(
        motion,
        local_rotations=motion.local_rotations[some],
        root_positions=motion.root_positions[some],
        local_positions=places,
    )


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


def _common_axis(twins: tuple[int, ...], places: Array, rigid: tuple[bool, ...]) -> int | None:
    """The axis along which all bones mirror their twins; None for a rig whose joints have individual axes."""
    own = places[[joint for joint, stays in enumerate(rigid) if stays]]
    other = places[[twins[joint] for joint, stays in enumerate(rigid) if stays]]
    reflections = np.array(REFLECTIONS, own.dtype)
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
        known = not joint or not rigid[joint]  # the mean rotation of a joint that translates says nothing
        costs = []
        # The parent's reflection comes first, so it wins ties.
        for signs in sorted(REFLECTIONS, key=lambda candidate: candidate != outer):
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
        return 0.0  # an offset from a root on the floor to the hips says nothing about left and right
    if joint in skeleton.end_sites and twin in skeleton.end_sites:
        own, other = (np.array(skeleton.end_sites[j], places.dtype) for j in (joint, twin))
        pairs.append((own, other))
    reflection = np.array(signs, places.dtype)
    length = sum(float(np.linalg.norm(own)) for own, _ in pairs)
    return sum(float(np.linalg.norm(own - reflection * other)) for own, other in pairs) / max(length, 1e-9)


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
        SkeletonError: the rig has no left and right, or twins have different channels.
    """
    return mirrored_bvh(bvh, mirror_plan(bvh_to_motion(bvh)))


def mirror_file(source: str | Path, target: str | Path) -> None:
    """Write the mirror image of a BVH file with its hierarchy text; raises MotionkitError, naming the file."""
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
    """Mirror every BVH file below a folder to the same relative path below another, one at a time.

    Args:
        source: folder to read.
        target: folder to write, outside source.
        strict: raise the error of a file instead of yielding it.
        progress: called with the number of finished files and of all files.

    Yields:
        Each file with None, or with its error if mirroring failed.

    Raises:
        OverwriteError: a target is also a source, or is inside the source folder; nothing is written.
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
