"""Long works side by side, each in a process of its own that can be told to stop after its present step."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from types import FrameType

from motionkit.data.workers import ctrl_c_blocked
from motionkit.errors import MotionkitError
from motionkit.interrupts import postpone


@dataclass
class _Running:
    """A run in a process: its name, what it says, and the share that is done."""

    name: str
    process: SpawnProcess
    heard: Connection
    share: float = 0.0
    result: Path | None = None
    fault: str | None = None

    def listen(self) -> bool:
        """Take one message, and return whether there may be more."""
        try:
            kind, value = self.heard.recv()
        except (EOFError, OSError):  # it ended
            return False
        setattr(self, kind, value)
        return True


def side_by_side(
    works: Sequence[tuple[str, partial[Path]]],
    jobs: int,
    say: Callable[[str], None],
    progress: Callable[[float], None],
) -> Generator[Path, None, None]:
    """Do named works, so many at a time, and yield each file as it is written.

    Where the iterator is left early, by Ctrl-C or an error, works in flight are asked to stop, and are waited for: a
    training ends after its step and writes its checkpoint. What has not begun never does. A second Ctrl-C ends all at
    once.

    Raises:
        MotionkitError: a work failed, or its process was killed.
    """
    waiting, running, done = deque(works), list[_Running](), 0
    try:
        while waiting or running:
            while waiting and len(running) < jobs:
                name, work = waiting.popleft()
                say(name)
                running.append(_start(name, work))
            ready = wait([each.heard for each in running])
            for each in [each for each in running if each.heard in ready]:
                if each.listen():
                    continue
                running.remove(each)
                file, done = _ended(each), done + 1
                yield file
            progress((done + sum(each.share for each in running)) / len(works))
    finally:
        _stop(running)


def _start(name: str, work: partial[Path]) -> _Running:
    ours, theirs = multiprocessing.Pipe(duplex=False)
    process = multiprocessing.get_context("spawn").Process(target=_serve, args=(work, theirs), daemon=True)
    if os.name == "posix":
        resource_tracker.ensure_running()  # else the first start would begin it, and let Ctrl-C through again
    with ctrl_c_blocked():  # the key reaches all processes of a terminal; the parent decides
        process.start()
    theirs.close()  # so that the end of the process ends what is heard
    return _Running(name, process, ours)


def _ended(run: _Running) -> Path:
    """Return the file of a run whose process has ended."""
    run.process.join()
    run.heard.close()
    if run.fault is not None:
        raise MotionkitError(run.fault)
    if run.result is None:
        raise MotionkitError(
            f"{run.name}: its process ended before its result (exit code {run.process.exitcode}); was it killed for "
            "want of memory? The same command continues, and fewer --jobs need less"
        )
    return run.result


def _stop(running: Sequence[_Running]) -> None:
    """End all runs: after their step, or at once if this is interrupted as well."""
    try:
        for each in running:
            each.process.terminate()
        for each in running:
            each.process.join()
    finally:
        for each in running:
            each.process.kill()


def _serve(work: partial[Path], parent: Connection) -> None:
    """Do a work in this process; a parent that stops, or dies, stops it."""
    signal.signal(signal.SIGTERM, _interrupt)
    threading.Thread(target=_stop_with_parent, daemon=True).start()

    def tell(kind: str, value: object) -> None:
        with suppress(OSError):  # nobody listens any more
            parent.send((kind, value))

    try:
        tell("result", work(lambda share: tell("share", share)))
    except KeyboardInterrupt:
        sys.exit(1)
    except MotionkitError as error:
        tell("fault", str(error))
    except MemoryError:
        tell("fault", "not enough memory; the same command continues, and fewer --jobs need less")


def _interrupt(number: int, frame: FrameType | None) -> None:
    if not postpone(number):
        raise KeyboardInterrupt


def _stop_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)
