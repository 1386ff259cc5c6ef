"""Rigs and a walk made by formula: naming families, other rest poses, other axes."""

from __future__ import annotations

import math

import numpy as np

from motionkit.arrays import Array
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    expmap_to_quat,
    quat_identity,
    quat_inverse,
    quat_multiply,
    quat_rotate,
)
from motionkit.motion.skeleton import JOINT_NAMES, PARENTS, Skeleton, canonical_skeleton

# How much each limb joint bends about the canonical hinge, in radians at the middle and the swing.
HINGES = {
    "LeftLeg": ((0.93969, 0.34202, 0.0), 0.7, 0.4),
    "RightLeg": ((0.93969, -0.34202, 0.0), 0.7, -0.4),
    "LeftForeArm": ((0.0, -0.86603, 0.5), 0.9, 0.3),
    "RightForeArm": ((0.0, 0.86603, -0.5), 0.9, -0.3),
}
# Brings spread legs together and level arms down, as in standing.
STANCE = {"LeftUpLeg": -20.0, "RightUpLeg": 20.0, "LeftArm": -70.0, "RightArm": 70.0}


def walk(frames: int = 60) -> Motion:
    """Walking in place with small turns: knees and elbows bend, the torso sways."""
    phase = np.arange(frames) * (2 * math.pi / 30.0)
    expmaps = np.zeros((frames, len(JOINT_NAMES), 3), np.float32)
    for name, degrees in STANCE.items():
        expmaps[:, JOINT_NAMES.index(name), 2] = math.radians(degrees)
    turns = quat_identity((frames, len(JOINT_NAMES)))
    for joint, name in enumerate(JOINT_NAMES):
        swing = 0.05 * np.sin(phase[:, None] + np.array([0.0, 1.0, 2.0], np.float32) + joint)
        local = expmap_to_quat(expmaps[:, joint])
        if name in HINGES:
            axis, middle, amount = HINGES[name]
            bend = middle + amount * np.sin(phase)
            local = expmap_to_quat(bend[:, None] * np.array(axis))
        elif name.endswith("UpLeg"):
            side = 1.0 if name.startswith("Left") else -1.0
            stride = np.zeros((frames, 3), np.float32)
            stride[:, 0] = -0.3 + 0.4 * side * np.sin(phase)
            local = quat_multiply(expmap_to_quat(stride), local)
        elif not name.endswith(("ToeBase", "Foot")):
            local = quat_multiply(expmap_to_quat(swing), local)
        turns[:, joint] = local
    roots = np.stack([10.0 * np.sin(phase), 95.0 + np.cos(2 * phase), phase * 3.0], axis=-1)
    return Motion(canonical_skeleton(), turns, roots, 30.0)


def renamed(motion: Motion, names: dict[str, str]) -> Motion:
    """The motion with renamed joints; joints without a new name are dropped with their descendants."""
    keep = [j for j, name in enumerate(JOINT_NAMES) if name in names]
    new = {j: i for i, j in enumerate(keep)}
    parents = []
    turns = []
    for j in keep:
        above, turn = PARENTS[j], motion.local_rotations[:, j]
        while above >= 0 and above not in new:
            turn = quat_multiply(motion.local_rotations[:, above], turn)
            above = PARENTS[above]
        parents.append(new.get(above, -1))
        turns.append(turn)
    rest = motion.skeleton.rest_positions()
    offsets = np.stack(
        [rest[j] - (rest[keep[p]] if p >= 0 else rest[j]) for j, p in zip(keep, parents, strict=True)]
    )
    ends = {}
    for i, j in enumerate(keep):
        if i not in parents:
            below = [k for k in range(len(JOINT_NAMES)) if PARENTS[k] == j]
            end = motion.skeleton.offsets[below[0]].tolist() if below else motion.skeleton.end_sites[j]
            ends[i] = tuple(end)
    skeleton = Skeleton(tuple(names[JOINT_NAMES[j]] for j in keep), tuple(parents), offsets, ends)
    return Motion(skeleton, np.stack(turns, axis=1), motion.root_positions, motion.fps)


def sided(pattern: dict[str, str], left: str, right: str) -> dict[str, str]:
    """Canonical limb names to names in which the side replaces '*'."""
    out = {}
    for part, name in pattern.items():
        out[f"Left{part}"] = name.replace("*", left)
        out[f"Right{part}"] = name.replace("*", right)
    return out


LIMBS = ("UpLeg", "Leg", "Foot", "ToeBase", "Shoulder", "Arm", "ForeArm", "Hand")
TORSO = ("Hips", "LowerBack", "Spine", "Spine1", "Neck", "Neck1", "Head")


def family(torso: str, limbs: str, left: str, right: str) -> dict[str, str]:
    """A name table from two lists of words; '-' leaves a joint out, '_' stands for a space."""
    names = dict(zip(TORSO, torso.split(), strict=True))
    names |= sided(dict(zip(LIMBS, limbs.split(), strict=True)), left, right)
    return {ours: theirs.replace("_", " ") for ours, theirs in names.items() if theirs != "-"}


MIXAMO = (
    "mixamorig:Hips mixamorig:Spine mixamorig:Spine1 mixamorig:Spine2 mixamorig:Neck - mixamorig:Head",
    "mixamorig:*UpLeg mixamorig:*Leg mixamorig:*Foot mixamorig:*ToeBase mixamorig:*Shoulder mixamorig:*Arm "
    "mixamorig:*ForeArm mixamorig:*Hand",
    "Left",
    "Right",
)
FAMILIES: dict[str, dict[str, str]] = {
    "mixamo": family(*MIXAMO),
    "lafan1": family(
        "Hips Spine Spine1 Spine2 Neck - Head",
        "*UpLeg *Leg *Foot *Toe *Shoulder *Arm *ForeArm *Hand",
        "Left",
        "Right",
    ),
    "xsens": family(
        "Pelvis L5 L3 T8 Neck - Head",
        "*UpperLeg *LowerLeg *Foot *Toe *Shoulder *UpperArm *ForeArm *Hand",
        "Left",
        "Right",
    ),
    "100style": family(
        "Hips Chest Chest2 Chest4 Neck - Head",
        "*Hip *Knee *Ankle *Toe *Collar *Shoulder *Elbow *Wrist",
        "Left",
        "Right",
    ),
    "poser": family(
        "hip - abdomen chest neck - head", "*Thigh *Shin *Foot - *Collar *Shldr *ForeArm *Hand", "l", "r"
    ),
    "biped": family(
        "Bip01_Pelvis Bip01_Spine Bip01_Spine1 Bip01_Spine2 Bip01_Neck - Bip01_Head",
        "Bip01_*_Thigh Bip01_*_Calf Bip01_*_Foot Bip01_*_Toe0 Bip01_*_Clavicle Bip01_*_UpperArm "
        "Bip01_*_Forearm Bip01_*_Hand",
        "L",
        "R",
    ),
    "bandai-namco": family(
        "Hips - Spine Chest Neck - Head",
        "UpperLeg@* LowerLeg@* Foot@* Toes@* Shoulder@* UpperArm@* LowerArm@* Hand@*".replace("@", "~"),
        "L",
        "R",
    ),
    "motionbuilder": family(
        "Character1~Hips - Character1~Spine Character1~Spine1 Character1~Neck - Character1~Head",
        "Character1~*UpLeg Character1~*Leg Character1~*Foot Character1~*ToeBase Character1~*Shoulder "
        "Character1~*Arm Character1~*ForeArm Character1~*Hand",
        "Left",
        "Right",
    ),
    "rokoko": family(
        "Hips Spine1 Spine2 Spine3 Neck - Head",
        "*Thigh *Shin *Foot *Toe *Shoulder *Arm *ForeArm *Hand",
        "Left",
        "Right",
    ),
    "deepmimic": family(
        "root - - chest neck - -", "*hip *knee *ankle - - *shoulder *elbow -", "left~", "right~"
    ),
    "smpl": family(
        "Pelvis Spine1 Spine2 Spine3 Neck - Head",
        "*Hip *Knee *Ankle *Foot *Collar *Shoulder *Elbow *Wrist",
        "L~",
        "R~",
    ),
    "unreal": family(
        "pelvis spine~01 spine~02 spine~03 neck~01 - head",
        "thigh~* calf~* foot~* ball~* clavicle~* upperarm~* lowerarm~* hand~*",
        "l",
        "r",
    ),
    "blender": family(
        "spine spine.001 spine.002 spine.003 spine.004 spine.005 head",
        "thigh.* shin.* foot.* toe.* shoulder.* upper~arm.* forearm.* hand.*",
        "L",
        "R",
    ),
    "upper-case": family(
        "HIPS LOWERBACK SPINE CHEST NECK - HEAD",
        "*THIGH *SHIN *FOOT *TOE *CLAVICLE *UPPERARM *FOREARM *HAND",
        "L~",
        "R~",
    ),
}
FAMILIES = {
    key: {ours: theirs.replace("~", "_") for ours, theirs in names.items()} for key, names in FAMILIES.items()
}


def turned_rest(motion: Motion, changes: Array) -> Motion:
    """The same movement with each joint's axes turned by changes (J, 4): another rest pose."""
    rotations, _ = motion_kinematics(motion)
    back = quat_inverse(changes)
    globals_ = quat_multiply(rotations, np.broadcast_to(back, rotations.shape))
    parents = list(motion.skeleton.parents[1:])
    offsets = motion.skeleton.offsets.copy()
    offsets[1:] = quat_rotate(changes[parents], offsets[1:])
    local = globals_.copy()
    local[:, 1:] = quat_multiply(quat_inverse(globals_[:, parents]), globals_[:, 1:])
    ends = {}
    for joint, end in motion.skeleton.end_sites.items():
        x, y, z = quat_rotate(changes[joint], np.array(end)).tolist()
        ends[joint] = (x, y, z)
    skeleton = Skeleton(motion.skeleton.names, motion.skeleton.parents, offsets, ends)
    return Motion(skeleton, local, motion.root_positions, motion.fps)
