"""Files that appear whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from motionkit.errors import MotionkitError


@contextmanager
def atomic_write(path: str | Path, mode: str = "w") -> Iterator[IO]:
    """Open a file beside path for writing and put it in place when the block ends without a fault.

    Raises MotionkitError if the place cannot be written (a missing folder, a full disk); path is
    untouched then.
    """
    path = Path(path)
    if path.is_dir():
        raise MotionkitError(f"{path}: is a folder, expected a file to write")
    if path.exists() and not path.is_file():  # a rename would put a file where a device was
        raise MotionkitError(f"{path}: is not a regular file, expected a file to write")
    temporary = ""
    try:
        target = Path(os.path.realpath(path))  # a link stays a link
        handle, temporary = tempfile.mkstemp(prefix=f".{target.name[:40]}.", dir=target.parent)
        with os.fdopen(handle, mode, encoding=None if "b" in mode else "utf-8") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)
        os.replace(temporary, target)
    except OSError as error:
        raise MotionkitError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        if temporary and os.path.exists(temporary):
            os.unlink(temporary)
