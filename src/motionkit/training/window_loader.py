"""Makes windows in other processes while a GPU trains on earlier ones."""

from __future__ import annotations

import itertools
import multiprocessing
import signal
from collections.abc import Iterator

import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from motionkit.models.batch import Batch
from motionkit.native import cores
from motionkit.training.sampler import WindowSampler

AHEAD = 2  # batches that each process makes in advance


class WindowLoader:
    """The batches of a sampler, step by step, or one process's share of their windows.

    A window takes Python a millisecond, and a GPU trains on thousands a second. Forked processes share the memory of
    the spliced transitions; without fork, batches are made in this process as they are needed.
    """

    def __init__(self, sampler: WindowSampler, size: int, places: range) -> None:
        """Make no batch yet.

        Args:
            size: windows of a whole batch.
            places: the windows of the batch that this process needs.
        """
        self.sampler, self.size, self.places = sampler, size, places
        self._step, self._options = -1, sampler.options
        self._coming: Iterator[dict[str, Tensor]] = iter(())

    def next(self, step: int) -> Batch:
        """Return the windows of a step, with the sampler's present options."""
        options = self.sampler.options
        if step != self._step or options != self._options:  # the processes have a copy of the earlier sampler
            self._options, self._coming = options, self._begin(step)
        self._step = step + 1
        return Batch(**next(self._coming))

    def close(self) -> None:
        """End the processes."""
        self._step, self._coming = -1, iter(())

    def _begin(self, step: int) -> Iterator[dict[str, Tensor]]:
        forks = "fork" in multiprocessing.get_all_start_methods()
        count = max(1, cores() - 1) if forks else 0
        loader = DataLoader(
            _Steps(self.sampler, self.size, self.places),
            batch_size=None,
            sampler=itertools.count(step),
            num_workers=count,
            multiprocessing_context="fork" if forks else None,
            prefetch_factor=AHEAD if forks else None,
            pin_memory=torch.cuda.is_available(),
            worker_init_fn=_leave_signals,
        )
        return iter(loader)


class _Steps(Dataset[dict[str, Tensor]]):
    """Batches by step."""

    def __init__(self, sampler: WindowSampler, size: int, places: range) -> None:
        self.sampler, self.size, self.places = sampler, size, places

    def __getitem__(self, step: int) -> dict[str, Tensor]:
        return vars(self.sampler.batch(step, self.size, self.places.start, len(self.places)))


def _leave_signals(_: int) -> None:
    """Ignore Ctrl-C and SIGTERM in a worker: they reach every process, but only the run itself handles them.

    Workers end by themselves if the run dies.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
