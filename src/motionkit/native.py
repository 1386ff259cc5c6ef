"""Loads the shared libraries that setup.py builds, and provides threads for calls to them."""

from __future__ import annotations

import ctypes
import os
import struct
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

from motionkit.errors import MotionkitError

LIBRARY_ENDING = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")  # as setup.py names them


def load_library(path: Path, version_name: str, version: int) -> ctypes.CDLL:
    """Load a library built by setup.py.

    Raises MotionkitError if no library of this version exists: it was not built, it is damaged, or the source has
    changed since.
    """
    built = path.with_name(path.name + LIBRARY_ENDING)
    if not built.is_file():
        raise _unusable(built, "is missing")
    try:
        library = ctypes.CDLL(str(built)) if _is_whole(built) else None
    except OSError:  # built for another machine, or not a library
        library = None
    if library is None:
        raise _unusable(built, "is damaged, or for another system")
    found = getattr(library, version_name, None)
    if found is None or found() != version:
        raise _unusable(built, "is of another version of motionkit")
    return library


def _unusable(built: Path, fault: str) -> MotionkitError:
    return MotionkitError(
        f"the library {built} {fault}: install motionkit anew (in a checkout: pip install -e .)"
    )


def _is_whole(path: Path) -> bool:
    """Whether an ELF file is complete; the loader would crash with SIGBUS on a truncated one.

    The section table is at the end of the file, with the section names in an entry of type 3. Other formats are not
    checked.
    """
    data = path.read_bytes()
    if data[:6] != b"\x7fELF\x02\x01":  # 64 bits, little-endian
        return bool(data)
    try:
        (table,) = struct.unpack_from("<Q", data, 40)
        size, count, names = struct.unpack_from("<3H", data, 58)
        (kind,) = struct.unpack_from("<I", data, table + names * size + 4)
    except struct.error:
        return False
    return kind == 3 and table + count * size <= len(data)


def cores() -> int:
    """The number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def workers(count: int) -> ThreadPoolExecutor:
    """A pool of threads for library calls, which release Python's lock."""
    return ThreadPoolExecutor(count, thread_name_prefix="motionkit")
