"""Frames as VMC messages (OSC over UDP), which game engines can receive."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

import numpy as np

from motionkit.motion.kinematics import forward_kinematics
from motionkit.motion.rotations import matrix_to_quat, quat_inverse, quat_to_matrix
from motionkit.motion.skeleton import JOINT_NAMES, Skeleton
from motionkit.play.frames import CharacterState, Floats
from motionkit.rig.standing_pose import standing_turns

BUNDLE_BYTES = 1400  # fits into one Ethernet frame
_IMMEDIATELY = struct.pack(">Q", 1)  # OSC time tag for "immediately"
CM = 0.01  # m per cm

# Unity's HumanBodyBones: bone, parent bone, and the joint that drives it.
BONES: tuple[tuple[str, str, str], ...] = (
    ("Hips", "", "Hips"),
    ("Spine", "Hips", "Spine"),
    ("Chest", "Spine", "Spine1"),
    ("Neck", "Chest", "Neck"),
    ("Head", "Neck", "Head"),
    *(
        (f"{side}{bone}", f"{side}{parent}" if sided else parent, f"{side}{joint}")
        for side in ("Left", "Right")
        for bone, parent, sided, joint in (
            ("UpperLeg", "Hips", False, "UpLeg"),
            ("LowerLeg", "UpperLeg", True, "Leg"),
            ("Foot", "LowerLeg", True, "Foot"),
            ("Toes", "Foot", True, "ToeBase"),
            ("Shoulder", "Chest", False, "Shoulder"),
            ("UpperArm", "Shoulder", True, "Arm"),
            ("LowerArm", "UpperArm", True, "ForeArm"),
            ("Hand", "LowerArm", True, "Hand"),
        )
    ),
)
_JOINTS = [JOINT_NAMES.index(joint) for _, _, joint in BONES]
_NAMES = [bone for bone, _, _ in BONES]
_PARENTS = [1 + _NAMES.index(parent) if parent else 0 for _, parent, _ in BONES]  # 0 is the root


def osc_string(text: str) -> bytes:
    """An OSC string: padded with zeros to a multiple of four bytes, with at least one."""
    data = text.encode("ascii") + b"\0"
    return data + b"\0" * (-len(data) % 4)


def osc_message(address: str, *arguments: str | int | float) -> bytes:
    """One OSC message; integers are sent as int32, floats as float32."""
    tags, data = ",", b""
    for argument in arguments:
        if isinstance(argument, str):
            tags, data = tags + "s", data + osc_string(argument)
        elif isinstance(argument, int):
            tags, data = tags + "i", data + struct.pack(">i", argument)
        else:
            tags, data = tags + "f", data + struct.pack(">f", argument)
    return osc_string(address) + osc_string(tags) + data


def osc_bundles(messages: Sequence[bytes], most_bytes: int = BUNDLE_BYTES) -> list[bytes]:
    """Pack messages into bundles of at most this many bytes, for immediate execution."""
    head = osc_string("#bundle") + _IMMEDIATELY
    out, current = [], head
    for message in messages:
        element = struct.pack(">i", len(message)) + message
        if len(current) + len(element) > most_bytes and current != head:
            out.append(current)
            current = head
        current += element
    out.append(current)
    return out


class VmcBody:
    """Converts frames of one skeleton to VMC messages."""

    def __init__(self, skeleton: Skeleton) -> None:
        self._skeleton = skeleton
        self._from_rest = quat_to_matrix(quat_inverse(standing_turns()))[_JOINTS]

    def bones(self, state: CharacterState) -> tuple[Floats, Floats]:
        """Positions (1 + B, 3) and rotations (1 + B, 4) of the root and BONES, relative to their parents.

        Axes are right-handed, positions in cm, and rotations relative to the T-pose.
        """
        skeleton = self._skeleton
        rotations, positions = forward_kinematics(
            state.rotations, state.root, skeleton.offsets, skeleton.parents
        )
        half = 0.5 * state.heading
        root_turn = quat_to_matrix(np.array([[math.cos(half), 0.0, math.sin(half), 0.0]], np.float32))
        root_place = state.root * np.array([1.0, 0.0, 1.0], np.float32)
        turns = np.concatenate([root_turn, np.matmul(quat_to_matrix(rotations[_JOINTS]), self._from_rest)])
        places = np.concatenate([root_place[None], positions[_JOINTS]])
        above = np.swapaxes(turns[_PARENTS], -1, -2)  # parents of the bones; the root stays in world space
        inside = np.matmul(above, turns[1:])
        offsets = np.matmul(above, (places[1:] - places[_PARENTS])[..., None])[..., 0]
        return (
            np.concatenate([places[:1], offsets]),
            matrix_to_quat(np.concatenate([turns[:1], inside])),
        )

    def messages(self, state: CharacterState, seconds: float) -> list[bytes]:
        """The OSC messages for one frame."""
        places, rotations = self.bones(state)
        out = [osc_message("/VMC/Ext/OK", 1), osc_message("/VMC/Ext/T", float(seconds))]
        addresses = ["/VMC/Ext/Root/Pos"] + ["/VMC/Ext/Bone/Pos"] * len(_NAMES)
        for address, name, place, turn in zip(addresses, ["root", *_NAMES], places, rotations, strict=True):
            out.append(osc_message(address, name, *_unity(place.tolist(), turn.tolist())))
        return out


def _unity(place: list[float], rotation: list[float]) -> list[float]:
    """Position in metres and quaternion x, y, z, w for Unity. X is mirrored: Unity's points right, ours left."""
    x, y, z = (CM * v for v in place)
    w, qx, qy, qz = rotation
    return [-x, y, z, qx, -qy, -qz, w]
