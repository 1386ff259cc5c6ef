"""The table of motion formats: file endings with their readers and writers.

mk.write and all commands that write a motion use it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path

from motionkit.errors import MotionkitError
from motionkit.export.clip import Clip, check_numbers
from motionkit.motion.motion import Motion

# Ending -> module of this package and function in it.
WRITERS: dict[str, str] = {
    ".bvh": "formats:_write_bvh",
    ".glb": "glb:write_glb",
    ".vrm": "glb:write_vrm",
    ".vrma": "vrma:write_vrma",
    ".usda": "usda:write_usda",
    ".npz": "tables:write_npz",
    ".csv": "tables:write_csv",
}
READERS: dict[str, str] = {
    ".bvh": "formats:_read_bvh",
    ".glb": "formats:_read_glb",
    ".vrm": "formats:_read_glb",
}
# Endings of formats that are not written, and what to use instead.
INSTEAD: dict[str, str] = {
    ".fbx": "motionkit writes no FBX; write a .glb, and Blender makes an FBX of it (docs/clips.md, FBX)",
    ".gltf": "motionkit writes binary glTF only: use .glb",
    ".usd": "motionkit writes USD as text: use .usda",
    ".usdc": "motionkit writes USD as text: use .usda",
    ".usdz": "motionkit writes USD as text: use .usda",
}


def check_ending(path: str | Path) -> None:
    """Raise MotionkitError unless a file to write has an ending in WRITERS."""
    _find(WRITERS, path, "written")


def write_motion(path: str | Path, motion: Motion | Clip) -> None:
    """Write a motion atomically; the file's ending chooses the format.

    Args:
        path: ends in .bvh, .glb, .vrma, .usda, .npz or .csv.
        motion: a motion of any rig; a .bvh file keeps its unit, others use metres or centimetres.

    Raises:
        MotionkitError: the ending is unknown, the motion is not finite, or the file cannot be written.
        SkeletonError: a .vrma file for a rig that is not human.
    """
    write = _find(WRITERS, path, "written")
    clip = motion if isinstance(motion, Clip) else Clip(motion, Path(path).stem)
    check_numbers(path, clip.motion)
    write(path, clip)


def read_motion(path: str | Path) -> Motion:
    """Read the motion of a .bvh file, in its own unit, or of a .glb or .vrm file, in cm.

    Raises:
        MotionkitError: the ending is unknown or the file cannot be read; the message names the file.
    """
    return read_clip(path).motion


def read_clip(path: str | Path, name: str | None = None) -> Clip:
    """Read a motion with its name and what else its format holds; raises like read_motion.

    Args:
        path: the file.
        name: the animation of a .glb or .vrm; needed if it has several.
    """
    clip: Clip = _find(READERS, path, "read")(path, name)
    return clip


def _find(table: dict[str, str], path: str | Path, done: str) -> Callable:
    ending = Path(path).suffix.lower()
    if ending not in table:
        reason = INSTEAD.get(ending) if done == "written" else None
        known = ", ".join(table)
        raise MotionkitError(f"{path}: {reason or f'cannot be {done}: expected a name that ends in {known}'}")
    module, _, name = table[ending].partition(":")
    found: Callable = getattr(import_module(f"motionkit.export.{module}"), name)
    return found


def _write_bvh(path: str | Path, clip: Clip) -> None:
    from motionkit.motion.bvh import motion_to_bvh, write_bvh

    if clip.channels is None:
        write_bvh(path, clip.motion)
    else:
        write_bvh(path, replace(motion_to_bvh(clip.motion, clip.channels), hierarchy=clip.hierarchy))


def _read_bvh(path: str | Path, name: str | None = None) -> Clip:
    from motionkit.motion.bvh import bvh_to_motion, read_bvh

    bvh = read_bvh(path)
    clip = Clip(bvh_to_motion(bvh), Path(path).stem, channels=bvh.channels)
    return clip.with_motion(clip.motion)


def _read_glb(path: str | Path, name: str | None = None) -> Clip:
    from motionkit.rig.character import read_character
    from motionkit.rig.read_glb import CM, motion_of

    character = read_character(path)
    called, motion = motion_of(character, name)
    # The body of our own files is made anew, for any joints.
    return Clip(motion.scaled(CM), called, character=None if character.tree.file.own() else character)
