"""Windows made by other processes while a GPU works on those before them."""

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
    """The batches of a sampler step after step, or one process's share of the windows.

    A window costs Python a millisecond, and a GPU takes some thousands a second. Processes that are forked have the
    spliced transitions in common with this one; where there is no fork, batches are made when they are asked for.
    """

    def __init__(self, sampler: WindowSampler, size: int, places: range) -> None:
        """Args: size: windows of a whole batch; places: which of them are wanted."""
        self.sampler, self.size, self.places = sampler, size, places
        self._step, self._options = -1, sampler.options
        self._coming: Iterator[dict[str, Tensor]] = iter(())

    def next(self, step: int) -> Batch:
        """Return the windows of a step, sampled as the sampler is set now."""
        options = self.sampler.options
        if step != self._step or options != self._options:  # the processes know the sampler as it was
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
    """Ctrl-C reaches every process of a terminal: only the run itself is to answer, after the current step.

    Processes whose run has died see it and end.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
