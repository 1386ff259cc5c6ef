"""The faults a user can cause; everything else is ours and may show a traceback."""

from __future__ import annotations

from pathlib import Path


class MotionkitError(Exception):
    """A fault in a user's file or request, told in one line."""


class BvhError(MotionkitError):
    """A BVH file that cannot be read; names the file and, where known, the line."""

    def __init__(self, path: str | Path, message: str, line: int | None = None) -> None:
        self.path = str(path)
        self.line = line
        where = f"{path}:{line}" if line is not None else f"{path}"
        super().__init__(f"{where}: {message}")


class OverwriteError(MotionkitError):
    """An output that would destroy what the command reads, or what it must not replace unasked."""


class SkeletonError(MotionkitError):
    """A rig that cannot be mapped onto the canonical skeleton, or two rigs that do not match."""


class DatasetError(MotionkitError):
    """A dataset folder or label table that is missing something or is inconsistent."""


class ModelError(MotionkitError):
    """A model file that is not one, or does not fit the request."""


class ControlError(MotionkitError):
    """A motion type, path or character that nobody knows."""
