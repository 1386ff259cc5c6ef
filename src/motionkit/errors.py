"""Errors that users can cause. Any other exception is a bug and may show a traceback."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from motionkit.names import visible

LONGEST = 1500  # characters of a message


class MotionkitError(Exception):
    """An error in a user's file or request, as a one-line message.

    Control characters of what it quotes are escaped, and the middle of a very long quotation is left out.
    """

    def __init__(self, message: str) -> None:
        text = visible(message)
        if len(text) > LONGEST:
            text = f"{text[: LONGEST // 2]} ... {text[-LONGEST // 2 :]}"
        super().__init__(text)


class BvhError(MotionkitError):
    """An invalid BVH file; the message names the file and, if known, the line."""

    def __init__(self, path: str | Path, message: str, line: int | None = None) -> None:
        self.path, self.found = str(path), message
        self.line = line
        where = f"{path}:{line}" if line is not None else f"{path}"
        super().__init__(f"{where}: {message}")


class OverwriteError(MotionkitError):
    """An output that would overwrite an input, or a file that the user did not ask to replace."""


class SkeletonError(MotionkitError):
    """A rig that cannot be retargeted to the canonical skeleton, or two rigs that do not match."""


class DatasetError(MotionkitError):
    """An incomplete or inconsistent dataset folder or label table."""


class ModelError(MotionkitError):
    """An invalid model file, or one that does not fit the request."""


class ControlError(MotionkitError):
    """An unknown motion type or character, or an invalid path or control."""


@contextmanager
def naming(file: object, kind: type[MotionkitError] = SkeletonError) -> Iterator[None]:
    """Put the name of a file before errors of a kind, by default about its rig, from what knows only its contents."""
    try:
        yield
    except kind as error:
        raise kind(f"{file}: {error}") from None
