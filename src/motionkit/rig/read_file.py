"""Reads a file of motion of any kind as a BvhFile: the one way in for all that works on any rig."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from motionkit.errors import BvhError, MotionkitError
from motionkit.files import files_below
from motionkit.motion.acclaim import read_acclaim
from motionkit.motion.bvh import BvhFile, motion_to_bvh, read_bvh
from motionkit.motion.npz import has_motion, read_npz
from motionkit.motion.skeleton import Skeleton
from motionkit.reading import report_notes, user_joints
from motionkit.rig.character import read_character
from motionkit.rig.fbx import ENDING as FBX
from motionkit.rig.read_glb import motion_of

# Ending -> function that takes the path of such a file and returns a BvhFile.
READERS: dict[str, Callable[[str | Path], BvhFile]] = {
    ".bvh": read_bvh,
    ".amc": read_acclaim,
    ".asf": read_acclaim,
    ".npz": read_npz,
}
GLTF_ENDINGS = (".glb", ".vrm", FBX)  # characters, with any number of animations
_COARSE = 1e-4  # of the length of all bones; rounding of places from which a user is told
RIGS_ONLY = (".asf",)
# Of files that are looked for in folders.
ENDINGS = (*(ending for ending in READERS if ending not in RIGS_ONLY), *GLTF_ENDINGS)


def read_file(path: str | Path, clip: str | None = None) -> BvhFile:
    """Read the motion of a file, in its own unit: metres for .glb and .vrm; a file with an unknown ending is BVH.

    Args:
        path: the file.
        clip: animation of a .glb or .vrm; needed if it has several, unless a caller has chosen one (motionkit.reading).

    Raises:
        BvhError, MotionkitError: the file cannot be read, or has no such animation; the message names the file.
    """
    if is_gltf(path):
        character = read_character(path)
        found = motion_to_bvh(motion_of(character, clip)[1])
    else:
        found = READERS.get(Path(path).suffix.lower(), _read_unknown)(path)
    _check_map(path, found.skeleton)
    _note_far(path, found)
    return found


def _read_unknown(path: str | Path) -> BvhFile:
    """Read a file with an unknown ending as BVH."""
    try:
        return read_bvh(path)
    except BvhError as error:
        known = ", ".join((*READERS, *GLTF_ENDINGS))
        found = f"{error.found}; the name of a file of another kind ends in {known}"
        raise BvhError(error.path, found, error.line) from None


def _note_far(path: str | Path, bvh: BvhFile) -> None:
    """Report a body so far from the origin that its place is coarse: motions hold positions in 32 bits."""
    places = [c for n, c in zip(bvh.channels[0], bvh.columns()[0], strict=True) if n.endswith("position")]
    far = float(np.abs(bvh.values[:, places]).max(initial=0.0))
    step = float(np.spacing(np.float32(far)))
    size = float(np.linalg.norm(bvh.skeleton.offsets[1:], axis=-1).sum())
    if places and 0.0 < _COARSE * size < step:
        report_notes(
            path, (f"its places rounded to {step:.2g}, because it is {far:,.0f} away from the origin",)
        )


def _check_map(path: str | Path, skeleton: Skeleton) -> None:
    """Raise MotionkitError for a file that has some joints of the user's bone map only; report one that has none."""
    joints = set((user_joints() or {}).values())
    lacking = sorted(joints - set(skeleton.names))
    if lacking and len(lacking) < len(joints):
        raise MotionkitError(f"{path}: has no joint {lacking[0][:40]!r}, which the bone map names")
    if lacking:
        report_notes(path, ("its joints found by name and shape, because the bone map names none of them",))


def motion_files(folder: str | Path) -> list[Path]:
    """The files of motion below a folder, sorted; raises MotionkitError if one of its folders cannot be listed."""
    return [path for path in files_below(folder, ENDINGS) if holds_motion(path)]


def clips_of(place: Path) -> list[Path]:
    """A file itself, or the files of motion below a folder, sorted; raises MotionkitError if it has none."""
    if not place.is_dir():
        return [place]
    found = motion_files(place)
    if not found:
        raise MotionkitError(f"{place}: no {endings_text()} files found")
    return found


def holds_motion(path: str | Path) -> bool:
    """Whether a file of a folder is one to read: all but archives of other things."""
    return Path(path).suffix.lower() != ".npz" or has_motion(path)


def is_gltf(path: str | Path) -> bool:
    """Whether a file's ending says that it holds a character and its animations."""
    return Path(path).suffix.lower() in GLTF_ENDINGS


def is_bvh(path: str | Path) -> bool:
    """Whether a file is read as BVH, which has a text of its hierarchy and channels to keep."""
    return not is_gltf(path) and READERS.get(Path(path).suffix.lower(), read_bvh) is read_bvh


def endings_text() -> str:
    """The endings of files that are looked for in folders, in words."""
    return f"{', '.join(ENDINGS[:-1])} or {ENDINGS[-1]}"
