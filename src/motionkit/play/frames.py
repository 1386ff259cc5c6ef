"""Frames of the session in two encodings: binary for WebSocket, JSON for TCP (docs/live.md)."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motionkit.motion.skeleton import JOINT_COUNT

Floats = NDArray[np.float32]

FRAME_KIND, FRAME_VERSION = 1, 1
HEADER = struct.Struct("<BBHIdff")
RECORD = np.dtype(
    [
        ("id", "<u4"),
        ("seq", "<u4"),
        ("type", "<u2"),
        ("flags", "u1"),
        ("contacts", "u1"),
        ("heading", "<f4"),
        ("root", "<f4", 3),
        ("rotations", "<f4", 4 * JOINT_COUNT),
    ]
)
PERFORMING, FOLLOWING, RECORDING = 1, 2, 4  # bits of the flags of a character
TOUCHES_ABOVE = 0.5  # probability above which a foot joint counts as in contact


@dataclass(frozen=True, eq=False)
class CharacterState:
    """One character in one frame.

    Attributes:
        id: number of the character.
        seq: sequence number of the newest request that affects this frame.
        type: index of the current motion type.
        performing: whether the type is a performance in progress.
        following: fraction of the path covered, None without a path.
        recording: whether the frame is being recorded.
        contacts: (4,) probabilities: left foot, left toe, right foot, right toe.
        heading: radians.
        root: (3,) hip position in the world, cm.
        rotations: (23, 4) local quaternions w, x, y, z.
        positions: (23, 3) joint positions in the world, cm.
    """

    id: int
    seq: int
    type: int
    performing: bool
    following: float | None
    recording: bool
    contacts: Floats
    heading: float
    root: Floats
    rotations: Floats
    positions: Floats


@dataclass(frozen=True, eq=False)
class WorldFrame:
    """One frame of the session.

    Attributes:
        number: frame counter.
        time: seconds since the session began.
        step_ms: time to compute all characters.
        fps: current frame rate.
        characters: all characters.
        arrived: ids of characters that reached the end of their path in this frame.
    """

    number: int
    time: float
    step_ms: float
    fps: float
    characters: tuple[CharacterState, ...]
    arrived: tuple[int, ...] = ()


def frame_bytes(frame: WorldFrame) -> bytes:
    """The binary message of a frame."""
    records = np.zeros(len(frame.characters), RECORD)
    for record, one in zip(records, frame.characters, strict=True):
        touches = one.contacts > TOUCHES_ABOVE
        flags = PERFORMING * one.performing + FOLLOWING * (one.following is not None)
        record["id"], record["seq"], record["type"] = one.id, one.seq, one.type
        record["flags"] = flags + RECORDING * one.recording
        record["contacts"] = int(touches @ (1, 2, 4, 8))
        record["heading"], record["root"], record["rotations"] = (
            one.heading,
            one.root,
            one.rotations.reshape(-1),
        )
    number = frame.number & 0xFFFFFFFF
    header = HEADER.pack(
        FRAME_KIND, FRAME_VERSION, len(records), number, frame.time, frame.step_ms, frame.fps
    )
    return header + records.tobytes()


# Additional fields of a character in JSON frames, such as its pose on a user's rig; may be empty.
Extra = Callable[[CharacterState], dict[str, Any]]


def frame_text(frame: WorldFrame, types: tuple[str, ...], extra: Extra | None = None) -> str:
    """The JSON event of a frame."""
    event = {
        "event": "frame",
        "frame": frame.number,
        "time": round(frame.time, 6),
        "step_ms": round(frame.step_ms, 3),
        "fps": round(frame.fps, 2),
        "characters": [
            _character_event(one, types) | (extra(one) if extra else {}) for one in frame.characters
        ],
    }
    return json.dumps(event, allow_nan=False, separators=(",", ":"))


def _character_event(one: CharacterState, types: tuple[str, ...]) -> dict[str, Any]:
    return {
        "id": one.id,
        "seq": one.seq,
        "type": types[one.type],
        "performing": one.performing,
        "following": None if one.following is None else round(one.following, 4),
        "recording": one.recording,
        "contacts": rounded(one.contacts, 3),
        "heading": round(one.heading, 5),
        "root": rounded(one.root, 3),
        "rotations": rounded(one.rotations, 6),
        "positions": rounded(one.positions, 3),
    }


def rounded(values: Floats, digits: int) -> list:
    """An array as nested lists of rounded numbers."""
    return np.round(values.astype(np.float64), digits).tolist()
