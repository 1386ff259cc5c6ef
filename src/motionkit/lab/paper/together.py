"""Networks trained in the same steps on one GPU, which a small network alone leaves waiting for its next kernel.

The seeds of a network are stacked (StackedLearner), and each stack has a stream of its own. Networks whose windows are
drawn alike see the same windows, which are made once. A run that is stopped begins anew.
"""

from __future__ import annotations

import itertools
import json
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from motionkit.data.dataset import Dataset
from motionkit.features.control import ControlLayout
from motionkit.files import atomic_write
from motionkit.lab.paper.datasets import select
from motionkit.lab.paper.runs import (
    Plan,
    Task,
    check_writable,
    machine,
    model_file,
    options_of,
    run_all,
    run_one,
)
from motionkit.lab.paper.side_by_side import side_by_side
from motionkit.lab.paper.variants import Variant, variant
from motionkit.models.architectures import build, network_class
from motionkit.models.batch import Batch
from motionkit.models.checkpoint import save_model
from motionkit.models.network import PartTransformer
from motionkit.models.presets import preset
from motionkit.names import counted
from motionkit.training.bundle import bundle_model
from motionkit.training.learner import Learner, StackedLearner
from motionkit.training.objective import TrainingModule
from motionkit.training.options import TrainOptions, with_changes
from motionkit.training.processes import Processes, resolve_device
from motionkit.training.progress import Progress
from motionkit.training.sampler import WindowSampler
from motionkit.training.window_loader import StepLoader

LOGGED = 100  # lines in the log of a run


@dataclass(eq=False)
class Stack:
    """The seeds of one network.

    Attributes:
        learners: one for all seeds, or one per seed where torch cannot stack the network.
        streams: one per learner, on a GPU.
        log: steps, seconds and, by name, the losses (S,) of all seeds.
    """

    options: list[TrainOptions]
    learners: list[Learner]
    streams: list[torch.cuda.Stream]
    log: list[tuple[int, float, dict[str, Tensor]]] = field(default_factory=list)

    def step(self, batch: Batch, at: Progress, logs: bool) -> None:
        """Make a step with a batch (S, B, ...), on a GPU at the same time as other stacks."""
        parts = [batch] if self.learners[0].seeds > 1 else [batch[i] for i in range(len(batch.inputs))]
        lines = []
        for i, (learner, part) in enumerate(zip(self.learners, parts, strict=True)):
            with torch.cuda.stream(self.streams[i]) if self.streams else nullcontext():
                if self.streams:
                    self.streams[i].wait_stream(torch.cuda.default_stream(batch.inputs.device))
                terms = learner.step(part, self.options[0], at)
                if logs:
                    lines.append({name: value.reshape(-1).clone() for name, value in terms.items()})
        if logs:
            self.log.append((at.step + 1, at.seconds, _joined(lines)))


def _joined(lines: Sequence[dict[str, Tensor]]) -> dict[str, Tensor]:
    return lines[0] if len(lines) == 1 else {n: torch.cat([line[n] for line in lines]) for n in lines[0]}


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
    learners: list[Learner]
    if len(modules) > 1 and not config.variant.recurrent:
        learners = [StackedLearner(modules, options[0], processes)]
    else:
        learners = [
            Learner(m.network, dataset, each, processes) for m, each in zip(modules, options, strict=True)
        ]
    for learner in learners:
        learner.module.train()
    streams = [torch.cuda.Stream(device) for _ in learners] if device.type == "cuda" else []
    return Stack(list(options), learners, streams)


def train_together(
    dataset: Dataset,
    stacks: Sequence[Stack],
    device: torch.device,
    progress: Callable[[float], None],
) -> int:
    """Train stacks of part transformers with the same seeds, and as many steps or minutes, and return their steps."""
    options = stacks[0].options[0]
    at, logged = Progress(options), max(1, (options.steps or 10 * LOGGED) // LOGGED)
    alike: list[list[Stack]] = []  # networks whose windows are drawn alike
    for each in stacks:
        known = [group for group in alike if group[0].options[0].sampler == each.options[0].sampler]
        if known:
            known[0].append(each)
        else:
            alike.append([each])
    groups = [(_batches(dataset, group[0].options, device), group) for group in alike]
    began = time.monotonic()
    while at.share < 1.0:
        logs = at.step % logged == 0 or at.step + 1 == options.steps
        # Kept until the streams of all have been waited for: memory that is free takes the next batch at once.
        inputs = [next(batches) for batches, _ in groups]
        for batch, (_, group) in zip(inputs, groups, strict=True):
            for each in group:
                each.step(batch, at, logs)
        for stream in (stream for each in stacks for stream in each.streams):
            torch.cuda.current_stream(device).wait_stream(stream)
        at.step += 1
        if (at.step == 1 or at.step % 10 == 0) and device.type == "cuda":
            torch.cuda.synchronize(device)
        began = time.monotonic() if at.step == 1 else began  # without the captures of the first step
        at.seconds = time.monotonic() - began
        progress(at.share)
    for batches, _ in groups:
        batches.close()
    return at.step


def _batches(
    dataset: Dataset, options: Sequence[TrainOptions], device: torch.device
) -> Generator[Batch, None, None]:
    """Yield the batches (S, B, ...) of all seeds, step by step, on the device."""
    kind = preset(options[0].preset, **options[0].config).controls
    samplers = [WindowSampler(dataset, each.sampler, each.seed, (), kind) for each in options]
    size = options[0].optimizer.batch

    def made(step: int) -> Batch:
        return Batch.joined([sampler.batch(step, size) for sampler in samplers], torch.stack)

    loader = StepLoader(made, device.type == "cuda")
    try:
        for step in itertools.count():
            yield loader.next(step).to(device)
    finally:
        loader.close()


# ---- runs of an experiment ----


def run_together(
    plan: Plan,
    tasks: Sequence[Task],
    jobs: int,
    say: Callable[[str], None],
    progress: Callable[[float], None],
) -> Generator[Path, None, None]:
    """As run_all, but part transformers train together, and `jobs` processes test them; other runs come after them."""
    grouped = [(each, seed) for each, seed in tasks if _trains_together(plan, each)]
    others = [task for task in tasks if task not in grouped]
    share = len(grouped) / max(1, len(tasks))
    if grouped:
        train_all(plan, grouped, say, lambda done: progress(0.7 * share * done))
        works = [
            (f"{each.name}, seed {seed}", partial(_test, plan, each.name, seed)) for each, seed in grouped
        ]
        yield from side_by_side(works, jobs, say, lambda done: progress(share * (0.7 + 0.3 * done)))
    yield from run_all(plan, others, jobs, say, lambda done: progress(share + (1.0 - share) * done))


def _trains_together(plan: Plan, each: Variant) -> bool:
    if not each.preset:
        return False
    options = options_of(plan, each, 0)
    return network_class(preset(options.preset, **options.config).architecture) is PartTransformer


def train_all(
    plan: Plan,
    tasks: Sequence[Task],
    say: Callable[[str], None],
    progress: Callable[[float], None],
    minutes: float | None = None,
) -> Plan:
    """Train part transformers together, those with the same seeds at a time, and write models and logs for run_one.

    Args:
        minutes: ends the training of all at the same step, in place of the plan's number of steps.

    Returns:
        The plan with the number of steps that were made.

    Raises:
        DatasetError: if the dataset does not fit.
    """
    check_writable(plan)
    dataset, device = select(plan.data, plan.selection), resolve_device(plan.device)
    seeds: dict[str, tuple[int, ...]] = {}
    for each, seed in tasks:
        seeds[each.name] = (*seeds.get(each.name, ()), seed)
    # Products this small gain less from 16 bits than the kernels that convert to them cost.
    changes: dict[str, Any] = {"precision": "float32"}
    if minutes is not None:
        changes |= {"steps": None, "minutes": minutes}
    alike = list(dict.fromkeys(seeds.values()))
    for number, found in enumerate(alike):
        names = [name for name, of_name in seeds.items() if of_name == found]
        say(f"{counted(len(names), 'network')} with {counted(len(found), 'seed')} each, together")
        stacks = {
            name: stack(
                dataset,
                [with_changes(options_of(plan, variant(name), seed), changes) for seed in found],
                device,
            )
            for name in names
        }
        steps = train_together(
            dataset,
            list(stacks.values()),
            device,
            lambda done, n=number: progress((n + done) / len(alike)),  # type: ignore[misc]
        )
        plan = replace(plan, steps=steps) if minutes is not None else plan
        for name, trained in stacks.items():
            _write(plan, variant(name), trained, dataset)
    return plan


def _write(plan: Plan, each: Variant, trained: Stack, dataset: Dataset) -> None:
    """Write the models and logs of all seeds of a network."""
    weights = [found for learner in trained.learners for found in learner.averages()]
    for i, (options, average) in enumerate(zip(trained.options, weights, strict=True)):
        path = model_file(plan, each, options.seed)
        network = trained.learners[0].network
        averaged = build(network.config, network.control_size)
        averaged.load_state_dict(average)
        card = {"options": options.to_dict(), "steps": plan.steps, "machine": machine(plan.device)}
        (path.with_suffix(".run")).mkdir(parents=True, exist_ok=True)
        save_model(path, bundle_model(averaged.weights(), dataset, card, references=False), False)
        with atomic_write(path.with_suffix(".run") / "log.jsonl", "w") as file:
            for step, seconds, losses in trained.log:
                numbers = {name: float(value[i]) for name, value in losses.items()}
                line = {"kind": "log", "step": step, "seconds": seconds, "rate": options.optimizer.rate}
                file.write(json.dumps(line | numbers) + "\n")


def _test(plan: Plan, name: str, seed: int, progress: Callable[[float], None]) -> Path:
    return run_one(plan, variant(name), seed, lambda text: None, progress, trained=True)
