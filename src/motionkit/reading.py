"""How files are read: with faults settled and told in a note, or strictly; and what the user says of them."""

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
class _Manner:
    """How files are read.

    Attributes:
        strict: refuse faults that could be settled.
        hear: is told what was settled.
        up: the axis that points up in all files, such as "+Z"; None to find it.
        cm: cm per unit of all files; None to find it.
        animation: the name of the animation to read from files that have several, or ALL.
        joints: canonical joints to the joints of files that have all of them; None to find them.
    """

    strict: bool = False
    hear: Callable[[str], None] = _warn
    up: str | None = None
    cm: float | None = None
    animation: str | None = None
    joints: dict[str, str] | None = None


_manner: ContextVar[_Manner] = ContextVar("manner", default=_Manner())  # noqa: B039 (it is frozen)


def strictly() -> bool:
    """Whether files with faults are refused instead of read with a note."""
    return _manner.get().strict


def told_up() -> str | None:
    """The up axis that the user gives, such as "+Z"; None if it is to be found."""
    return _manner.get().up


def told_cm() -> float | None:
    """The cm per unit that the user gives; None if they are to be found."""
    return _manner.get().cm


def told_animation() -> str | None:
    """The name of the animation to read from files that have several, or ALL; None if the user gives none."""
    return _manner.get().animation


def told_joints() -> dict[str, str] | None:
    """The bone map that the user gives, canonical joints to names of joints; None if they are to be found."""
    return _manner.get().joints


def manner() -> dict[str, Any]:
    """The present arguments of reading(), but for the listener: what another process needs to read alike."""
    given = vars(_manner.get())
    return {name: value for name, value in given.items() if name != "hear"}


def tell(path: str | Path, notes: tuple[str, ...]) -> None:
    """Say in one line what was settled in a file; a Python warning unless a caller listens."""
    if notes:
        _manner.get().hear(f"{Path(path).name}: read with {'; '.join(notes)}")


def retell(note: str) -> None:
    """Say a note that was heard elsewhere, such as in another process."""
    _manner.get().hear(note)


@contextmanager
def reading(
    strict: bool | None = None,
    hear: Callable[[str], None] | None = None,
    up: str | None = None,
    cm: float | None = None,
    animation: str | None = None,
    joints: dict[str, str] | None = None,
) -> Iterator[None]:
    """Read files within the block in this manner (_Manner); None leaves a field as it is."""
    given = {"strict": strict, "hear": hear, "up": up, "cm": cm, "animation": animation, "joints": joints}
    changed: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    token = _manner.set(replace(_manner.get(), **changed))
    try:
        yield
    finally:
        _manner.reset(token)
