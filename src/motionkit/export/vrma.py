"""Writes motions as VRM animations (.vrma) for VRM avatars: binary glTF with VRMC_vrm_animation 1.0.

The rest pose of the file is a T-pose that faces +Z with its soles on the floor. Players use rotations relative to it
and the hips' translation relative to its height; they ignore everything else.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from motionkit.arrays import Array
from motionkit.export.clip import Clip
from motionkit.export.glb import add_animation, add_joints
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    quat_between,
    quat_continuous,
    quat_inverse,
    quat_multiply,
    quat_normalize,
    quat_rotate,
)
from motionkit.motion.skeleton import (
    JOINT_NAMES,
    PARENTS,
    STANDING_HEIGHTS,
    Skeleton,
    canonical_skeleton,
    leg_length,
)
from motionkit.rig.canonical import canonical_motion
from motionkit.rig.gltf import GltfDocument
from motionkit.rig.gltf_nodes import VRM_BONES
from motionkit.rig.standing_pose import standing_turns
from motionkit.rig.upright import AS_BROUGHT, in_metres

EXTENSION = "VRMC_vrm_animation"
CM = 0.01
# Canonical joint -> bone of a VRM humanoid. Neck1 has none: the neck bone ends at the head.
BONES: dict[str, str] = {ours: bone for bone, ours in VRM_BONES.items()} | {
    "LowerBack": "spine", "Spine": "chest", "Spine1": "upperChest", "Neck": "neck",
    "LeftShoulder": "leftShoulder", "RightShoulder": "rightShoulder",
}  # fmt: skip


def write_vrma(path: str | Path, clip: Clip) -> None:
    """Write a motion of a human rig as a .vrma file, atomically; raises SkeletonError for other rigs."""
    brought = in_metres(clip.motion).motion.scaled(1.0 / CM)
    with AS_BROUGHT():
        motion = humanoid_motion(canonical_motion(brought, own_body=True))
    document = GltfDocument()
    rest = motion.skeleton.offsets.copy()
    rest[0, 1] = hips_height(motion.skeleton)
    joints = add_joints(document, motion.skeleton, rest)
    bones = {BONES[name]: {"node": joints[i]} for i, name in enumerate(motion.skeleton.names)}
    document.json |= {
        "extensionsUsed": [EXTENSION],
        "extensions": {EXTENSION: {"specVersion": "1.0", "humanoid": {"humanBones": bones}}},
        "scenes": [{"name": clip.name, "nodes": [joints[0]]}],
        "scene": 0,
    }
    rotations = quat_continuous(quat_normalize(motion.local_rotations.astype(np.float64)))
    add_animation(document, clip, joints, rotations, {0: motion.root_positions})
    document.write(path)


def joints_kept() -> list[int]:
    """Indices of the canonical joints that a VRM humanoid has."""
    return [joint for joint, name in enumerate(JOINT_NAMES) if name in BONES]


def humanoid_motion(motion: Motion) -> Motion:
    """A canonical motion in cm, converted to a VRM humanoid in metres whose rest pose is a T-pose."""
    poses = standing_turns()
    rotations, positions = motion_kinematics(motion)
    neck, head = JOINT_NAMES.index("Neck"), JOINT_NAMES.index("Head")
    rest = motion.skeleton.rest_positions()
    along = quat_rotate(rotations[:, neck], np.broadcast_to(rest[head] - rest[neck], positions[:, 0].shape))
    rotations = rotations.copy()
    towards = quat_between(along, positions[:, head] - positions[:, neck])
    rotations[:, neck] = quat_multiply(towards, rotations[:, neck])
    turned = quat_multiply(rotations, np.broadcast_to(quat_inverse(poses), rotations.shape))
    places = _posed(motion.skeleton, poses)
    kept = joints_kept()
    parents: list[int] = []
    for joint in kept:
        above = PARENTS[joint]
        while above >= 0 and above not in kept:
            above = PARENTS[above]
        parents.append(above)
    local = turned[:, kept].copy()
    local[:, 1:] = quat_multiply(quat_inverse(turned[:, parents[1:]]), local[:, 1:])
    offsets = np.stack(
        [
            places[j] - places[above] if above >= 0 else places[j]
            for j, above in zip(kept, parents, strict=True)
        ]
    )
    skeleton = Skeleton(
        tuple(JOINT_NAMES[joint] for joint in kept),
        tuple(kept.index(above) if above >= 0 else -1 for above in parents),
        (offsets * CM).astype(np.float32),
    )
    return replace(
        motion,
        skeleton=skeleton,
        local_rotations=quat_continuous(quat_normalize(local)),
        root_positions=motion.root_positions * CM,
        local_positions=None,
    )


def hips_height(skeleton: Skeleton) -> float:
    """Height of the hips above the soles in the T-pose of a humanoid skeleton, in the skeleton's unit."""
    places = skeleton.rest_positions()
    ankle = STANDING_HEIGHTS[0] * leg_length(skeleton) / leg_length(canonical_skeleton())
    return float(ankle - places[skeleton.index("LeftFoot")][1])


def _posed(skeleton: Skeleton, poses: Array) -> Array:
    """Joint positions (23, 3) for global rotations (23, 4), with the root at the origin."""
    places = np.zeros_like(skeleton.offsets)
    for joint, parent in enumerate(PARENTS):
        if parent >= 0:
            places[joint] = places[parent] + quat_rotate(poses[parent], skeleton.offsets[joint])
    return places
