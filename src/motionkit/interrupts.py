"""Puts Ctrl-C and SIGTERM off for the few instructions that create something which must be removed again."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager

_depth = 0
_postponed: int | None = None


@contextmanager
def uninterrupted() -> Iterator[None]:
    """A block that the command line's signal handler does not interrupt; a signal is handled at its end.

    Masking the signal would not do: the system may deliver it to another thread, and Python still runs the handler in
    the main thread.
    """
    global _depth, _postponed
    _depth += 1
    try:
        yield
    finally:
        _depth -= 1
        number = _postponed
        if _depth == 0 and number is not None:
            _postponed = None
            signal.raise_signal(number)


def postpone(number: int) -> bool:
    """For signal handlers: whether a block of `uninterrupted` is running, which then handles the signal at its end."""
    global _postponed
    if _depth == 0:
        return False
    _postponed = number
    return True
