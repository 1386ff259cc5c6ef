"""Processes that share work by item, and end with the process that started them, however it ends."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection

# Maps a function over items, in order.
Map = Callable[[Callable, list], Iterator]


@contextmanager
def worker_processes(count: int) -> Iterator[Map]:
    """A map over items by so many processes; in this process for one.

    When the block is left by a fault or Ctrl-C, or this process dies, the others end at once, whatever they do.
    """
    if count <= 1:
        yield map
        return
    context = multiprocessing.get_context("spawn")
    theirs, ours = context.Pipe(duplex=False)
    with ours, theirs, ProcessPoolExecutor(count, context, _begin_worker, (theirs,)) as pool:

        def each(function: Callable, items: list) -> Iterator:
            with _ctrl_c_held():
                return pool.map(function, items, chunksize=1)

        try:
            yield each
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            ours.close()
            raise


def _begin_worker(parent: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the parent decides
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: Connection) -> None:
    """Wait for the end of a pipe that only the parent can write to."""
    with suppress(EOFError, OSError):
        parent.recv_bytes()
    os._exit(1)


@contextmanager
def _ctrl_c_held() -> Iterator[None]:
    """Hold Ctrl-C back; processes started meanwhile never get it, not even while they import."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
