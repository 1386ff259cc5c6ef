"""How files are read: with faults repaired and reported in a note, or strictly; and what the user says of them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

ALL = "all"  # as an animation: each of a file


def _warn(note: str) -> None:
    warnings.warn(note, stacklevel=5)


@dataclass(frozen=True)
class _ReadSettings:
    """How files are read.

    Attributes:
        strict: refuse faults that could be repaired.
        on_note: is called with each note.
        up: the axis that points up in all files, such as "+Z"; None to find it.
        cm: cm per unit of all files; None to find it.
        animation: the name of the animation to read from files that have several, or ALL.
        joints: canonical joints to the joints of files that have all of them; None to find them.
    """

    strict: bool = False
    on_note: Callable[[str], None] = _warn
    up: str | None = None
    cm: float | None = None
    animation: str | None = None
    joints: dict[str, str] | None = None


_settings: ContextVar[_ReadSettings] = ContextVar("settings", default=_ReadSettings())  # noqa: B039 (frozen)


def strictly() -> bool:
    """Whether files with faults are refused instead of read with a note."""
    return _settings.get().strict


def user_up() -> str | None:
    """The up axis that the user gives, such as "+Z"; None if it is to be found."""
    return _settings.get().up


def user_cm() -> float | None:
    """The cm per unit that the user gives; None if they are to be found."""
    return _settings.get().cm


def user_animation() -> str | None:
    """The name of the animation to read from files that have several, or ALL; None if the user gives none."""
    return _settings.get().animation


def user_joints() -> dict[str, str] | None:
    """The bone map that the user gives, canonical joints to names of joints; None if they are to be found."""
    return _settings.get().joints


def read_settings() -> dict[str, Any]:
    """The present arguments of reading(), but for the listener: what another process needs to read alike."""
    arguments = vars(_settings.get())
    return {name: value for name, value in arguments.items() if name != "on_note"}


def report_notes(path: str | Path, notes: tuple[str, ...]) -> None:
    """Report in one line what was repaired in a file; a Python warning unless a caller listens."""
    if notes:
        _settings.get().on_note(f"{Path(path).name}: read with {'; '.join(notes)}")


def report_note(note: str) -> None:
    """Report a note of another process."""
    _settings.get().on_note(note)


@contextmanager
def reading(
    strict: bool | None = None,
    on_note: Callable[[str], None] | None = None,
    up: str | None = None,
    cm: float | None = None,
    animation: str | None = None,
    joints: dict[str, str] | None = None,
) -> Iterator[None]:
    """Read files within the block with these settings (_ReadSettings); None leaves a field as it is."""
    arguments = {
        "strict": strict,
        "on_note": on_note,
        "up": up,
        "cm": cm,
        "animation": animation,
        "joints": joints,
    }
    changed: dict[str, Any] = {name: value for name, value in arguments.items() if value is not None}
    token = _settings.set(replace(_settings.get(), **changed))
    try:
        yield
    finally:
        _settings.reset(token)


@contextmanager
def as_found() -> Iterator[None]:
    """Read files within the block as those of a rig, of whose up axis, unit and joints the user says nothing."""
    token = _settings.set(replace(_settings.get(), up=None, cm=None, joints=None))
    try:
        yield
    finally:
        _settings.reset(token)
