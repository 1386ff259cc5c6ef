"""Locks between processes: one run at a time writes an output, and a file whose writer was killed is known.

The operating system releases a lock when its process ends, however it ends. A lock file names its holder.
"""

from __future__ import annotations

import os
import platform
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from motionkit.errors import MotionkitError
from motionkit.interrupts import uninterrupted

_FAR = 2**20  # byte that is locked on Windows, where the locked bytes of a file cannot be read


@contextmanager
def locked(target: Path, work: str, error: type[MotionkitError] = MotionkitError) -> Iterator[list[str]]:
    """Hold the lock of an output, `.NAME.lock` beside it, for a block; yields notes on a lock that was left.

    Args:
        target: file or folder that the block writes; folders above it are made.
        work: what the block does, such as "making this dataset", for the message.
        error: exception class to raise.

    Raises:
        MotionkitError: another run holds the lock, or the lock file cannot be written.
    """
    path = target.parent / f".{target.name}.lock"
    handle, ours = -1, False
    try:
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            while not ours:
                with uninterrupted():
                    handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
                    acquired, holder = lock(handle), _holder(handle)
                    ours = not _lives(holder) if acquired is None else acquired
                if not ours:
                    named = f" ({holder})" if holder else ""
                    raise error(
                        f"{target}: another run is {work}{named}; wait for it or choose another place"
                    )
                if not names_file(path, handle):  # its holder removed it since it was opened
                    os.close(handle)
                    handle, ours = -1, False
            _sign(handle)
        except OSError as fault:
            raise error(f"{target}: cannot be written ({fault.strerror or fault})") from None
        yield [f"{target}: the lock of {holder}, which has ended, is taken over"] if holder else []
    finally:
        _release(path, handle, ours)


def lock(handle: int) -> bool | None:
    """Lock an open file; False if another process holds the lock, None where the file system has no locks."""
    try:
        if os.name == "nt":
            import msvcrt

            os.lseek(handle, _FAR, os.SEEK_SET)
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
        else:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return False if os.name == "nt" else None  # on Windows a held lock is a PermissionError
    return True


def names_file(path: str | Path, handle: int) -> bool:
    """Whether a path is the regular file that is open, not another of the same name."""
    try:
        there, opened = os.stat(path, follow_symlinks=False), os.fstat(handle)
    except OSError:
        return False
    return stat.S_ISREG(there.st_mode) and os.path.samestat(there, opened)


def remove_abandoned(path: str | Path) -> None:
    """Remove a file that its writer keeps locked, unless the writer lives; others, and links, stay."""
    if os.name == "nt":
        with suppress(OSError):  # an open file cannot be removed there
            os.unlink(path)
        return
    try:
        handle = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return
    try:
        if lock(handle) and names_file(path, handle):
            os.unlink(path)
    finally:
        os.close(handle)


def _release(path: Path, handle: int, ours: bool) -> None:
    if ours and os.name != "nt":  # before the lock is released, so that nobody else locks an unlinked file
        path.unlink(missing_ok=True)
    if handle >= 0:
        os.close(handle)
    if ours and os.name == "nt":
        with suppress(OSError):
            path.unlink(missing_ok=True)


# ---- the holder ----


def _sign(handle: int) -> None:
    os.lseek(handle, 0, os.SEEK_SET)
    os.ftruncate(handle, 0)
    os.write(handle, f"process {os.getpid()} on {platform.node()}".encode())


def _holder(handle: int) -> str:
    """The process named in a lock file; empty if there is none."""
    os.lseek(handle, 0, os.SEEK_SET)
    return os.read(handle, 200).decode("utf-8", "replace")


def _lives(holder: str) -> bool:
    """Whether a holder is another living process of this machine."""
    words = holder.split()
    if words[2:] != ["on", platform.node()] or not words[1].isdigit() or int(words[1]) == os.getpid():
        return False
    try:
        os.kill(int(words[1]), 0)
    except OSError as fault:
        return isinstance(fault, PermissionError)
    return True
