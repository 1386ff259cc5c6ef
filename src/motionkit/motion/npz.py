"""Motion in numpy archives (.npz): those of `motionkit convert`, and the poses of AMASS and SMPL."""

from __future__ import annotations

import sys
import tokenize
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.files import open_regular
from motionkit.free_memory import check_memory
from motionkit.motion.bvh import BvhFile, motion_to_bvh
from motionkit.motion.bvh_rows import MAX_NUMBER, Notes, filled, filled_turns
from motionkit.motion.bvh_text import (
    LONGEST_FRAME,
    MAX_BYTES,
    MAX_JOINTS,
    MAX_NAME,
    SHORTEST_FRAME,
    check_duration,
)
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_normalize
from motionkit.motion.skeleton import Skeleton
from motionkit.motion.smpl import BODY, WIDTHS, smpl_motion
from motionkit.names import joint_names
from motionkit.reading import report_notes

RATE = 30.0  # frames per second of poses without one, as estimated from video
_MOTION = ("local_rotations", "poses", "pose_body")  # one of which every archive of motion has
_AMASS_RATES = ("mocap_framerate", "mocap_frame_rate")  # of AMASS, in which Z points up
_RATES = (*_AMASS_RATES, "fps", "frame_rate", "framerate")
# What a damaged archive, or the header of one of its arrays, makes zipfile and numpy raise.
_FAULTS = (
    *(zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, KeyError, TypeError, OverflowError),
    *(RuntimeError, MemoryError, SyntaxError, tokenize.TokenError),
)
_KINDS = {"number": "iuf", "name": "U"}


def read_npz(path: str | Path) -> BvhFile:
    """Read an archive of motion: motionkit's own in cm, or SMPL poses in metres.

    Raises:
        MotionkitError: it is no archive, or its arrays are no motion; the message names the file.
    """
    with _opened(path) as archive:
        if "local_rotations" in archive:
            return motion_to_bvh(_motionkit_motion(archive))
        return motion_to_bvh(_smpl(archive))


def has_motion(path: str | Path) -> bool:
    """Whether an archive names arrays of motion, as the bodies beside AMASS's motions do not; True if it is damaged."""
    try:
        with _opened(path) as archive:
            return any(name in archive for name in _MOTION)
    except MotionkitError:
        return True


def frame_types(path: str | Path) -> list[str]:
    """The motion type of each frame that an archive of motionkit names; empty if it names none."""
    with _opened(path) as archive:
        told = [str(kind) for kind in archive.read("types", (None,), "name")] if "types" in archive else []
    return told if all(kind.isprintable() and kind for kind in told) else []


class _Archive:
    """The arrays of an archive, of which none is read before its header says that it fits."""

    def __init__(self, path: str | Path, names: zipfile.ZipFile) -> None:
        self.path = path
        self.zip = names
        self.names = [name.removesuffix(".npy") for name in names.namelist()]
        self.notes = Notes(path)

    def __contains__(self, name: str) -> bool:
        return name in self.names

    def fault(self, text: str) -> MotionkitError:
        return MotionkitError(f"{self.path}: {text}")

    def shape(self, name: str) -> tuple[tuple[int, ...], np.dtype[Any]]:
        """The shape and the type of an array, which is in the archive as a whole."""
        if name not in self:
            raise self.fault(f"has no array {name!r}; it has {', '.join(self.names)[:200] or 'none'}")
        entry = f"{name}.npy"
        size = self.zip.getinfo(entry).file_size
        if size > MAX_BYTES:
            raise self.fault(f"its array {name!r} is larger than {MAX_BYTES // 2**20} MB")
        with self.zip.open(entry) as file:
            shape, dtype = _header(file)
        if np.prod(shape, dtype=np.float64) * dtype.itemsize > size:
            raise self.fault(f"its array {name!r} is cut off")
        return shape, dtype

    def read(
        self, name: str, shape: tuple[int | None, ...] = (), kind: str = "number", fill: bool = False
    ) -> Array:
        """An array of a shape, None for any length, () for one value; numbers are float64 and within MAX_NUMBER.

        Raises:
            MotionkitError: it is not there, is of another shape or type, or has numbers out of range.
        """
        found, dtype = self.shape(name)
        fits = len(found) == len(shape) and all(w in (None, f) for w, f in zip(shape, found, strict=True))
        if not (fits or (shape == () and found == (1,))) or dtype.kind not in _KINDS[kind]:
            expected, actual = (
                " x ".join("any" if n is None else str(n) for n in size) for size in (shape, found)
            )
            raise self.fault(
                f"expected {name!r} of {expected or 'one'} {kind}s, found {actual or 'one'} of type {dtype.name}"
            )
        with self.zip.open(f"{name}.npy") as file:
            values: Array = np.lib.format.read_array(file, allow_pickle=False)
        if kind == "number":
            with np.errstate(invalid="ignore"):  # a NaN of the kind that signals
                values = values.astype(np.float64)
            if fill and values.size:
                values = self._filled(name, values)
            if not bool((np.abs(values) <= MAX_NUMBER).all()):
                raise self.fault(
                    f"its array {name!r} has a value that is not a number up to {MAX_NUMBER:,.0f}"
                )
        elif values.size and int(values.view(values.dtype.byteorder + "u4").max()) > sys.maxunicode:
            raise self.fault(f"its array {name!r} has a letter that does not exist")
        return values

    def _filled(self, name: str, values: Array) -> Array:
        if name == "local_rotations":
            return filled_turns(values, self.notes)
        flat = values.reshape(len(values), -1)
        return filled(flat, [name] * flat.shape[1], self.notes).reshape(values.shape)

    def track(self, name: str, shape: tuple[int | None, ...]) -> Array:
        """An array (T, ...) of frames, with values that are no numbers filled, unless read strictly."""
        return self.read(name, shape, fill=not self.notes.strict)

    def frames(self, name: str, shape: tuple[int | None, ...], joints: int, fps: float) -> Array:
        """An array (T, ...) of frames, which fit into memory."""
        count = (*self.shape(name)[0], 0)[0]
        try:
            check_memory(count, joints, fps)
        except MotionkitError as error:
            raise self.fault(str(error)) from None
        check_duration(self.path, count, 1.0 / fps, None)
        values = self.track(name, (None, *shape))
        if not len(values):
            raise self.fault(f"its array {name!r} has no frames")
        return values

    def rate(self, names: tuple[str, ...]) -> float | None:
        """The frames per second by one of some names; None without one."""
        name = next((name for name in names if name in self), None)
        if name is None:
            return None
        rate = float(self.read(name).reshape(-1)[0])
        if not 1.0 / LONGEST_FRAME <= rate <= 1.0 / SHORTEST_FRAME:
            raise self.fault(f"expected {name!r} of 1 to {1 / SHORTEST_FRAME:,.0f}, found {rate:g}")
        return rate


@contextmanager
def _opened(path: str | Path) -> Iterator[_Archive]:
    with open_regular(path, MAX_BYTES, "a numpy archive") as file:
        try:
            with zipfile.ZipFile(file) as archive:
                yield _Archive(path, archive)
        except _FAULTS as error:
            reason = " ".join(str(error).split())[:200]
            raise MotionkitError(f"{path}: cannot be read as a numpy archive ({reason})") from None


def _header(file: Any) -> tuple[tuple[int, ...], np.dtype[Any]]:
    version = np.lib.format.read_magic(file)
    read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in read:
        raise ValueError(f"version {version} of an array")
    shape, _, dtype = read[version](file)
    return shape, dtype


def _smpl(archive: _Archive) -> Motion:
    """Poses and places of the body by their names in AMASS and SMPL-X, on the mean body."""
    fps = archive.rate(_RATES)
    if "poses" in archive:
        poses = archive.frames("poses", (None,), BODY, fps or RATE)
    elif "root_orient" in archive and "pose_body" in archive:
        parts = [
            archive.frames(name, (width,), BODY, fps or RATE)
            for name, width in (("root_orient", 3), ("pose_body", 63))
        ]
        if len(parts[0]) != len(parts[1]):
            raise archive.fault(f"has {len(parts[0])} root_orient and {len(parts[1])} pose_body")
        poses = np.concatenate(parts, axis=1)
    else:
        raise archive.fault(
            "expected local_rotations (motionkit), or poses and trans (AMASS, SMPL), found "
            f"{', '.join(archive.names)[:200] or 'no arrays'}"
        )
    if poses.shape[1] not in WIDTHS:
        known = ", ".join(f"{width} ({name})" for width, name in WIDTHS.items())
        raise archive.fault(f"expected poses of {known} numbers, found {poses.shape[1]}")
    places = archive.track("trans", (len(poses), 3))
    notes = [f"poses of {WIDTHS[poses.shape[1]]} on its mean body"]
    left = ["betas"] if "betas" in archive else []
    left += ["fingers"] if poses.shape[1] > 3 * (BODY + 2) else []
    notes += [f"{' and '.join(left)} left out"] if left else []
    notes += [] if fps else [f"{RATE:g} frames a second, because the file does not say its rate"]
    report_notes(archive.path, (*notes, *archive.notes.lines))
    up = "+Z" if any(name in archive for name in _AMASS_RATES) else None
    return smpl_motion(poses, places, fps or RATE, up)


def _motionkit_motion(archive: _Archive) -> Motion:
    """What export/tables.py writes."""
    names = archive.read("joints", (None,), "name")
    count = len(names)
    if not 1 <= count <= MAX_JOINTS:
        raise archive.fault(f"expected 1 to {MAX_JOINTS} joints, found {count}")
    parents = archive.read("parents", (count,)).astype(int).tolist()
    if parents[0] != -1 or not all(0 <= parent < joint for joint, parent in enumerate(parents) if joint):
        raise archive.fault("expected parents before their joints, and -1 for the first alone")
    fps = archive.rate(("fps",))
    if fps is None:
        raise archive.fault("has no array 'fps'")
    rotations = archive.frames("local_rotations", (count, 4), count, fps)
    if not bool((np.abs(np.linalg.norm(rotations, axis=-1) - 1.0) < 0.01).all()):
        raise archive.fault("expected unit quaternions as local_rotations")
    frames = len(rotations)
    ends = {}
    if "end_joints" in archive:
        of = archive.read("end_joints", (None,)).astype(int).tolist()
        places = archive.read("end_offsets", (len(of), 3))
        if not all(0 <= joint < count for joint in of):
            raise archive.fault("expected joints as end_joints")
        ends = {joint: (*place,) for joint, place in zip(of, places.tolist(), strict=True)}
    local = archive.track("local_positions", (frames, count, 3)) if "local_positions" in archive else None
    roots = archive.track("root_positions", (frames, 3))
    report_notes(archive.path, archive.notes.lines)
    return Motion(
        Skeleton(
            joint_names([str(name) for name in names], MAX_NAME),
            tuple(parents),
            archive.read("offsets", (count, 3)).astype(np.float32),
            ends,
            cm=1.0,
            up="+Y",
        ),
        quat_normalize(rotations).astype(np.float32),
        roots.astype(np.float32),
        fps,
        None if local is None else local.astype(np.float32),
    )
