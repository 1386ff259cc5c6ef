"""Reads a file of motion, BVH or glTF, as a BvhFile: the one way in for all that works on any rig."""

from __future__ import annotations

from pathlib import Path

from motionkit.motion.bvh import BvhFile, motion_to_bvh, read_bvh
from motionkit.rig.character import read_character
from motionkit.rig.read_glb import motion_of

GLTF_ENDINGS = (".glb", ".vrm")
ENDINGS = (".bvh", *GLTF_ENDINGS)  # of files that are looked for in folders


def read_file(path: str | Path, clip: str | None = None) -> BvhFile:
    """Read the motion of a .glb or .vrm file, in metres, or of a BVH file with any other ending, in its own unit.

    Args:
        path: the file.
        clip: animation of a .glb or .vrm; needed if it has several, unless a caller has chosen one (motionkit.reading).

    Raises:
        BvhError, MotionkitError: the file cannot be read, or has no such animation; the message names the file.
    """
    if not is_gltf(path):
        return read_bvh(path)
    character = read_character(path)
    return character.named(motion_to_bvh(motion_of(character, clip)[1]))


def is_gltf(path: str | Path) -> bool:
    """Whether a file's ending says that it is a .glb or .vrm."""
    return Path(path).suffix.lower() in GLTF_ENDINGS
