"""How files are read: with faults settled and told in a note, or strictly."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from pathlib import Path


def _warn(note: str) -> None:
    warnings.warn(note, stacklevel=5)


@dataclass(frozen=True)
class _Manner:
    """Whether to refuse faults that could be settled, and who is told what was settled."""

    strict: bool = False
    hear: Callable[[str], None] = _warn


_manner: ContextVar[_Manner] = ContextVar("manner", default=_Manner())  # noqa: B039 (it is frozen)


def strictly() -> bool:
    """Whether files with faults are refused instead of read with a note."""
    return _manner.get().strict


def tell(path: str | Path, notes: tuple[str, ...]) -> None:
    """Say in one line what was settled in a file; a Python warning unless a caller listens."""
    if notes:
        _manner.get().hear(f"{Path(path).name}: read with {'; '.join(notes)}")


@contextmanager
def reading(strict: bool | None = None, hear: Callable[[str], None] | None = None) -> Iterator[None]:
    """Read files within the block strictly or not, and pass their notes to hear; None leaves either as it is."""
    now = _manner.get()
    token = _manner.set(
        replace(now, strict=now.strict if strict is None else strict, hear=now.hear if hear is None else hear)
    )
    try:
        yield
    finally:
        _manner.reset(token)
