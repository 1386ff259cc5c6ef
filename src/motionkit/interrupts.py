"""Delays Ctrl-C and SIGTERM while temporary files are created, so that they can always be removed."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager

_depth = 0
_postponed: int | None = None


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Delay the command line's signal handler until the end of a block.

    Masking the signal would not help: the system may deliver it to another thread, and Python still runs the handler in
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
    """For signal handlers: whether an `uninterrupted` block is running; it then handles the signal at its end."""
    global _postponed
    if _depth == 0:
        return False
    _postponed = number
    return True
