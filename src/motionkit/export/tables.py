"""Writes motions as arrays (.npz) and tables (.csv): positions in cm with Y up, rotations, contacts, types."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import SkeletonError
from motionkit.export.clip import Clip
from motionkit.files import atomic_write
from motionkit.motion.contacts import foot_contacts
from motionkit.motion.floor import floor_shift
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import FOOT_JOINTS, JOINT_NAMES
from motionkit.rig.canonical import canonical_motion
from motionkit.rig.upright import AS_BROUGHT, in_metres

# Numbers of a joint in a table: three of a place in cm, four of a rotation.
_SHORT = ("{:.4f}".format,) * 3 + ("{:.6g}".format,) * 4
CONTACT_NAMES = tuple(JOINT_NAMES[joint] for joint in FOOT_JOINTS)


def write_npz(path: str | Path, clip: Clip) -> None:
    """Write a motion of any rig as numpy arrays, atomically; docs/clips.md lists the arrays."""
    motion = in_metres(clip.motion).motion.scaled(100.0)
    rotations, positions = motion_kinematics(motion)
    arrays: dict[str, Any] = {
        "fps": np.float64(motion.fps),
        "joints": np.array(motion.skeleton.names),
        "parents": np.array(motion.skeleton.parents),
        "offsets": motion.skeleton.offsets,
        "end_joints": np.array(list(motion.skeleton.end_sites), np.int64),
        "end_offsets": np.array(list(motion.skeleton.end_sites.values()), np.float32).reshape(-1, 3),
        "local_rotations": motion.local_rotations,
        "root_positions": motion.root_positions,
        "rotations": rotations,
        "positions": positions,
        "contacts": contacts(clip.motion),
        "contact_joints": np.array(CONTACT_NAMES),
        "types": np.array(frame_types(clip)),
    }
    if motion.local_positions is not None:
        arrays["local_positions"] = motion.local_positions
    with atomic_write(path, "wb") as file:
        np.savez_compressed(file, **arrays)


def write_csv(path: str | Path, clip: Clip) -> None:
    """Write a motion of any rig as a table with one row per frame, atomically; docs/clips.md lists the columns."""
    motion = in_metres(clip.motion).motion.scaled(100.0)
    rotations, positions = motion_kinematics(motion)
    touching = contacts(clip.motion)
    names = ["frame", "seconds", "type", *(f"{name}_contact" for name in CONTACT_NAMES)]
    for name in motion.skeleton.names:
        names += [f"{name}_{part}" for part in ("x", "y", "z", "qw", "qx", "qy", "qz")]
    numbers = np.concatenate([positions, rotations], axis=-1).reshape(len(motion), -1)
    with atomic_write(path) as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(names)
        for frame, kind in enumerate(frame_types(clip)):
            feet = touching[frame].tolist() if len(touching) else [""] * len(CONTACT_NAMES)
            row = (_SHORT[column % 7](value) for column, value in enumerate(numbers[frame].tolist()))
            table.writerow([frame, f"{frame / motion.fps:.9g}", kind, *feet, *row])


def contacts(motion: Motion) -> Array:
    """Contacts (T, 4), 0 or 1, of left foot, left toe, right foot, right toe; (0, 4) for rigs that are not human."""
    try:
        brought = in_metres(motion).motion.scaled(100.0)
        with AS_BROUGHT():
            canonical = canonical_motion(brought)
    except SkeletonError:
        return np.zeros((0, len(CONTACT_NAMES)), np.uint8)
    _, positions = motion_kinematics(canonical)
    positions = positions + np.array([0.0, floor_shift(canonical)[0], 0.0], np.float32)
    return foot_contacts(positions, motion.fps).astype(np.uint8)


def frame_types(clip: Clip) -> list[str]:
    """The motion type of each frame; empty if unknown."""
    out: list[str] = []
    end = 0.0
    for kind, seconds in clip.types:
        end += seconds
        out += [kind] * (round(end * clip.motion.fps) - len(out))
    return (out + [out[-1] if out else ""] * len(clip.motion))[: len(clip.motion)]
