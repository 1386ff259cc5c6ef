"""Makes batches of windows in blocks of steps.

Windows with scheduled sampling run frame by frame on the network's predictions, which is efficient for many windows at
once. So the windows of a block of steps run together, with the weights and settings of its first step. Both are kept,
so that a run can stop and resume within a block.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from motionkit.models.batch import Batch, FeatureSpace
from motionkit.models.predictor import Predictor
from motionkit.training.options import TrainOptions
from motionkit.training.sampler import WindowSampler, window_generator
from motionkit.training.scheduled_sampling import PredictedInputs, sampled_windows
from motionkit.training.window_loader import StepLoader


@dataclass(frozen=True, eq=False)
class BlockStart:
    """The state of a run at the first step of a block: progress, the finished share, and the network's weights."""

    step: int
    progress: float
    weights: dict[str, Tensor]


class WindowBlocks:
    """The batches of a run, or of one process's share of the windows.

    Attributes:
        start: state at the first step of the present block; None before the first block. A resumed run sets it.
        options: settings of the present block.
    """

    def __init__(
        self, sampler: WindowSampler, network: Predictor, options: TrainOptions, places: range
    ) -> None:
        self.sampler, self.network, self.run, self.places = sampler, network, options, places
        self.options = options.at(0.0)
        self.start: BlockStart | None = None
        device = next(network.parameters()).device
        self.predicted = PredictedInputs(
            network,
            torch.from_numpy(sampler.windows.references.matrix).to(device),
            FeatureSpace.of(sampler.dataset).to(device),
        )
        self._coming: list[Batch] = []
        self._loader = StepLoader(self._recorded, device.type != "cpu")

    def next(self, step: int, progress: float) -> Batch:
        """Return the batch of a step; progress is the finished share of the run."""
        if not self._coming:
            weights = {name: value.detach().clone() for name, value in self.network.state_dict().items()}
            self._begin(BlockStart(step, progress, weights))
        return self._coming.pop(0)

    def close(self) -> None:
        """Drop the remaining batches, and end the processes that make windows."""
        self._coming = []
        self._loader.close()

    @property
    def unfinished(self) -> BlockStart | None:
        """The start of the present block if some of its batches are not used yet; else None."""
        return self.start if self._coming else None

    def resume(self, step: int) -> None:
        """Make the batches of the block that began at self.start again, if there is one, and continue at a step."""
        start = self.start
        if start is None:
            return
        now = {name: value.detach().clone() for name, value in self.network.state_dict().items()}
        self.network.load_state_dict(start.weights)
        self._begin(start)
        self.network.load_state_dict(now)
        del self._coming[: step - start.step]

    def _begin(self, start: BlockStart) -> None:
        self.start, self.options = start, self.run.at(start.progress)
        if self.options.sampler != self.sampler.options:
            self._loader.close()  # its processes have a copy of the earlier sampler
        self.sampler.use(self.options.sampler)
        self._coming = self._make(range(start.step, self._end(start.step)))

    def _end(self, step: int) -> int:
        """Return the step after the last one of a step's block, which ends with its cycle of the rate."""
        period = self.options.scheduled_sampling.period if self.options.scheduled_sampling.share else 1
        end = (step // period + 1) * period
        steps, cycles = self.run.steps, self.run.optimizer.cycles
        if not steps:
            return end
        cycle = step * cycles // steps + 1
        return min(end, -(-cycle * steps // cycles))

    def _make(self, steps: range) -> list[Batch]:
        """Make the batches of some steps, with scheduled sampling in some windows."""
        options, places = self.options, self.places
        device = next(self.network.parameters()).device
        batches = [self._loader.next(step).to(device) for step in steps]
        share, period = options.scheduled_sampling.share, options.scheduled_sampling.period
        # Windows are counted through the block, because few windows of one step have no such share.
        firsts = [step % period * self.run.optimizer.batch + places.start for step in steps]
        fed = [sampled_windows(first, len(places), share) for first in firsts]
        if not any(fed):
            return batches
        generators = [
            window_generator(options.seed, step, places[i], 1, device)
            for step, chosen in zip(steps, fed, strict=True)
            for i in chosen
        ]
        recorded = [batch[chosen] for batch, chosen in zip(batches, fed, strict=True)]
        joined = self.predicted(Batch.joined(recorded), options.scheduled_sampling, generators)
        made, end = [], 0
        for batch, chosen in zip(batches, fed, strict=True):
            begin, end = end, end + len(chosen)
            others = [i for i in range(len(places)) if i not in chosen]
            made.append(Batch.joined([joined[begin:end], batch[others]]))
        return made

    def _recorded(self, step: int) -> Batch:
        """Return the windows of a step with recorded inputs."""
        return self.sampler.batch(step, self.run.optimizer.batch, self.places.start, len(self.places))
