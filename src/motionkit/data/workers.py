"""Processes that share work by item, and end with the process that started them, however it ends."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess

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
        started: set[BaseProcess] = set()

        def each(function: Callable, items: list) -> Iterator:
            others = set(multiprocessing.active_children())
            with _ctrl_c_held():
                waiting = deque(pool.submit(function, item) for item in items)
                started.update(set(multiprocessing.active_children()) - others)
            return _results(waiting)

        try:
            yield each
        except BaseException:
            for process in started:
                process.kill()  # also those that still import, and hear nothing
            raise


def _results(waiting: deque[Future]) -> Iterator:
    """In order, none kept longer than asked for; pool.map cancels those left over, over which pools that end fall."""
    while waiting:
        yield waiting.popleft().result()


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
