"""The shared libraries that setup.py builds: loading them, and the threads that call them."""

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
    """A library built by setup.py.

    Raises MotionkitError where there is none of this version: nothing was installed, the file is damaged, or the source
    has changed since.
    """
    built = path.with_name(path.name + LIBRARY_ENDING)
    if not built.is_file():
        raise _unusable(built, "is missing")
    try:
        library = ctypes.CDLL(str(built)) if _is_whole(built) else None
    except OSError:  # for another machine, or no library at all
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
    """Whether an ELF file goes on to its end: the loader maps one that was cut short, and dies of SIGBUS.

    Its table of sections comes last, and the names of the sections are in one of the type 3. Other formats
    are left to their loaders.
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
    """The cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def workers(count: int) -> ThreadPoolExecutor:
    """Threads for calls of libraries, which do not hold Python's lock."""
    return ThreadPoolExecutor(count, thread_name_prefix="motionkit")
