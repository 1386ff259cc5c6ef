"""A training step as `motionkit train` makes it, part by part, against the same step without its fast paths.

    python benchmarks/training_step.py [--dataset FOLDER] [--threads 2]

Plain means: attention over blocks in torch instead of C, windows on predictions in torch in float32 instead of the C
step, AdamW parameter by parameter, and Muon in float32. Weights, windows and losses are the same; the losses of the
first step are compared. Both run in turn, and the best of their times counts, because other work on the machine only
adds to them; --cpu-time takes the time of the processor. Without a dataset the sample motion of examples/data is used.
gpu_job.py times a GPU.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from unittest.mock import patch

import torch
from common import SAMPLE_FOLDER, print_table

from motionkit.data.dataset import Dataset
from motionkit.data.preprocess import preprocess
from motionkit.training.presets import train_options
from motionkit.training.trainer import TrainingRun

PARTS = ("windows", "windows on predictions", "losses and gradients", "optimizer and average")


@contextmanager
def plain_paths() -> Iterator[None]:
    """Turn the fast paths off."""

    def in_torch(network, batch, device):
        return network.stream(batch).step

    with ExitStack() as stack:
        stack.enter_context(patch("motionkit.models.attention.can_attend", lambda *_: False))
        stack.enter_context(patch("motionkit.training.scheduled_sampling._frame_step", in_torch))
        yield


class Timed:
    """A run whose parts of a step are timed."""

    def __init__(self, dataset: Path, folder: Path, arguments: argparse.Namespace, plain: bool) -> None:
        options = train_options(
            arguments.preset,
            steps=10_000,
            batch=arguments.batch,
            window=arguments.window,
            splices=20,
            stages=(),
        )
        self.run = TrainingRun(Dataset(dataset), folder / "m.safetensors", options, device="cpu")
        self.run.sampler.make_splices()
        self.plain, self.clock = plain, time.process_time if arguments.cpu_time else time.perf_counter
        if plain:
            settings, made = options.optimizer, self.run.learner.optimizers
            made[0] = torch.optim.AdamW(
                made[0].param_groups[0]["params"], lr=settings.rate, betas=settings.betas, foreach=True
            )
            for other in made[1:]:
                other.bfloat16 = False
        self.losses: dict[str, float] = {}

    def timed(self, work: Callable[[], object]) -> float:
        """Return the seconds of some work."""
        began = self.clock()
        work()
        return self.clock() - began

    def step(self) -> list[float]:
        """Make a step of average cost and return the seconds of its PARTS."""
        with plain_paths() if self.plain else ExitStack():
            return self._step()

    def _step(self) -> list[float]:
        run, learner, at = self.run, self.run.learner, self.run.progress
        options = at.options
        period = options.scheduled_sampling.period
        windows = self.timed(lambda: run.sampler.batch(at.step, options.optimizer.batch))
        # A block makes the windows of all its steps, and runs some of them on predictions.
        block = self.timed(lambda: setattr(self, "batch", run.blocks.next(at.step, 0.0)))
        predictions = max(0.0, block / period - windows)
        learner.module.train()

        def gradients() -> None:
            self.terms = learner.gradients(self.batch, 0.0)

        def update() -> None:
            learner.update(torch.tensor(at.rate), torch.tensor(0.002))

        seconds = [windows, predictions, self.timed(gradients), self.timed(update)]
        self.losses = self.losses or {name: float(value) for name, value in self.terms.items()}
        at.step += period
        run.blocks.close()
        return seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--preset", default="tptn")
    parser.add_argument("--dataset", type=Path, help="dataset folder; the sample motion by default")
    parser.add_argument("--batch", type=int, default=16, help="windows per step")
    parser.add_argument("--window", type=int, default=96, help="frames per window")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--threads", type=int, default=1, help="torch threads")
    parser.add_argument("--cpu-time", action="store_true", help="time of the processor instead of the clock")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if arguments.dataset is None:
            preprocess([SAMPLE_FOLDER], folder / "dataset")
        dataset = arguments.dataset or folder / "dataset"
        runs = [Timed(dataset, folder, arguments, plain) for plain in (True, False)]
        measured: list[list[list[float]]] = [[], []]
        for _ in range(arguments.repeats + 1):  # the first warms up
            for rounds, run in zip(measured, runs, strict=True):
                rounds.append(run.step())
    plain, fast = ([min(column) for column in zip(*rounds[1:], strict=True)] for rounds in measured)
    rows = [
        [part, f"{1000 * a:.1f}", f"{1000 * b:.1f}", f"{a / b:.2f}" if b else ""]
        for part, a, b in zip((*PARTS, "step"), [*plain, sum(plain)], [*fast, sum(fast)], strict=True)
    ]
    kind = "processor" if arguments.cpu_time else "clock"
    title = (
        f"{arguments.preset}, {arguments.batch} windows of {arguments.window} frames, "
        f"{arguments.threads} threads, ms of the {kind} (best of {arguments.repeats})"
    )
    print_table(title, ["part of a step", "plain", "as trained", "times as fast"], rows)
    a, b = runs[0].losses, runs[1].losses
    off = max(abs(a[name] - b[name]) / (abs(a[name]) + 1e-6) for name in a)
    print(f"losses of the first step differ by at most {off:.1e} of their value")
    print(f"ratio: {sum(plain) / sum(fast):.2f} times as many steps as the plain step")


if __name__ == "__main__":
    main()
