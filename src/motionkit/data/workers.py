"""Worker processes that end when their parent process ends, even if it is killed."""

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
from typing import Any

from motionkit.reading import read_settings, reading

# A function like map, whose results come in order.
Map = Callable[[Callable, list], Iterator]
# With fewer files than this per process, starting the process takes longer than it saves.
_FILES_PER_PROCESS = 40


def processes_for(files: int, jobs: int = 0) -> int:
    """Number of processes for short work on files, if the user gives none."""
    return jobs or min(os.cpu_count() or 1, files // _FILES_PER_PROCESS)


@contextmanager
def worker_processes(count: int) -> Iterator[Map]:
    """A map over this many processes; a count of one uses the present process.

    They read files with the present settings (motionkit.reading).

    The workers end at once if an error or Ctrl-C leaves the block, or if the present process dies.
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
            with ctrl_c_blocked():
                waiting = deque(pool.submit(_as_here, read_settings(), function, item) for item in items)
                started.update(set(multiprocessing.active_children()) - others)
            return _results(waiting)

        try:
            yield each
        except BaseException:
            for process in started:
                process.kill()  # not terminate: a worker that is still importing ignores other signals
            raise


def _as_here(how: dict[str, Any], function: Callable, item: Any) -> Any:
    with reading(**how):
        return function(item)


def _results(waiting: deque[Future]) -> Iterator:
    """Results in order, each released once it is taken.

    pool.map would cancel the remaining items, which breaks a pool that is being closed.
    """
    while waiting:
        yield waiting.popleft().result()


def _begin_worker(parent: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the parent decides
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: Connection) -> None:
    """End this process when the pipe from its parent closes."""
    with suppress(EOFError, OSError):
        parent.recv_bytes()
    os._exit(1)


@contextmanager
def ctrl_c_blocked() -> Iterator[None]:
    """Block Ctrl-C; processes that are started meanwhile never receive it, not even while they import."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
