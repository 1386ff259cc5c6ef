"""`motionkit quickstart`: a folder of clips to a model, a page, a sheet and a plain verdict."""

from __future__ import annotations

import math
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import click

from motionkit.cli.common import (
    STOPPED,
    json_option,
    print_json,
    progress_bar,
    remark,
    say,
    seed_option,
    stages_on,
)
from motionkit.errors import MotionkitError, OverwriteError

if TYPE_CHECKING:
    from motionkit.data.dataset import Dataset
    from motionkit.evaluation.quick import TypeVerdict
    from motionkit.models.model import MotionModel
    from motionkit.motion.motion import Motion

SHOWN_SECONDS = 5.0  # of each type, on page and sheet
ROLL_OUT_SECONDS = 6.0  # of those that find the reference gains
TRAVELS = 100.0  # cm from beginning to end; what goes less far stays as it is
MODEL = "model.safetensors"


@click.command("quickstart")
@click.argument("data", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "-o",
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    help="Output folder; by default DATA with -model added to its name.",
)
@click.option("--minutes", type=click.FloatRange(min=0.01), help="Training time in minutes; 5 by default.")
@click.option("--steps", type=click.IntRange(min=1), help="Number of training steps instead.")
@click.option("--add", is_flag=True, help="Also keep the types of the bundled model.")
@click.option("--force", is_flag=True, help="Overwrite the model of an earlier quickstart.")
@click.option("--device", default="auto", show_default=True, help="Device to train on: auto, cpu, cuda ...")
@seed_option()
@json_option
def command(
    data: Path,
    output: Path | None,
    minutes: float | None,
    steps: int | None,
    add: bool,
    force: bool,
    device: str,
    seed: int,
    as_json: bool,
) -> None:
    """Train a model on the clips in the folder DATA, and say whether each of its types works.

    Runs doctor, preprocess, train, synthesize, view and evaluate --quick in turn. The output folder then holds the
    dataset, model.safetensors, motions.html (a page that plays every type), motions.png (the same as a sheet,
    with Pillow) and verdict.md. Types are folder and file names, or those of a labels.csv.
    """
    target = output or data.resolve().with_name(f"{data.resolve().name}-model")
    if target.resolve().is_relative_to(data.resolve()):
        raise click.UsageError(f"{target}: is inside {data}; give a folder beside it with -o")
    if (target / MODEL).exists() and not force:
        raise OverwriteError(f"{target / MODEL}: exists; overwrite it with --force")
    if find_spec("torch") is None:
        raise MotionkitError("training needs torch: pip install 'motionkit[train]'")
    _say_what_looks_wrong(data)
    dataset = _preprocess(data, target / "dataset")
    model, finished = _train(dataset, target / MODEL, minutes, steps, add, device, seed, as_json)
    if not finished:
        flag = " --add" if add else ""
        remark(
            f"{target / MODEL} is the model so far; go on with: "
            f'motionkit train "{target / "dataset"}" -o "{target / MODEL}"{flag} --resume'
        )
        sys.exit(STOPPED)
    pictures = _show(model, dataset, target)
    verdicts = _judge(model, dataset, target)
    if as_json:
        from dataclasses import asdict

        print_json(
            {
                "model": str(target / MODEL),
                "pictures": [str(path) for path in pictures],
                "verdicts": [asdict(v) | {"works": v.works} for v in verdicts],
            }
        )
        return
    for verdict in verdicts:
        say(verdict.sentence())
    good = sum(verdict.works for verdict in verdicts)
    made = ", ".join(path.name for path in pictures)
    say(f"{good} of {len(verdicts)} types work; wrote {target / MODEL}, {made}, verdict.md")
    names = ",".join(dataset.types[:2])
    say(f'try: motionkit synthesize --model "{target / MODEL}" --types "{names}" --view')


def _say_what_looks_wrong(data: Path) -> None:
    """Print the warnings of doctor."""
    from motionkit.data.diagnosis import diagnose

    with progress_bar() as bar:
        task = bar.add_task("looking", total=None)
        found = diagnose([data], None, lambda done, total: bar.update(task, completed=done, total=total))
    for clip in found.clips:
        if clip.fault:
            remark(f"left out: {clip.fault if clip.name in clip.fault else f'{clip.name}: {clip.fault}'}")
    for line in [
        *found.warnings,
        *(f"{kind.name}: {line}" for kind in found.types for line in kind.warnings),
    ]:
        remark(f"warning: {line}")


def _preprocess(data: Path, folder: Path) -> Dataset:
    from motionkit.api import preprocess
    from motionkit.cli.training_monitor import duration
    from motionkit.data.dataset import Dataset
    from motionkit.data.preprocess import PreprocessOptions

    with progress_bar() as bar:
        # A folder of some dozen clips has none to spare: every type is judged by what it has learned from.
        report = preprocess([data], folder, PreprocessOptions(held_out=()), stages_on(bar))
    clips = sum(file.clips for file in report.files)  # without mirror images
    remark(
        f"{folder}: {_counted(clips, 'clip')}, {duration(report.seconds)}, {_counted(len(report.types), 'type')}"
    )
    return Dataset(folder)


def _counted(number: int, word: str) -> str:
    return f"{number} {word}{'s' if number != 1 else ''}"


def _train(
    dataset: Dataset,
    output: Path,
    minutes: float | None,
    steps: int | None,
    add: bool,
    device: str,
    seed: int,
    quiet: bool,
) -> tuple[MotionModel, bool]:
    """The trained model, and whether training came to its end."""
    from motionkit.api import FINE_TUNE_MINUTES, load_model
    from motionkit.cli.train import KEPT_SHARE
    from motionkit.cli.training_monitor import TrainingMonitor
    from motionkit.training.presets import fine_tune_options
    from motionkit.training.trainer import train

    if minutes is None and steps is None:
        minutes = FINE_TUNE_MINUTES
    options = fine_tune_options(
        "tptn",
        steps=steps,
        minutes=minutes,
        seed=seed,
        kept_share=KEPT_SHARE if add else None,
        score_minutes=1e6,  # the verdict comes afterwards; roll-outs at the end find the reference gains
        score_seconds=ROLL_OUT_SECONDS,
    )
    monitor = TrainingMonitor(quiet, options, None, output.parent, losses=False)
    with monitor:
        result = train(dataset.folder, output, options, device=device, on_event=monitor)
    return load_model(output), result.finished


def _show(model: MotionModel, dataset: Dataset, folder: Path) -> list[Path]:
    """Write a page and a sheet of every type of the dataset."""
    from motionkit.api import synthesize, write_view

    names = [name for name in model.types if name in dataset.types]
    with progress_bar() as bar:
        task = bar.add_task("showing", total=len(names))
        motions = []
        for name in names:
            seconds = max(SHOWN_SECONDS, model.phase_seconds(name))
            motions.append(_straight_ahead(synthesize(f"{name}:{seconds:g}", model=model).motion))
            bar.advance(task)
    out = []
    for path in (folder / "motions.html", folder / "motions.png"):
        if path.suffix == ".png" and find_spec("PIL") is None:
            continue
        write_view(path, *motions, names=names)
        out.append(path)
    return out


def _straight_ahead(motion: Motion) -> Motion:
    """The motion turned so that it goes along z: on a page side by side, figures then stand near each other."""
    x, _, z = (motion.root_positions[-1] - motion.root_positions[0]).tolist()
    return motion.turned(-math.atan2(x, z)) if math.hypot(x, z) > TRAVELS else motion


def _judge(model: MotionModel, dataset: Dataset, folder: Path) -> list[TypeVerdict]:
    from motionkit.evaluation.judge import Judge
    from motionkit.evaluation.quick import QUICK_TYPES, quick_verdicts, verdict_section
    from motionkit.evaluation.real import RealMotion
    from motionkit.evaluation.report import Scoreboard
    from motionkit.files import atomic_write

    with progress_bar() as bar:
        task = bar.add_task("judging", total=100)
        judge = Judge(RealMotion(dataset))
        verdicts = quick_verdicts(
            model, judge, QUICK_TYPES, lambda share: bar.update(task, completed=100 * share)
        )
    board = Scoreboard(QUICK_TYPES.as_dict(), [verdict_section(verdicts)])
    with atomic_write(folder / "verdict.md") as out:
        out.write(board.markdown())
    return verdicts
