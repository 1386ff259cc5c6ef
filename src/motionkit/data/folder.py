"""Writes a dataset folder atomically: a new folder is written beside the old one and then takes its name.

Beside a dataset "ds", .ds.new-* is being written, .ds.old-* is the old one moved aside, and .ds.lock is the lock.
The next run restores or removes what a killed run left. Only files that preprocess wrote are removed.
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
from motionkit.interrupts import uninterrupted
from motionkit.locks import locked

MANIFEST = "manifest.json"
ARRAYS = ("features", "contacts", "ground", "types", "phases")
DATASET_NAMES = frozenset({MANIFEST, *(f"{name}.npy" for name in ARRAYS)})
MOTIONS = "motions"  # subfolder of the staging folder for the first pass's motions


def may_replace(folder: Path) -> bool:
    """Whether a dataset may be written here: the folder is missing, empty or a dataset."""
    if not folder.exists():
        return True
    if not folder.is_dir():
        return False
    try:  # other programs also write a manifest.json, but it does not name motionkit
        manifest = read_json(folder / MANIFEST)
        return isinstance(manifest, dict) and "motionkit" in manifest
    except MotionkitError:
        return not any(folder.iterdir())


def remove_dataset(folder: Path) -> None:
    """Remove a dataset; other files in its folder stay."""
    if may_replace(folder):
        _remove(folder, DATASET_NAMES)


def set_aside(folder: Path) -> list[Path]:
    """Old datasets that a killed run moved aside and did not restore."""
    return _beside(folder, "old")


@contextmanager
def staging_folder(target: Path) -> Iterator[tuple[Path, list[str]]]:
    """Lock target and make a folder beside it; yields the folder, and notes on leftovers of earlier runs.

    When the block ends, the lock is released, and the folder is removed unless put_in_place has renamed it.

    Raises:
        DatasetError: another run holds the lock.
    """
    with locked(target, "making this dataset", DatasetError) as notes:
        notes += _put_right(target)
        staging = None
        try:
            with uninterrupted():
                staging = Path(tempfile.mkdtemp(prefix=f".{target.name}.new-", dir=target.parent))
            yield staging, notes
        finally:
            if staging is not None:
                _remove_staging(staging)


def put_in_place(staging: Path, target: Path) -> None:
    """Rename a finished staging folder to target; the old dataset is moved aside first and deleted last.

    Files that are not the dataset's own move to the new folder.
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
    """Restore or remove leftovers of killed runs beside target; returns notes about them."""
    notes = []
    for former in _beside(target, "old"):
        if target.exists():
            _retire(former, target)
            notes.append(f"{former}: removed; an interrupted run had left it")
        else:
            former.rename(target)
            notes.append(f"{target}: restored the old dataset, which an interrupted run had moved aside")
    for staging in _beside(target, "new"):
        _remove_staging(staging)
        notes.append(f"{staging}: removed; an interrupted run had left it")
    return notes


def _retire(former: Path, target: Path) -> None:
    """Delete a dataset that was moved aside; its other files move to the new one."""
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
    """Remove files of a folder, and the folder if it is then empty."""
    with suppress(OSError):  # files that cannot be removed stay
        for name in names:
            (folder / name).unlink(missing_ok=True)
        folder.rmdir()


class ArrayWriter:
    """Writes an .npy file row by row.

    It does not use a memory map, because a full disk would then kill the process.
    """

    def __init__(self, folder: Path, name: str, shape: tuple[int, ...], dtype: type) -> None:
        self.path = folder / f"{name}.npy"
        self.dtype = np.dtype(dtype)
        self._file = self.path.open("wb")
        facts = {"descr": np.lib.format.dtype_to_descr(self.dtype), "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(self._file, facts)

    def append(self, rows: np.ndarray) -> None:
        """Append rows (n, ...)."""
        self._file.write(np.ascontiguousarray(rows, self.dtype).tobytes())

    def close(self) -> np.ndarray:
        """Flush the file and return the whole array, memory-mapped for reading."""
        with self._file as file:
            file.flush()
            os.fsync(file.fileno())
        return np.load(self.path, mmap_mode="r", allow_pickle=False)

    def abandon(self) -> None:
        """Close the file and ignore errors."""
        with suppress(OSError):
            self._file.close()
