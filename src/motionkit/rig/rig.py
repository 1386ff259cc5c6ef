"""A user's rig: the joints, channels, unit and axes that motion on it must keep, and how it relates to the canonical.

to_rig puts motion on it; retarget reads motion from it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import SkeletonError
from motionkit.motion.bvh import BvhFile, read_bvh
from motionkit.motion.bvh_text import read_hierarchy
from motionkit.motion.skeleton import Skeleton, canonical_skeleton, leg_length
from motionkit.rig.map_file import read_rig_map
from motionkit.rig.names import RigMap
from motionkit.rig.pose import RigPose, map_file, median_offsets, pose_notes, study_rig
from motionkit.rig.rest_pose import SIDES
from motionkit.rig.units import check_leg

# Heights in cm of the canonical body at which toes, or ankles of a rig without toes, can stand. A file whose lowest
# joints are elsewhere has its floor elsewhere.
_PLAUSIBLE_STANCE = {"ToeBase": (0.0, 6.0), "Foot": (4.0, 12.0)}
STANCE_QUANTILE = 0.25  # of heights: low, but robust to feet that sink now and then
_UPRIGHT_SHARE = 0.5  # of the leg; ankles of a standing body are this far below the hips
_SAME_REST = 0.01  # share of the leg by which offsets of the same rig may differ
_FRAMES = 512  # of a rig's own motion that are looked at


@dataclass(frozen=True, eq=False)
class Rig:
    """A rig to put motion on.

    Attributes:
        name: the file, for messages.
        skeleton: all its joints in file order, in file units and axes.
        channels: the channel names of each joint.
        hierarchy: the text of the file's hierarchy section, None for a rig that is not from a BVH file.
        joints: its canonical joints.
        up: (3,) its up axis.
        differences: (23, 4) rotations from canonical rest directions to its own (rest_pose).
        leg: thigh plus shin in file units.
        stance: height of its standing toes, or of its ankles if it has no toes, in cm of a body with canonical legs;
            None if its file does not show it.
        fps: frame rate of its file.
        notes: what is unusual about it.
    """

    name: str
    skeleton: Skeleton
    channels: tuple[tuple[str, ...], ...]
    hierarchy: str | None
    joints: RigMap
    up: Array
    differences: Array
    leg: float
    stance: float | None
    fps: float
    notes: tuple[str, ...]

    @property
    def scale(self) -> float:
        """cm of a body with canonical legs per file unit."""
        return leg_length(canonical_skeleton()) / self.leg

    def same_rest(self, skeleton: Skeleton) -> bool:
        """Whether a skeleton has the same joints and the same rest pose."""
        near = _SAME_REST * self.leg
        return self.skeleton.same_hierarchy(skeleton) and bool(
            np.abs(self.skeleton.offsets[1:] - skeleton.offsets[1:]).max() <= near
        )

    def place(self, name: str) -> int | None:
        """The joint at the place of a canonical joint, or None."""
        return self.joints.places.get(name)


def read_bvh_rig(path: str | Path, map_path: str | Path | None = None) -> Rig:
    """The rig of a BVH file; arguments as for export.on_rig.read_rig, which also reads other files."""
    bvh = read_bvh(path)
    joints = None if map_path is None else read_rig_map(map_path, bvh.skeleton)
    try:
        return make_rig(bvh, Path(path).name, joints, read_hierarchy(path))
    except SkeletonError as error:
        raise SkeletonError(f"{path}: {error}") from None


def make_rig(bvh: BvhFile, name: str, joints: RigMap | None = None, hierarchy: str | None = None) -> Rig:
    """The rig of a BVH file; raises SkeletonError if it is not a human one.

    Args:
        bvh: its joints, and at least one frame.
        name: what to call it in messages.
        joints: its canonical joints; found by default.
        hierarchy: text to write as the hierarchy section of files on this rig.
    """
    bvh = median_offsets(bvh)
    joints = map_file(bvh) if joints is None else joints
    step = max(1, len(bvh.values) // _FRAMES)
    pose = study_rig(BvhFile(bvh.skeleton, bvh.channels, bvh.values[::step], bvh.frame_time), joints)
    leg = pose.leg()
    check_leg(leg)
    if not pose.standing and not _stands_somewhere(pose, leg):
        raise SkeletonError(
            "the rest pose is not a standing human and no frame shows one; "
            "give a file of this rig with a standing pose"
        )
    _check_channels(bvh, joints)
    scale = leg_length(canonical_skeleton()) / leg
    return Rig(
        name,
        bvh.skeleton,
        bvh.channels,
        hierarchy,
        joints,
        pose.up,
        pose.differences,
        leg,
        _stance(pose, scale),
        bvh.fps,
        pose_notes(pose),
    )


def _stands_somewhere(pose: RigPose, leg: float) -> bool:
    """Whether the feet are well below the hips, and the shoulders above them, in some frames."""
    place, at = pose.source.rig.places, pose.positions[..., 1]
    if not all(f"{side}Foot" in place for side in SIDES):
        return True
    hips, feet, arms = (
        at[:, [place[f"{side}{part}"] for side in SIDES]].mean(1) for part in ("UpLeg", "Foot", "Arm")
    )
    return bool(((hips - feet > _UPRIGHT_SHARE * leg) & (arms > hips)).any())


def _check_channels(bvh: BvhFile, joints: RigMap) -> None:
    """Raise SkeletonError for a rig whose channels cannot hold a motion."""
    names = bvh.skeleton.names
    for name, joint in joints.places.items():
        count = sum(channel.endswith("rotation") for channel in bvh.channels[joint])
        limb = name.endswith(("UpLeg", "Leg", "Arm")) or name == "Hips"
        if count not in (0, 3) or (limb and count == 0):
            raise SkeletonError(f"{names[joint]} ({name}) has {count} rotation channels, expected 3")
    if mover(bvh.skeleton, bvh.channels, joints) is None:
        raise SkeletonError(
            f"no joint from {names[0]} to {names[joints.places['Hips']]} has three position channels, "
            "so the body cannot move"
        )


def top_joint(skeleton: Skeleton, joints: RigMap) -> int:
    """The joint that carries the whole body: the hips, or one above them if the spine hangs from there."""
    joint = joints.places["Hips"]
    while not all(skeleton.descends(other, joint) for other in joints.places.values()):
        joint = skeleton.parents[joint]
    return joint


def mover(skeleton: Skeleton, channels: tuple[tuple[str, ...], ...], joints: RigMap) -> int | None:
    """The joint whose position channels move the body: the top joint or the nearest above it that has three."""
    joint = top_joint(skeleton, joints)
    while joint >= 0:
        if sum(channel.endswith("position") for channel in channels[joint]) == 3:
            return joint
        joint = skeleton.parents[joint]
    return None


def _stance(pose: RigPose, scale: float) -> float | None:
    """The height of the lower foot in most frames, in cm of the canonical body, None if that cannot be a stance."""
    place = pose.source.rig.places
    part = stance_part(pose.source.rig)
    if f"Left{part}" not in place or f"Right{part}" not in place:
        return None
    lower = pose.positions[:, [place[f"{side}{part}"] for side in SIDES], 1].min(axis=1)
    height = float(np.quantile(lower, STANCE_QUANTILE)) * scale
    low, high = _PLAUSIBLE_STANCE[part]
    return height if low <= height <= high else None


def stance_part(joints: RigMap) -> str:
    """The part of the feet whose height says where the floor is: toes, or ankles of a rig without toes."""
    return "ToeBase" if all(f"{side}ToeBase" in joints.places for side in SIDES) else "Foot"
