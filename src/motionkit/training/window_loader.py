"""Makes windows in other processes while a GPU trains on earlier ones."""

from __future__ import annotations

import itertools
import multiprocessing
import signal
from collections.abc import Callable, Iterator

import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from motionkit.models.batch import Batch
from motionkit.native import cores

AHEAD = 2  # batches that each process makes in advance


class StepLoader:
    """The batches of steps, made ahead by forked processes, which share the memory of the spliced transitions.

    A window takes Python a millisecond, and a GPU trains on thousands a second. Without fork, batches are made in this
    process as they are needed.
    """

    def __init__(self, make: Callable[[int], Batch], ahead: bool = True) -> None:
        """Make no batch yet, but know the function that makes that of a step, and whether to use processes."""
        self.make, self.ahead = make, ahead and "fork" in multiprocessing.get_all_start_methods()
        self._step = -1
        self._coming: Iterator[dict[str, Tensor]] = iter(())

    def next(self, step: int) -> Batch:
        """Return the batch of a step."""
        if not self.ahead:
            return self.make(step)
        if step != self._step:
            self._coming = self._begin(step)
        self._step = step + 1
        return Batch(**next(self._coming))

    def close(self) -> None:
        """End the processes; the next batch is made anew."""
        self._step, self._coming = -1, iter(())

    def _begin(self, step: int) -> Iterator[dict[str, Tensor]]:
        loader = DataLoader(
            _Steps(self.make),
            batch_size=None,
            sampler=itertools.count(step),
            num_workers=max(1, cores() - 1),
            multiprocessing_context="fork",
            prefetch_factor=AHEAD,
            pin_memory=torch.cuda.is_available(),
            worker_init_fn=_leave_signals,
            generator=torch.Generator(),  # the run's own random state stays
        )
        return iter(loader)


class _Steps(Dataset[dict[str, Tensor]]):
    """Batches by step."""

    def __init__(self, make: Callable[[int], Batch]) -> None:
        self.make = make

    def __getitem__(self, step: int) -> dict[str, Tensor]:
        return vars(self.make(step))


def _leave_signals(_: int) -> None:
    """Ignore Ctrl-C and SIGTERM in a worker: they reach every process, but only the run itself handles them.

    Workers end by themselves if the run dies.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
