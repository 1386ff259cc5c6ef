"""Reads any BVH file as a motion on the canonical joints, with notes on the conversion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from motionkit.errors import naming
from motionkit.motion.bvh import BvhFile, bvh_to_motion, motion_to_bvh
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS, Skeleton, leg_length
from motionkit.reading import user_cm
from motionkit.rig.read_file import read_file
from motionkit.rig.retarget import RetargetReport, retarget
from motionkit.rig.units import LONGEST_LEG, PLAUSIBLE_LEG, SHORTEST_LEG, guess_scale


def load_canonical(
    path: str | Path, scale: float | None = None, fps: float | None = None
) -> tuple[Motion, list[str]]:
    """Read a file as a motion on the 23 canonical joints, in cm at the file's rate; also returns notes.

    A file that already has the 23 joints keeps its proportions, and is in cm if its legs have a plausible length. Any
    other rig is retargeted.

    Args:
        path: BVH file or .glb or .vrm of any rig.
        scale: cm per file unit; detected by default.
        fps: frame rate, if the file's header is wrong.

    Raises:
        BvhError: the file is invalid.
        SkeletonError: the rig cannot be retargeted.
    """
    with naming(path):
        return canonical_with_notes(read_file(path), Path(path).name, scale, fps)


def canonical_with_notes(
    bvh: BvhFile, name: str, scale: float | None = None, fps: float | None = None
) -> tuple[Motion, list[str]]:
    """Like load_canonical, of a file that was read; name is for the notes."""
    order = _canonical_order(bvh.skeleton)
    if order is None:
        motion, report = retarget(bvh, scale, fps)
        return motion, _mapping_notes(name, report)
    motion = _reordered(bvh_to_motion(bvh, fps=fps), order)
    known_cm = scale or user_cm()
    unit, notes = (known_cm, []) if known_cm else _detected_unit(name, motion.skeleton)
    motion = motion.scaled(unit) if unit != 1.0 else motion
    leg = leg_length(motion.skeleton)
    if not PLAUSIBLE_LEG[0] <= leg <= PLAUSIBLE_LEG[1]:
        notes.append(f"{name}: legs of {leg:.3g} cm; give the right scale with --scale")
    return motion, notes


def _detected_unit(name: str, skeleton: Skeleton) -> tuple[float, list[str]]:
    """Detect cm per unit of a file with the canonical joints, with a note if that is not 1."""
    leg = leg_length(skeleton)
    if PLAUSIBLE_LEG[0] <= leg <= PLAUSIBLE_LEG[1] or not SHORTEST_LEG <= leg <= LONGEST_LEG:
        return 1.0, []
    scale, source = guess_scale(leg, skeleton.cm)
    return scale, [f"{name}: 1 unit = {scale:.4g} cm ({source})"]


def canonical_motion(motion: Motion, own_body: bool = False, scale: float | None = None) -> Motion:
    """Convert a motion of any human rig to the 23 canonical joints, in cm, at its own rate.

    A motion that already has the 23 joints must be in cm; it keeps its proportions.

    Args:
        own_body: keep the bone lengths of other rigs too.
        scale: cm per unit of other rigs; detected by default.

    Raises:
        SkeletonError: the rig cannot be retargeted.
    """
    order = _canonical_order(motion.skeleton)
    if order is not None:
        return _reordered(motion, order)
    return retarget(motion_to_bvh(motion), scale, own_body=own_body)[0]


def _mapping_notes(name: str, report: RetargetReport) -> list[str]:
    notes = list(report.notes)
    if abs(report.root_scale - 1.0) > 0.01:
        notes.insert(0, f"root path times {report.root_scale:.3f} for the canonical leg length")
    return [f"{name}: {note}" for note in notes]


def _canonical_order(skeleton: Skeleton) -> list[int] | None:
    """The index of each canonical joint in a skeleton with the same joints and hierarchy, else None."""
    if set(skeleton.names) != set(JOINT_NAMES) or len(skeleton) != JOINT_COUNT:
        return None
    for joint, name in enumerate(JOINT_NAMES):
        parent = skeleton.parents[skeleton.index(name)]
        if (skeleton.names[parent] if parent >= 0 else None) != (
            JOINT_NAMES[PARENTS[joint]] if joint else None
        ):
            return None
    return [skeleton.index(name) for name in JOINT_NAMES]


def _reordered(motion: Motion, order: list[int]) -> Motion:
    return replace(
        motion,
        skeleton=motion.skeleton.picked(order),
        local_rotations=motion.local_rotations[:, order],
        local_positions=None if motion.local_positions is None else motion.local_positions[:, order],
    )
