"""The table of motion formats that are written; rig/read_file.py has those that are read.

mk.write and all commands that write a motion use it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from itertools import groupby
from pathlib import Path

from motionkit.errors import MotionkitError
from motionkit.export.clip import Clip, check_numbers
from motionkit.motion.motion import Motion, as_motion
from motionkit.names import visible
from motionkit.reading import ALL, report_notes, user_animation, user_cm

# Ending -> module of this package and function in it.
WRITERS: dict[str, str] = {
    ".bvh": "formats:_write_bvh",
    ".glb": "glb:write_glb",
    ".vrm": "glb:write_vrm",
    ".fbx": "fbx:write_fbx",
    ".vrma": "vrma:write_vrma",
    ".usda": "usda:write_usda",
    ".npz": "tables:write_npz",
    ".csv": "tables:write_csv",
}
# Endings of formats that are not written, and what to use instead.
INSTEAD: dict[str, str] = {
    ".gltf": "motionkit writes binary glTF only: use .glb",
    ".usd": "motionkit writes USD as text: use .usda",
    ".usdc": "motionkit writes USD as text: use .usda",
    ".usdz": "motionkit writes USD as text: use .usda",
}


def check_ending(path: str | Path) -> None:
    """Raise MotionkitError unless a file to write has an ending in WRITERS, and what its format needs is installed."""
    _find(path)
    if Path(path).suffix.lower() == ".fbx":
        from motionkit.rig.fbx import check_writes

        check_writes(path)


def write_motion(path: str | Path, motion: Motion | Clip) -> None:
    """Write a motion atomically; the file's ending chooses the format.

    Args:
        path: its ending is one of WRITERS.
        motion: a motion of any rig, or a result of synthesize, follow_path or loop, whose types are written too; a .bvh
            file keeps its unit, others use metres or centimetres.

    Raises:
        MotionkitError: the ending is unknown, the result has several motions, the motion is not finite, or the file
            cannot be written.
        SkeletonError: a .vrma file for a rig that is not human.
    """
    write = _find(path)
    clip = motion if isinstance(motion, Clip) else _clip_of(path, motion)
    check_numbers(path, clip.motion)
    write(path, clip)


def _clip_of(path: str | Path, value: object) -> Clip:
    """The clip of a motion or result, with its types if it has any."""
    count = len(getattr(value, "motions", ()))
    if count > 1:
        raise MotionkitError(f"{path}: a file takes one motion, found {count}; write each of its motions")
    types = tuple((part.type, part.seconds) for part in getattr(value, "types", ()))
    return Clip(as_motion(value), Path(path).stem, types)


def read_motion(path: str | Path) -> Motion:
    """Read the motion of a file: in cm from a .glb or .vrm unless the user gives a unit, else in its own unit.

    Raises:
        MotionkitError: the file cannot be read; the message names the file.
    """
    return read_clip(path).motion


def read_clip(path: str | Path, name: str | None = None) -> Clip:
    """Read a motion with its name and what else its format holds; raises like read_motion.

    name is that of the animation of a .glb or .vrm; it is needed if there are several.
    """
    from motionkit.rig.read_file import is_gltf

    return _read_character(path, name) if is_gltf(path) else _read_joints(path)


def _find(path: str | Path) -> Callable:
    ending = Path(path).suffix.lower()
    if ending not in WRITERS:
        known = ", ".join(WRITERS)
        reason = INSTEAD.get(ending) or f"cannot be written: expected a name that ends in {known}"
        raise MotionkitError(f"{path}: {reason}")
    module, _, name = WRITERS[ending].partition(":")
    found: Callable = getattr(import_module(f"motionkit.export.{module}"), name)
    return found


def _write_bvh(path: str | Path, clip: Clip) -> None:
    from motionkit.motion.bvh import motion_to_bvh, write_bvh

    if clip.channels is None:
        write_bvh(path, clip.motion)
    else:
        write_bvh(path, replace(motion_to_bvh(clip.motion, clip.channels), hierarchy=clip.hierarchy))


def _read_joints(path: str | Path) -> Clip:
    from motionkit.motion.bvh import bvh_to_motion
    from motionkit.rig.read_file import read_file

    bvh = read_file(path)
    name = user_animation()
    if name not in (None, ALL):
        report_notes(path, (f"its only motion, for its format has none called {visible(str(name))}",))
    clip = Clip(bvh_to_motion(bvh), Path(path).stem, channels=bvh.channels, hierarchy=bvh.hierarchy)
    if Path(path).suffix.lower() == ".npz":
        from motionkit.motion.npz import frame_types

        runs = groupby(frame_types(path))
        clip = replace(clip, types=tuple((kind, len([*run]) / bvh.fps) for kind, run in runs))
    return clip.with_motion(clip.motion)


def _read_character(path: str | Path, name: str | None) -> Clip:
    from motionkit.rig.character import read_character
    from motionkit.rig.read_glb import CM, motion_of, told_types

    character = read_character(path)
    called, motion = motion_of(character, name)
    # A unit that the user gives is that of the file.
    per_unit = CM if user_cm() is None else 1.0
    types = told_types(character.tree.file, called)
    return Clip(motion.scaled(per_unit), called, types, character=character, per_unit=per_unit)
