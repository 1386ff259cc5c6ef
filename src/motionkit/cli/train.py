"""`motionkit train`: a dataset folder to a model file."""

from __future__ import annotations

import math
import sys
from functools import partial
from pathlib import Path

import click

from motionkit.cli.common import STOPPED, json_option, print_json, seed_option, stdout_console
from motionkit.cli.finite import FiniteRange
from motionkit.cli.training_monitor import TrainingMonitor, check_preview
from motionkit.errors import MotionkitError, OverwriteError
from motionkit.files import check_outputs
from motionkit.names import nfc
from motionkit.training.budgets import BUDGETS

BUNDLED, BUNDLED_PRESET = "bundled", "tptn"  # the model that training begins from, and the preset it has
KEPT_SHARE = 0.5  # of the windows, with --add, are of the types that the model knew
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


@click.command("train")
@click.argument("dataset", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "-o",
    "--output",
    default="model.safetensors",
    show_default=True,
    type=click.Path(dir_okay=False, path_type=Path),
    help="Model file to write.",
)
@click.option(
    "--preset",
    default="tptn",
    show_default=True,
    type=click.Choice(PRESET_CHOICES),
    help="Network and training settings (docs/training.md).",
)
@click.option(
    "--minutes",
    type=FiniteRange(min=0.01),
    help="Training time in minutes, unless --steps is given: 5 by default, from random weights 30.",
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
    help="Model file to begin from; by default the bundled model, if it has the same preset.",
)
@click.option("--from-scratch", is_flag=True, help="Begin from random weights.")
@click.option("--add", is_flag=True, help="Also keep the types of the model that training begins from.")
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
    "--optimizer",
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
    help="Weight of the loss on foot sliding against the recording; 0 by default, 35 gives firm feet.",
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
    help="Share of training windows without reference poses; the preset's by default (0.5; tptn-paper 1). More of "
    "them teach the network to do without.",
)
@click.option(
    "--trajectory-drift",
    type=FiniteRange(0.0, 1.0),
    help="Standard deviation of a factor on the trajectory of training windows that go straight; 0 by default. "
    "0.15 keeps a tptn-paper that is fed its own trajectory from going ever faster.",
)
@click.option(
    "--splices",
    type=click.IntRange(0, 100_000),
    help="Number of spliced transitions to make; the preset's by default (2000; tptn-paper 0).",
)
@click.option(
    "--run-folder",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for checkpoint, log.jsonl and samples; beside the model by default.",
)
@click.option(
    "--device", default="auto", show_default=True, help="Device to train on: auto, cpu, cuda, cuda:1 ..."
)
@click.option(
    "--precision",
    default="auto",
    show_default=True,
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
    type=click.Path(dir_okay=False, path_type=Path),
    help="Page (.html) or contact sheet (.png) of the motions of each evaluation so far.",
)
@click.option("--half", is_flag=True, help="Store the weights in 16 bits, half the size.")
@seed_option()
@json_option
def command(
    dataset: Path,
    output: Path,
    preset: str,
    minutes: float | None,
    steps: int | None,
    budget: str | None,
    resume: bool,
    force: bool,
    init: str | None,
    from_scratch: bool,
    add: bool,
    batch: int | None,
    window: int | None,
    rate: float | None,
    optimizer: str | None,
    type_weights: dict[str, float],
    step_weight: float | None,
    step_except: tuple[str, ...],
    reference_dropout: float | None,
    trajectory_drift: float | None,
    splices: int | None,
    run_folder: Path | None,
    device: str,
    precision: str,
    score_minutes: float | None,
    preview: Path | None,
    half: bool,
    seed: int,
    as_json: bool,
) -> None:
    """Train a motion model on a DATASET folder made by preprocess.

    Training begins from the bundled model and takes minutes; --from-scratch begins from random weights and
    takes an hour and more. A checkpoint is written every 40 seconds. Ctrl-C writes the model as it is, and
    --resume continues the run exactly. For several processes: torchrun --nproc-per-node N -m motionkit train
    DATASET ...
    """
    init = _beginning(init, from_scratch, add, preset)
    check_preview(preview)
    check_outputs(
        [output, *([preview] if preview else [])], [init if init != BUNDLED else None, *dataset.glob("*")]
    )
    if not resume and not force:
        _refuse_to_replace(output, run_folder or output.with_suffix(".run"))

    from importlib.util import find_spec

    if find_spec("torch") is None:
        raise MotionkitError("training needs torch: pip install 'motionkit[train]'")
    from motionkit.api import FINE_TUNE_MINUTES, TRAIN_MINUTES
    from motionkit.data.amounts import small_types
    from motionkit.data.dataset import Dataset
    from motionkit.training.presets import fine_tune_options, train_options
    from motionkit.training.trainer import train

    if minutes is None and steps is None and budget is None:
        minutes = TRAIN_MINUTES if init is None else FINE_TUNE_MINUTES
    options = (train_options if init is None else partial(fine_tune_options, init=init))(
        preset,
        steps=steps,
        minutes=minutes,
        budget=budget,
        kept_share=KEPT_SHARE if add else None,
        batch=batch,
        window=window,
        rate=rate,
        method=optimizer,
        type_weights=type_weights,
        step_weight=step_weight,
        step_except=step_except,
        reference_dropout=reference_dropout,
        trajectory_drift=trajectory_drift,
        splices=splices,
        seed=seed,
        precision=precision,
        score_minutes=score_minutes or (1.0 if preview else None),
        half=half,
    )
    samples = (run_folder or output.with_suffix(".run")) / "samples"
    monitor = TrainingMonitor(as_json, options, preview, samples, small_types(Dataset(dataset)))
    with monitor:
        result = train(dataset, output, options, resume, run_folder, device, monitor)
    if not monitor.first_process:
        return
    summary = {
        "model": str(result.model),
        "steps": result.steps,
        "seconds": round(result.seconds, 1),
        "finished": result.finished,
        "losses": result.losses,
    }
    if as_json:
        print_json(summary)
        return
    word = "trained" if result.finished else "stopped"
    # Without losses no step was made: the run had gone as far before.
    loss = f"loss {result.losses['total']:.2f}" if "total" in result.losses else "no step was left to make"
    stdout_console().print(
        f"{word} after {result.steps} steps, {result.seconds / 60:.1f} min; {loss}; wrote {result.model}",
    )
    if not result.finished:
        sys.exit(STOPPED)


def _beginning(init: str | None, from_scratch: bool, add: bool, preset: str) -> str | None:
    """The model to begin from, None for random weights. Raises UsageError for options that contradict each other."""
    if from_scratch and (init or add):
        raise click.UsageError(f"--from-scratch cannot be combined with {'--init' if init else '--add'}")
    if init is None and not from_scratch and preset == BUNDLED_PRESET:
        init = BUNDLED
    if add and init is None:
        raise click.UsageError(
            f"--add needs a model to begin from; give --init, or the preset {BUNDLED_PRESET}"
        )
    return init


def _refuse_to_replace(model: Path, run_folder: Path) -> None:
    for path in (model, run_folder / "checkpoint.safetensors"):
        if path.exists():
            raise OverwriteError(f"{path}: exists; continue with --resume, or overwrite it with --force")
