"""Networks trained in the same steps on one GPU, which a small network alone leaves waiting for its next kernel.

The seeds of a network are stacked (StackedLearner), and each stack has a stream of its own. Networks whose windows are
drawn alike see the same windows, which are made once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field

import torch
from torch import Tensor

from motionkit.data.dataset import Dataset
from motionkit.features.control import ControlLayout
from motionkit.models.architectures import build
from motionkit.models.batch import Batch
from motionkit.models.network import PartTransformer
from motionkit.models.presets import preset
from motionkit.training.learner import Learner, StackedLearner
from motionkit.training.objective import TrainingModule
from motionkit.training.options import TrainOptions
from motionkit.training.processes import Processes
from motionkit.training.progress import Progress
from motionkit.training.sampler import WindowSampler
from motionkit.training.window_loader import StepLoader

LOGGED = 100  # losses of a run that are kept


@dataclass(eq=False)
class Stack:
    """The seeds of one network.

    Attributes:
        options: of its training; all have its step count.
        learners: one for all seeds, or one per seed where torch cannot stack the network.
        curve: step and total loss (S,) of each seed, as they are logged.
    """

    options: TrainOptions
    learners: list[Learner]
    stream: torch.cuda.Stream | None
    curve: list[tuple[int, Tensor]] = field(default_factory=list)
    losses: dict[str, Tensor] = field(default_factory=dict)

    def step(self, batch: Batch, at: Progress) -> None:
        """Make a step with a batch (S, B, ...), at the same time as other stacks."""
        with torch.cuda.stream(self.stream) if self.stream else nullcontext():
            if self.stream:
                self.stream.wait_stream(torch.cuda.default_stream(self.stream.device))
            parts = [batch] if self.learners[0].seeds > 1 else _seeds(batch)
            terms = [
                learner.step(part, self.options, at)
                for learner, part in zip(self.learners, parts, strict=True)
            ]
            if at.step % max(1, (self.options.steps or 1) // LOGGED) == 0:
                self.losses = {
                    name: torch.stack([each[name] for each in terms]).reshape(-1).clone() for name in terms[0]
                }
                self.curve.append((at.step, self.losses["total"]))

    def averages(self) -> list[dict[str, Tensor]]:
        """Return the weights of each seed's network by name, on the CPU."""
        return [each for learner in self.learners for each in learner.averages()]


def _seeds(batch: Batch) -> list[Batch]:
    """Return the batch of each seed."""
    count = len(batch.inputs)
    return [Batch(**{name: value[i] for name, value in vars(batch).items()}) for i in range(count)]


def stack(dataset: Dataset, options: Sequence[TrainOptions], device: torch.device) -> Stack:
    """Return the networks of some seeds, whose options differ by the seed alone, before their first step."""
    processes, config = Processes(device), preset(options[0].preset, **options[0].config)
    layout = ControlLayout(dataset.types, config.controls)
    modules = []
    for each in options:
        torch.manual_seed(each.seed)
        network = build(config, layout.size)
        assert isinstance(network, PartTransformer)
        modules.append(TrainingModule(network, dataset, each.losses))
        modules[-1].train()
    stacks = len(modules) > 1 and config.variant.backbone != "lstm"
    learners: list[Learner] = (
        [StackedLearner(modules, options[0], processes)]
        if stacks
        else [
            Learner(module.network, dataset, each, processes)
            for module, each in zip(modules, options, strict=True)
        ]
    )
    for learner in learners:
        learner.module.train()
    return Stack(options[0], learners, torch.cuda.Stream(device) if device.type == "cuda" else None)


def train_together(
    dataset: Dataset,
    stacks: Mapping[str, Stack],
    seeds: Sequence[int],
    device: torch.device,
    progress: Callable[[float], None],
) -> None:
    """Train stacks of part transformers with the same seeds, batches and steps to their end."""
    first = next(iter(stacks.values())).options
    at, steps = Progress(first), first.steps or 0
    alike: list[list[Stack]] = []  # networks whose windows are drawn alike
    for each in stacks.values():
        found = next((group for group in alike if group[0].options.sampler == each.options.sampler), None)
        if found is None:
            alike.append([each])
        else:
            found.append(each)
    groups = [(_batches(dataset, group[0].options, seeds, device), group) for group in alike]
    while at.step < steps:
        for batches, group in groups:
            batch = next(batches)
            for each in group:
                each.step(batch, at)
        for each in stacks.values():
            if each.stream:
                torch.cuda.current_stream(device).wait_stream(each.stream)
        at.step += 1
        if at.step % 10 == 0:
            progress(at.step / steps)


def _batches(
    dataset: Dataset, options: TrainOptions, seeds: Sequence[int], device: torch.device
) -> Iterator[Batch]:
    """Yield the batches (S, B, ...) of all seeds, step by step, on the device."""
    kind = preset(options.preset, **options.config).controls
    samplers = [WindowSampler(dataset, options.sampler, seed, (), kind) for seed in seeds]
    size = options.optimizer.batch

    def made(step: int) -> Batch:
        batches = [sampler.batch(step, size) for sampler in samplers]
        return Batch(
            **{name: torch.stack([vars(each)[name] for each in batches]) for name in vars(batches[0])}
        )

    loader = StepLoader(made, device.type == "cuda")
    try:
        for step in range(options.steps or 0):
            yield loader.next(step).to(device)
    finally:
        loader.close()
