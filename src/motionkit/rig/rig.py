"""A user's rig: its joints, channels, unit and axes, and how they relate to the canonical skeleton.

to_rig.py puts motion on it; retarget.py reads motion from it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import SkeletonError
from motionkit.motion.bvh import BvhFile
from motionkit.motion.skeleton import Skeleton, canonical_skeleton, leg_length
from motionkit.reading import as_found
from motionkit.rig.character import Character
from motionkit.rig.gltf_nodes import VRM_BONES
from motionkit.rig.names import RigMap
from motionkit.rig.pose import RigPose, map_file, median_offsets, pose_notes, study_rig
from motionkit.rig.rest_pose import SIDES
from motionkit.rig.units import check_leg, rig_unit

# Plausible heights, in cm of the canonical body, of standing toes, or of ankles of a rig without toes. At other heights
# the floor of the file is not at zero.
PLAUSIBLE_STANCE = {"ToeBase": (0.0, 6.0), "Foot": (4.0, 12.0)}
STANCE_QUANTILE = 0.25  # quantile of foot heights: low, but robust to feet that sink now and then
_UPRIGHT_SHARE = 0.5  # share of the leg; the ankles of a standing body are further below the hips
_SAME_REST = 0.01  # share of the leg by which offsets of the same rig may differ
_FRAMES = 512  # frames of the file's motion that are studied; up to twice as many


@dataclass(frozen=True, eq=False)
class Rig:
    """A rig to put motion on.

    Attributes:
        name: name of the file, for messages.
        skeleton: all joints in file order, in file units and axes.
        channels: the channel names of each joint.
        hierarchy: text of the file's hierarchy section; None for a rig that is not from a BVH file.
        joints: map of its canonical joints.
        up: (3,) up axis.
        differences: (23, 4) rotations from canonical to its own rest directions (rest_pose.py).
        leg: thigh plus shin in file units.
        stance: height of standing toes, or of ankles without toes, in cm of a body with canonical legs; None if the
            file does not show it.
        notes: notes on its axes and rest pose.
        character: the .glb or .vrm file that it is from, into which motion on it is written; else None.
        fps: frame rate that readers of it expect; None for any.
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
    notes: tuple[str, ...]
    character: Character | None = None
    fps: float | None = None

    def size(self, body: Skeleton) -> float:
        """The leg length of the rig relative to that of a body in cm: by this the places of a motion on it differ."""
        with as_found():
            return self.leg * rig_unit(self.skeleton, self.leg)[0] / leg_length(body)

    @property
    def scale(self) -> float:
        """cm per file unit of a body with canonical legs."""
        return leg_length(canonical_skeleton()) / self.leg

    @property
    def ending(self) -> str:
        """The ending of files that keep what the rig's file has besides joints: ".vrm", ".glb" or ".bvh"."""
        if self.character is None:
            return ".bvh"
        return ".vrm" if self.name.lower().endswith(".vrm") else ".glb"

    def same_rest(self, skeleton: Skeleton) -> bool:
        """Whether a skeleton has the same joints and the same rest pose."""
        near = _SAME_REST * self.leg
        return self.skeleton.same_hierarchy(skeleton) and bool(
            np.abs(self.skeleton.offsets[1:] - skeleton.offsets[1:]).max() <= near
        )

    def place(self, name: str) -> int | None:
        """The joint mapped to a canonical joint, or None."""
        return self.joints.places.get(name)


def make_rig(bvh: BvhFile, name: str, joints: RigMap | None = None) -> Rig:
    """Make the rig of a BVH file of at least one frame; raises SkeletonError if it is not a human rig.

    The name is for messages. The map of its canonical joints is found by default.
    """
    bvh = median_offsets(bvh)
    joints = map_file(bvh) if joints is None else joints
    step = max(1, len(bvh.values) // _FRAMES)
    pose = study_rig(BvhFile(bvh.skeleton, bvh.channels, bvh.values[::step], bvh.frame_time), joints)
    leg = pose.leg()
    check_leg(leg)
    if not pose.standing and not _has_standing_frame(pose, leg):
        raise SkeletonError(
            "the rest pose is not a standing human and no frame shows one; "
            "give a file of this rig with a standing pose"
        )
    _check_channels(bvh, joints)
    scale = leg_length(canonical_skeleton()) / leg
    skeleton = bvh.skeleton
    if joints.source == "map":  # what is made for the rig keeps what only the user knows
        known = {ours: joints.places[ours] for ours in VRM_BONES.values() if ours in joints.places}
        skeleton = replace(skeleton, humanoid=known)
    return Rig(
        name,
        skeleton,
        bvh.channels,
        bvh.hierarchy,
        joints,
        pose.up,
        pose.differences,
        leg,
        _stance(pose, scale),
        pose_notes(pose),
    )


def _has_standing_frame(pose: RigPose, leg: float) -> bool:
    """Whether in some frame the feet are well below the hips, and the shoulders above them."""
    place, at = pose.source.rig.places, pose.positions[..., 1]
    if not all(f"{side}Foot" in place for side in SIDES):
        return True
    hips, feet, arms = (at[:, pose.source.rig.pair(part)].mean(1) for part in ("UpLeg", "Foot", "Arm"))
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
    """The lowest common ancestor of all mapped joints: the hips, or one above them if the spine begins there."""
    path, mapped = skeleton.path(joints.places["Hips"]), joints.places.values()
    return [joint for joint in path if all(skeleton.descends(other, joint) for other in mapped)][-1]


def mover(skeleton: Skeleton, channels: tuple[tuple[str, ...], ...], joints: RigMap) -> int | None:
    """The joint whose position channels move the body: the top joint, or the nearest above it with three of them."""
    path = skeleton.path(top_joint(skeleton, joints))
    found = [joint for joint in path if sum(name.endswith("position") for name in channels[joint]) == 3]
    return found[-1] if found else None


def _stance(pose: RigPose, scale: float) -> float | None:
    """The standing height of toes or ankles, in cm of the canonical body; None if it is not plausible."""
    place = pose.source.rig.places
    part = stance_part(pose.source.rig)
    if f"Left{part}" not in place or f"Right{part}" not in place:
        return None
    lower = pose.positions[:, pose.source.rig.pair(part), 1].min(axis=1)
    height = float(np.quantile(lower, STANCE_QUANTILE)) * scale
    low, high = PLAUSIBLE_STANCE[part]
    return height if low <= height <= high else None


def stance_part(joints: RigMap) -> str:
    """The part of the feet that shows the floor: toes, or ankles of a rig without toes."""
    return "ToeBase" if all(f"{side}ToeBase" in joints.places for side in SIDES) else "Foot"
