"""The training loop: windows in, a model file out. A run that stops and resumes gives the same result."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from motionkit.data.dataset import Dataset
from motionkit.errors import DatasetError, ModelError, MotionkitError
from motionkit.locks import locked
from motionkit.models.file_check import check_names
from motionkit.models.network import parameter_count
from motionkit.training.initial_network import begin
from motionkit.training.learner import Learner
from motionkit.training.options import TrainOptions
from motionkit.training.outcome import Outcome
from motionkit.training.presets import FINE_TUNE_MINUTES, fine_tune_options
from motionkit.training.processes import Processes
from motionkit.training.progress import Progress, beside_the_paper
from motionkit.training.report import RunReport, TrainEvent
from motionkit.training.run_state import Checkpoint
from motionkit.training.sampler import WindowSampler
from motionkit.training.window_blocks import WindowBlocks

TWICE = 1.0  # seconds within which a second signal counts as the first


@dataclass(frozen=True)
class TrainResult:
    """The result of a run; finished is false if the run was stopped before its end."""

    model: Path
    steps: int
    seconds: float
    finished: bool
    losses: dict[str, float]


def train(
    dataset_folder: str | Path | Dataset,
    output: str | Path = "model.safetensors",
    options: TrainOptions | None = None,
    resume: bool = False,
    run_folder: str | Path | None = None,
    device: str = "auto",
    on_event: Callable[[TrainEvent], None] | None = None,
) -> TrainResult:
    """Train on a dataset folder and write one model file. Needs torch.

    Args:
        dataset_folder: the folder that preprocess wrote, or an open dataset.
        output: the model file, written at the end and on Ctrl-C; an old one is replaced.
        options: from train_options; by default the preset tptn for 5 minutes from the bundled model.
        resume: continue from the run folder's checkpoint; losses are the same as without the break.
        run_folder: folder for the checkpoint and log.jsonl; by default output with the ending ".run".
        device: "auto", "cpu", "cuda" or "cuda:1".
        on_event: called with each report, in the first process only.

    Raises:
        DatasetError: if the dataset does not fit the preset.
        ModelError: if the checkpoint is damaged or does not fit the options.
        MotionkitError: another process trains in the run folder.
    """
    options = options or fine_tune_options("tptn", minutes=FINE_TUNE_MINUTES)
    # Training adds clips of its own to the dataset.
    dataset = dataset_folder.copy() if isinstance(dataset_folder, Dataset) else Dataset(dataset_folder)
    run = TrainingRun(dataset, Path(output), options, run_folder, device, on_event)
    with run.alone():
        if resume:
            run.resume()
        return run.go()


class TrainingRun:
    """A run of train(), with the same arguments."""

    def __init__(
        self,
        dataset: Dataset,
        output: Path,
        options: TrainOptions,
        run_folder: str | Path | None = None,
        device: str = "auto",
        on_event: Callable[[TrainEvent], None] | None = None,
    ) -> None:
        folder = Path(run_folder) if run_folder else output.with_suffix(".run")
        self.processes = Processes.join(device)
        places = self.processes.places(options.optimizer.batch)
        try:  # now, not hours later when the model is written
            check_names(list(dataset.types), list(dict.fromkeys(["default", *dataset.characters])))
        except ModelError as error:
            raise DatasetError(f"{dataset.folder}: {error}") from None
        torch.manual_seed(options.seed)
        self.checkpoint = Checkpoint(folder, dataset, options)  # before the dataset gets more clips
        self.initial = begin(dataset, options)
        network, kept = self.initial.network, tuple(self.initial.kept)
        self.learner = Learner(network, dataset, options, self.processes)
        self.progress = Progress(options)
        self.report = RunReport(folder, self.progress, on_event, self.processes.first)
        self.outcome = Outcome(output, dataset, self.initial, self.learner, self.report)
        self.sampler = WindowSampler(dataset, options.sampler, options.seed, kept, self.initial.layout.kind)
        self.blocks = WindowBlocks(self.sampler, network, options, places)
        self.stop_requested = self.stops = False

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Hold the lock of the run folder for a block. Raises MotionkitError if another process trains there."""
        if not self.processes.first:
            yield
            return
        with locked(self.report.folder, "training here") as notes:
            for line in notes:
                self.report.note(line)
            yield

    def resume(self) -> None:
        """Continue from the checkpoint. Raises DatasetError or ModelError if there is none or it does not fit."""
        self.blocks.start = self.checkpoint.load(self.learner, self.progress)
        self.sampler.use(self.checkpoint.options.sampler)

    def go(self) -> TrainResult:
        """Train until the end or a signal, and write the model and the checkpoint."""
        self._prepare()
        previous = self._catch_signals()
        finished, begun = False, self.progress.step
        try:
            self._loop()
            finished = self.progress.share >= 1.0
            # A run that had ended already has written its model, with sampling presets and scores.
            if self.processes.first and not (
                begun and self.progress.step == begun and self.outcome.path.exists()
            ):
                self._save_all()
        finally:
            self.blocks.close()
            for number, handler in previous.items():
                signal.signal(number, handler)
        if self.processes.first:
            if not finished:
                self.report.note("stopped; continue with --resume")
            elif self.outcome.calibrate_and_score():
                self.outcome.save()  # again, now with sampling presets and scores
        self.processes.leave()
        at = self.progress
        return TrainResult(self.outcome.path, at.step, at.seconds, finished, at.losses)

    def _prepare(self) -> None:
        """Make folders and spliced transitions, and report the size of the run."""
        report, at = self.report, self.progress
        for folder in (report.folder, self.outcome.path.parent):  # an error comes now, not after hours
            try:
                folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise MotionkitError(
                    f"{folder}: cannot be written ({error.strerror or error}); choose another --run-folder or -o"
                ) from None
        if at.step == 0 and self.processes.first:
            report.clear()
        parameters = parameter_count(self.learner.network) / 1e6
        report.note(f"{parameters:.2f} M parameters on {self.processes.device}")
        if self.initial.repeated:
            report.note(f"recordings of {', '.join(self.initial.repeated)} repeated: they are few and short")
        self.sampler.make_splices(report.stage("making spliced transitions"))
        report.note(f"{len(self.sampler.splices)} spliced transitions")
        self.blocks.resume(at.step)
        for line in beside_the_paper(at.options, len(self.sampler.cuts)):
            report.note(line)

    def _catch_signals(self) -> dict[int, Any]:
        """Make Ctrl-C and SIGTERM end the run after the present step, because a checkpoint holds whole steps only.

        A second signal after more than TWICE seconds ends it at once; timeout and torchrun send every signal twice.
        """
        heard = 0.0

        def stop(number: int, frame: Any) -> None:
            nonlocal heard
            if self.stop_requested:
                if time.monotonic() - heard > TWICE:
                    raise KeyboardInterrupt
                return
            self.stop_requested, heard = True, time.monotonic()
            self.report.emit("stop", "stopping after this step")

        try:
            return {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
        except ValueError:  # not in the main thread
            return {}

    def _loop(self) -> None:
        at, report, options = self.progress, self.report, self.progress.options.output
        clock = saved = scored = time.monotonic()
        while at.share < 1.0:
            self._train_step()
            now = time.monotonic()
            at.seconds, clock = at.seconds + now - clock, now
            if at.options.minutes:
                at.seconds = self.processes.agree(at.seconds)
            report.emit("step")
            if at.step % options.log_every == 0 or at.share >= 1.0:
                report.emit("log")
            if self.processes.first and now - saved > options.checkpoint_seconds:
                report.attempt("the checkpoint", self._save_checkpoint)
                saved = time.monotonic()
            if self.processes.first and now - scored > 60.0 * options.score_minutes:
                self.outcome.score()
                scored = time.monotonic()
            if self.stops or (self.processes.world == 1 and self.stop_requested):
                return

    def _train_step(self) -> None:
        at, processes = self.progress, self.processes
        self.learner.trainable.train()
        if processes.world > 1:
            # Dropout must differ between processes and be the same after a resume. The checkpoint holds only the
            # first process's random state, so each step sets its own seed.
            torch.manual_seed((at.options.seed + 1) * 1_000_003 + at.step * processes.world + processes.rank)
        batch = self.blocks.next(at.step, at.share)
        terms = self.learner.step(batch, self.blocks.options, at)
        at.step += 1
        # A GPU computes the next steps meanwhile: its numbers are only waited for where they are logged.
        waits = processes.device.type == "cpu" or processes.world > 1
        if waits or at.step % at.options.output.log_every == 0 or at.share >= 1.0:
            # Shared, so that all processes stop at the same step.
            stop = terms["gradient"].new_tensor(float(self.stop_requested))
            *means, stops = processes.mean(torch.stack([*terms.values(), stop]))
            self.stops = stops > 0
            at.losses = dict(zip(terms, means, strict=True))

    def _save_checkpoint(self) -> None:
        self.checkpoint.save(self.learner, self.progress, self.blocks.unfinished)
        self.report.emit("checkpoint")

    def _save_all(self) -> None:
        """Write the model and the checkpoint, even if one of them fails, and then raise the first error."""
        faults = []
        for save in (self.outcome.save, self._save_checkpoint):
            try:
                save()
            except MotionkitError as fault:
                faults.append(fault)
        if faults:
            raise faults[0]
