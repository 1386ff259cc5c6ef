"""`motionkit train`: trains a model on a dataset folder."""

from __future__ import annotations

import math
import sys
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.common import (
    EXISTING_FOLDER,
    FILE,
    FOLDER,
    STOPPED,
    gathered,
    json_option,
    option,
    print_json,
    remark,
    say,
    seed_option,
)
from motionkit.cli.finite import FiniteRange
from motionkit.cli.training_monitor import TrainingMonitor, check_preview
from motionkit.errors import OverwriteError
from motionkit.files import check_outputs
from motionkit.names import nfc
from motionkit.training.budgets import BUDGETS
from motionkit.training.log_folder import LogFolder, check_table

if TYPE_CHECKING:
    from motionkit.training.options import TrainOptions
    from motionkit.training.report import TrainEvent

BUNDLED, BUNDLED_PRESET = "bundled", "tptn"  # the model that training starts from, and its preset
PRESET_CHOICES = ("tptn", "tptn-paper", "ebtn", "fptn-r", "fptn-s", "5ptn", "tiny")


def _names(context: click.Context, parameter: click.Parameter, text: str | None) -> tuple[str, ...]:
    """Parse names separated by commas."""
    return tuple(filter(None, (nfc(word.strip()) for word in (text or "").split(","))))


def _type_weights(context: click.Context, parameter: click.Parameter, text: str | None) -> dict[str, float]:
    """Parse relative frequencies of motion types, such as "kicking=2,idle=0.5"."""
    weights = {}
    for word in _names(context, parameter, text):
        name, _, times = word.rpartition("=")
        try:
            weights[name.strip()] = float(times)
        except ValueError:
            weights[name.strip()] = math.nan
        if not name.strip() or not 0.0 <= weights[name.strip()] <= 1000.0:
            raise click.BadParameter(f"{word!r}: expected TYPE=NUMBER, with a number from 0 to 1000")
    return weights


@dataclass(frozen=True)
class InitialModel:
    """The model that training starts from."""

    init: str | None
    from_scratch: bool
    add: bool

    def of(self, preset: str) -> str | None:
        """The initial model, None for random weights; raises UsageError for contradictory options."""
        if self.from_scratch and (self.init or self.add):
            other = "--init" if self.init else "--add"
            raise click.UsageError(f"--from-scratch cannot be combined with {other}")
        init = self.init
        if init is None and not self.from_scratch and preset == BUNDLED_PRESET:
            init = BUNDLED
        if self.add and init is None:
            raise click.UsageError(
                f"--add needs a model to begin from; give --init, or the preset {BUNDLED_PRESET}"
            )
        return init


@dataclass(frozen=True)
class Run:
    """Output files of training, and whether it resumes."""

    output: Path
    run_folder: Path | None
    log_dir: Path | None
    preview: Path | None
    force: bool
    resume: bool
    as_json: bool

    @property
    def folder(self) -> Path:
        """The run folder; by default beside the model."""
        return self.run_folder or self.output.with_suffix(".run")

    def check(self, inputs: list[str | Path | None]) -> None:
        """Refuse, before any work, to overwrite an input, or an earlier run unless it is resumed or discarded."""
        check_preview(self.preview)
        if self.output.suffix.lower() != ".safetensors":
            raise click.UsageError(f"-o {self.output}: expected a name that ends in .safetensors")
        check_outputs([self.output, *([self.preview] if self.preview else [])], inputs)
        if self.resume and self.force:
            raise click.UsageError("--resume cannot be combined with --force")
        if self.log_dir and not self.force:
            check_table(self.log_dir, self.resume)
        if self.resume or self.force:
            return
        for path in (self.output, self.folder / "checkpoint.safetensors"):
            if path.exists():
                raise OverwriteError(f"{path}: exists; continue with --resume, or overwrite it with --force")


@click.command("train")
@click.argument("dataset", type=EXISTING_FOLDER)
@option("-o", "--output", default="model.safetensors", type=FILE, help="Model file to write.")
@option(
    "--preset",
    default="tptn",
    type=click.Choice(PRESET_CHOICES),
    help="Network and training settings (docs/training.md).",
)
@click.option(
    "--minutes",
    type=FiniteRange(min=0.01),
    help="Training time in minutes: 5 by default, from random weights 30; with --steps, whichever ends first.",
)
@click.option("--steps", type=click.IntRange(min=1), help="Number of training steps.")
@click.option(
    "--budget",
    type=click.Choice(tuple(BUDGETS)),
    help="For tptn-paper: steps, batch, window and rate for a CPU, for a GPU, or the paper's own.",
)
@click.option("--force", is_flag=True, help="Overwrite an existing model and run folder.")
@click.option("--resume", is_flag=True, help="Continue from the checkpoint in the run folder.")
@click.option(
    "--init",
    type=click.Path(),
    help="Model file to start from; by default the bundled model, if it has the same preset.",
)
@click.option("--from-scratch", is_flag=True, help="Start from random weights.")
@click.option("--add", is_flag=True, help="Also keep the types of the model that training starts from.")
@click.option(
    "--batch",
    type=click.IntRange(1, 4096),
    help="Windows per training step; the preset's by default (16; tptn-paper 56).",
)
@click.option(
    "--window",
    type=click.IntRange(16, 1200),
    help="Frames per window; the preset's by default (96; tptn-paper 300).",
)
@click.option("--rate", type=FiniteRange(1e-7, 1.0), help="Peak learning rate; the preset's by default.")
@click.option(
    "--cycles",
    type=click.IntRange(1, 100),
    help="Times that the learning rate falls from its peak; 1 by default. The model is the mean of their ends.",
)
@click.option(
    "--optimizer",
    "method",
    type=click.Choice(["muon", "adamw"]),
    help="Optimizer of the matrices within layers; by default muon from random weights, adamw from a model and for "
    "tptn-paper.",
)
@click.option(
    "--type-weights",
    metavar="TYPE=TIMES,...",
    callback=_type_weights,
    help="Sample types more or less often than the preset does: kicking=2,idle=0.5.",
)
@click.option(
    "--step-weight",
    type=FiniteRange(0.0, 1000.0),
    help="Weight of the loss on foot sliding; by default 0, and 10 once the network makes steps.",
)
@click.option(
    "--step-except",
    metavar="TYPE,...",
    callback=_names,
    help="Types to which --step-weight does not apply.",
)
@click.option(
    "--reference-dropout",
    type=FiniteRange(0.0, 1.0),
    help="Share of training windows without reference poses; the preset's by default (0.5; tptn-paper 1). A larger "
    "share teaches the network to move without them.",
)
@click.option(
    "--trajectory-drift",
    type=FiniteRange(0.0, 1.0),
    help="Standard deviation of a factor on the trajectory of training windows that go straight; 0 by default. 0.15 "
    "keeps tptn-paper, which is fed its own trajectory, from speeding up.",
)
@click.option(
    "--splices",
    type=click.IntRange(0, 100_000),
    help="Number of spliced transitions to make; by default 400 from a model, 2000 from random weights, fewer in short "
    "runs, 0 for tptn-paper.",
)
@click.option(
    "--run-folder",
    type=FOLDER,
    help="Folder for checkpoint, log.jsonl and samples; beside the model by default.",
)
@click.option(
    "--log-dir",
    type=FOLDER,
    help="Folder for log.csv and, where TensorBoard is installed, its event files.",
)
@option("--device", default="auto", help="Device to train on: auto, cpu, cuda, cuda:1 ...")
@option(
    "--precision",
    default="auto",
    type=click.Choice(["auto", "float32", "bfloat16"]),
    help="Number format of the network's arithmetic.",
)
@click.option(
    "--score-minutes",
    type=FiniteRange(min=0.1),
    help="Minutes between evaluations by roll-outs; 10 by default, 1 with --preview.",
)
@click.option(
    "--preview",
    type=FILE,
    help="Page (.html) or contact sheet (.png) of the motions of each evaluation so far.",
)
@click.option("--half", is_flag=True, help="Store weights and start poses in 16 bits, half the size.")
@seed_option
@json_option
@gathered("begins", InitialModel)
@gathered("run", Run)
def command(
    dataset: Path,
    begins: InitialModel,
    run: Run,
    preset: str,
    device: str,
    score_minutes: float | None,
    **changes: Any,
) -> None:
    """Train a motion model on a DATASET folder made by preprocess.

    Training starts from the bundled model and takes 5 minutes by default; --from-scratch starts from random
    weights and takes 30, or an hour and more for a good model. A checkpoint is written every 40 seconds. Ctrl-C
    writes the model as it is, and --resume continues the run exactly. For several processes: torchrun
    --nproc-per-node N -m motionkit train DATASET ...
    """
    init = begins.of(preset)
    run.check([init if init != BUNDLED else None, *dataset.glob("*")])

    import motionkit as mk
    from motionkit.data.repeat import small_types

    options = _options(preset, init, begins.add, score_minutes or (1.0 if run.preview else None), changes)
    monitor = TrainingMonitor(
        run.as_json, options, run.preview, run.folder / "samples", small_types(mk.Dataset(dataset))
    )
    with monitor, LogFolder(run.log_dir, run.resume, remark) if run.log_dir else nullcontext() as logs:

        def tell(event: TrainEvent) -> None:
            monitor(event)
            if logs is not None:
                logs(event)

        result = mk.train(dataset, run.output, options, run.resume, run.run_folder, device, tell)
    if not monitor.first_process:
        return
    summary = {
        "model": result.model,
        "steps": result.steps,
        "seconds": round(result.seconds, 1),
        "finished": result.finished,
        "losses": result.losses,
    }
    word = "trained" if result.finished else "stopped"
    # No losses mean that the resumed run had finished before.
    loss = f"loss {result.losses['total']:.2f}" if "total" in result.losses else "no step was left to make"
    if run.as_json:
        print_json(summary)
    else:
        say(f"{word} after {result.steps} steps, {result.seconds / 60:.1f} min; {loss}; wrote {result.model}")
    if not result.finished:
        sys.exit(STOPPED)


def _options(
    preset: str, init: str | None, add: bool, score_minutes: float | None, changes: dict[str, Any]
) -> TrainOptions:
    """The training options; changes are arguments of train_options."""
    import motionkit as mk

    make = mk.train_options if init is None else partial(mk.fine_tune_options, init=init)
    from motionkit.training.presets import FINE_TUNE_MINUTES, KEPT_SHARE, TRAIN_MINUTES

    if changes["minutes"] is None and changes["steps"] is None and changes["budget"] is None:
        changes |= {"minutes": TRAIN_MINUTES if init is None else FINE_TUNE_MINUTES}
    return make(preset, kept_share=KEPT_SHARE if add else None, score_minutes=score_minutes, **changes)
