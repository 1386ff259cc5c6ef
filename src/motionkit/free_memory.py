"""Refuses motion that does not fit into memory before the work begins, and says how much would."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from motionkit.errors import MotionkitError

# Most that a command takes for a frame of a joint of all its clips, in bytes: retargeting, and joining them.
BYTES_OF_JOINT = 400
BYTES_BESIDE = 250  # the same for measuring two clips, beside the clips themselves
BYTES_OF_TEXT = 4  # most that reading takes for a byte of a text file: its bytes, its letters and its lines
# Of control groups, as containers have them, version 2 and 1: limit and use.
_GROUPS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)


def free_memory() -> int:
    """Bytes that a process may take: what the system, its control group and its own limit leave."""
    return min(_system(), *(_number(limit) - _number(used, 0) for limit, used in _GROUPS), _cgroup())


def check_memory(frames: int, joints: int, fps: float, each: int = BYTES_OF_JOINT) -> None:
    """Raise MotionkitError for motion of so many frames and joints that does not fit into memory.

    each: bytes for a frame of a joint.
    """
    needed, free = frames * joints * each, free_memory()
    if needed > free:
        raise MotionkitError(
            f"{frames:,} frames of {joints} joints take about {needed / 1e9:.2g} GB of memory, {free / 1e9:.2g} are "
            f"free; expected at most {max(free, 0) // (joints * each * fps):.0f} s at {fps:g} fps: cut it into parts"
        )


def check_text(size: int) -> None:
    """Raise MotionkitError for a text file of so many bytes that cannot be read in the memory that is free."""
    needed, free = size * BYTES_OF_TEXT, free_memory()
    if needed > free:
        raise MotionkitError(
            f"{size / 1e6:.0f} MB of text take about {needed / 1e9:.2g} GB of memory, {free / 1e9:.2g} are free; "
            f"expected at most {max(free, 0) // BYTES_OF_TEXT / 1e6:.0f} MB: cut it into parts"
        )


def _system() -> int:
    try:
        for line in Path("/proc/meminfo").read_text("ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
        return sys.maxsize
    except (OSError, ValueError):
        return _physical()


def _physical() -> int:
    try:
        return int(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, OSError, ValueError):  # Windows
        return sys.maxsize


def _number(path: str, unknown: int = sys.maxsize) -> int:
    """The number in a file of the system; `unknown` if there is none, as in "max"."""
    try:
        return int(Path(path).read_text("ascii"))
    except (OSError, ValueError):
        return unknown


def _cgroup() -> int:
    """What the limit of the process's address space leaves."""
    try:
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        pages = int(Path("/proc/self/statm").read_text("ascii").split()[0])
    except (ImportError, OSError, ValueError):
        return sys.maxsize
    return sys.maxsize if limit == resource.RLIM_INFINITY else limit - pages * resource.getpagesize()
