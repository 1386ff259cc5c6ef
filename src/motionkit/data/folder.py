"""A dataset folder appears whole: made beside its place, the former one kept until the new one stands.

Names beside a dataset "ds": .ds.new-* is being made, .ds.old-* was moved aside, .ds.lock is held meanwhile. What
a killed run left there is put back or removed by the next one. Nothing that preprocess did not write is removed.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from motionkit.errors import DatasetError, MotionkitError
from motionkit.files import read_json

MANIFEST = "manifest.json"
ARRAYS = ("features", "contacts", "ground", "types", "phases")
DATASET_NAMES = frozenset({MANIFEST, *(f"{name}.npy" for name in ARRAYS)})
MOTIONS = "motions"  # of the staging folder: what the first pass hands to the second


def may_replace(folder: Path) -> bool:
    """Whether nothing but a dataset, or an empty folder, stands at the place of the new one."""
    if not folder.exists():
        return True
    if not folder.is_dir():
        return False
    try:  # other programs keep a manifest.json too: theirs does not name motionkit
        manifest = read_json(folder / MANIFEST)
        return isinstance(manifest, dict) and "motionkit" in manifest
    except MotionkitError:
        return not any(folder.iterdir())


def set_aside(folder: Path) -> list[Path]:
    """Former datasets of this place that a killed run moved aside and never put back."""
    return _beside(folder, "old")


@contextmanager
def staging_folder(target: Path) -> Iterator[tuple[Path, list[str]]]:
    """A new folder beside target to make a dataset in, and words for what an earlier run had left.

    Nobody else works on target until the block ends; what is left of the folder is removed then. Raises
    DatasetError if somebody else does now.
    """
    with _locked(target):
        notes = _put_right(target)
        staging = Path(tempfile.mkdtemp(prefix=f".{target.name}.new-", dir=target.parent))
        try:
            yield staging, notes
        finally:
            _remove_staging(staging)


def put_in_place(staging: Path, target: Path) -> None:
    """Rename a finished staging folder to target: the old away, the new in, and only then what was old deleted.

    Other files that lay in the old dataset move to the new one.
    """
    former = target.parent / staging.name.replace(f".{target.name}.new-", f".{target.name}.old-", 1)
    try:
        if target.exists():
            target.rename(former)
        staging.rename(target)
    except BaseException:
        if former.exists() and not target.exists():
            former.rename(target)
        raise
    if former.exists():
        _retire(former, target)


def _beside(target: Path, kind: str) -> list[Path]:
    prefix = f".{target.name}.{kind}-"
    try:
        return sorted(p for p in target.parent.iterdir() if p.name.startswith(prefix) and p.is_dir())
    except OSError:
        return []


def _put_right(target: Path) -> list[str]:
    """Mend what a killed run left beside target, and say so."""
    notes = []
    for former in _beside(target, "old"):
        if target.exists():
            _retire(former, target)
            notes.append(f"{former}: left by a run that was broken off, removed")
        else:
            former.rename(target)
            notes.append(
                f"{target}: the former dataset, which a run that was broken off had moved aside, is back"
            )
    for staging in _beside(target, "new"):
        _remove_staging(staging)
        notes.append(f"{staging}: left by a run that was broken off, removed")
    return notes


def _retire(former: Path, target: Path) -> None:
    """Delete a dataset that was moved aside; whatever else lay in it moves to the one in its place."""
    for path in list(former.iterdir()):
        if path.name not in DATASET_NAMES and not os.path.lexists(target / path.name):
            path.rename(target / path.name)
    _remove(former, DATASET_NAMES)


def _remove_staging(staging: Path) -> None:
    motions = staging / MOTIONS
    if motions.is_dir():
        _remove(motions, {p.name for p in motions.iterdir() if p.suffix == ".npz"})
    _remove(staging, DATASET_NAMES)


def _remove(folder: Path, names: frozenset[str] | set[str]) -> None:
    """Remove these files of a folder, and the folder if nothing else is in it."""
    with suppress(OSError):  # what cannot be removed stays
        for name in names:
            (folder / name).unlink(missing_ok=True)
        folder.rmdir()


@contextmanager
def _locked(target: Path) -> Iterator[None]:
    """Hold the lock of a place; the system lets it go when the process ends, however it ends."""
    path = target.parent / f".{target.name}.lock"
    handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        if not _lock(handle):
            raise DatasetError(
                f"{target}: another run is making this dataset; wait for it, or choose another place"
            )
        try:
            yield
        finally:
            if os.name != "nt":  # before the lock goes, so that nobody waits on a file without a name
                path.unlink(missing_ok=True)
    finally:
        os.close(handle)
        if os.name == "nt":
            with suppress(OSError):
                path.unlink(missing_ok=True)


def _lock(handle: int) -> bool:
    """Lock an open file; False if another process has. Where the system knows no locks there is none to fail."""
    try:
        if os.name == "nt":
            import msvcrt

            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
        else:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return os.name != "nt"  # there a held lock is a PermissionError
    return True


class ArrayWriter:
    """Writes an .npy file row by row.

    Not through a memory map: its pages would find no place on a full disk, and the process dies of that.
    """

    def __init__(self, folder: Path, name: str, shape: tuple[int, ...], dtype: type) -> None:
        self.path = folder / f"{name}.npy"
        self.dtype = np.dtype(dtype)
        self._file = self.path.open("wb")
        facts = {"descr": np.lib.format.dtype_to_descr(self.dtype), "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(self._file, facts)

    def append(self, rows: np.ndarray) -> None:
        """Write (n, ...) more rows."""
        self._file.write(np.ascontiguousarray(rows, self.dtype).tobytes())

    def close(self) -> np.ndarray:
        """The whole array, memory-mapped for reading, once it is on the disk."""
        with self._file as file:
            file.flush()
            os.fsync(file.fileno())
        return np.load(self.path, mmap_mode="r", allow_pickle=False)

    def abandon(self) -> None:
        """Close the file without a word of what did not fit."""
        with suppress(OSError):
            self._file.close()
