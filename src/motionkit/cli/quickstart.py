"""`motionkit quickstart`: a folder of clips to a model, a page, a sheet and a plain verdict."""

from __future__ import annotations

import math
import os
import shlex
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
from motionkit.cli.finite import FiniteRange
from motionkit.errors import DatasetError, MotionkitError, OverwriteError
from motionkit.files import files_below
from motionkit.names import counted

if TYPE_CHECKING:
    from motionkit.data.dataset import Dataset
    from motionkit.models.model import MotionModel
    from motionkit.motion.motion import Motion
    from motionkit.training.options import TrainOptions
    from motionkit.training.verdict.types import TypeVerdict

SHOWN_SECONDS = 5.0  # of each type, on page and sheet
ROLL_OUT_SECONDS = 6.0  # of those that find the reference gains
TRAVELS = 100.0  # cm from beginning to end; what goes less far stays as it is
SHOWN_SKIPS = 8
DATASET, MODEL, RUN = "dataset", "model.safetensors", "model.run"
PAGE, SHEET, VERDICT = "motions.html", "motions.png", "verdict.md"


class TrainingStopped(KeyboardInterrupt):
    """Ctrl-C ended training, which has said so."""


@click.command("quickstart")
@click.argument("data", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "-o",
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    help="Output folder; by default DATA with -model added to its name.",
)
@click.option("--minutes", type=FiniteRange(min=0.01), help="Training time in minutes; 5 by default.")
@click.option("--steps", type=click.IntRange(min=1), help="Number of training steps instead.")
@click.option("--add", is_flag=True, help="Also keep the types of the bundled model.")
@click.option(
    "--mirror/--no-mirror",
    default=True,
    show_default=True,
    help="Also learn from the mirror image of each clip; --no-mirror keeps kicks of one leg to that leg.",
)
@click.option("--force", is_flag=True, help="Overwrite the model of an earlier quickstart.")
@click.option(
    "--resume",
    is_flag=True,
    help="Go on where an earlier quickstart stopped, with the dataset, the checkpoint or the model that it has made.",
)
@click.option("--device", default="auto", show_default=True, help="Device to train on: auto, cpu, cuda ...")
@seed_option()
@json_option
def command(
    data: Path,
    output: Path | None,
    minutes: float | None,
    steps: int | None,
    add: bool,
    mirror: bool,
    force: bool,
    resume: bool,
    device: str,
    seed: int,
    as_json: bool,
) -> None:
    """Train a model on the clips in the folder DATA, and say whether each of its types works.

    Runs doctor, preprocess, train, synthesize, view and evaluate --quick in turn. The output folder then holds the
    dataset, model.safetensors, motions.html (a page that plays every type), motions.png (the same as a sheet,
    with Pillow) and verdict.md. Types are folder and file names, or those of a labels.csv. After Ctrl-C, the same
    command with --resume goes on at any stage.
    """
    target = output or data.resolve().with_name(f"{data.resolve().name}-model")
    if target.resolve().is_relative_to(data.resolve()):
        where = "the folder of the clips" if target.resolve() == data.resolve() else f"inside {data}"
        raise click.UsageError(f"{target}: is {where}; give a folder beside it with -o")
    if force and resume:
        raise click.UsageError("--resume cannot be combined with --force")
    given: dict[str, object] = {"-o": output, "--minutes": minutes, "--steps": steps, "--seed": seed or None}
    given["--device"] = None if device == "auto" else device
    flags = {"--add": add, "--no-mirror": not mirror, "--json": as_json}
    again = ["motionkit", "quickstart", str(data)]
    again += [word for name, value in given.items() if value is not None for word in (name, str(value))]
    again += [name for name, chosen in flags.items() if chosen]
    begun = next((path for path in (target / MODEL, _checkpoint(target)) if path.exists()), None)
    if begun is not None and not (force or resume):
        raise OverwriteError(
            f"{begun}: exists; go on with: {shlex.join([*again, '--resume'])}, or overwrite it with --force"
        )
    if find_spec("torch") is None:
        raise MotionkitError("training needs torch: pip install 'motionkit[train]'")
    if device != "auto":  # before the clips are read; torch takes seconds to import
        from motionkit.training.trainer import resolve_device

        resolve_device(device)
    above = next(folder for folder in (target, *target.absolute().parents) if os.path.lexists(folder))
    if not (above.is_dir() and os.access(above, os.W_OK | os.X_OK)):
        raise MotionkitError(f"{target}: cannot be written ({above} is no folder to write to)")
    going_on = "--force" if force else "--resume"
    try:
        dataset = _made_dataset(target) if resume else None
        if dataset is not None:
            _tell_changed(data, target)
        else:
            _look(data)
            if not resume:
                _clear(target)
            going_on = "--resume"
            dataset = _preprocess(data, target / DATASET, mirror)
        options = _training_options(target, resume, minutes, steps, add, seed)
        model = _whole_model(target / MODEL, options) if resume else None
        if model is None:
            model = _train(dataset, target, options, device, as_json)
        pictures = _show(model, dataset, target)
        verdicts = _judge(model, dataset, target)
    except KeyboardInterrupt as stop:
        from motionkit.cli.main import tell_stopped

        if not isinstance(stop, TrainingStopped):
            tell_stopped()
        remark(f"go on with: {shlex.join([*again, going_on])}")
        sys.exit(STOPPED)
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
    say(f"{good} of {len(verdicts)} types work; wrote {target / MODEL}, {made}, {VERDICT}")
    names = [v.type for v in verdicts if v.works] or [v.type for v in verdicts if v.rollouts]
    if names:
        asked = ["--model", str(target / MODEL), "--types", ",".join(names[:2]), "--view"]
        say(f"try: {shlex.join(['motionkit', 'synthesize', *asked])}")


# ---- what an earlier quickstart has made ----


def _checkpoint(target: Path) -> Path:
    return target / RUN / "checkpoint.safetensors"


def _made_dataset(target: Path) -> Dataset | None:
    """The dataset, if it is whole."""
    from motionkit.data.dataset import Dataset

    try:
        return Dataset(target / DATASET)
    except DatasetError:
        return None


def _tell_changed(data: Path, target: Path) -> None:
    """Remark on files that are newer than the dataset, which is left as it is."""
    from motionkit.data.folder import MANIFEST

    made = (target / DATASET / MANIFEST).stat().st_mtime
    newer = [path for path in files_below(data, ".bvh") if path.stat().st_mtime > made]
    if newer:
        more = f" and {len(newer) - 1} more are" if len(newer) > 1 else " is"
        remark(
            f"{newer[0]}{more} newer than {target / DATASET}, which goes on without them; --force begins anew"
        )


def _whole_model(path: Path, options: TrainOptions) -> MotionModel | None:
    """The model, if its training has come to the end that the options ask for, and was scored as the last thing."""
    from motionkit.api import load_model

    if not path.exists():
        return None
    model = load_model(path)
    steps, seconds = model.card.get("steps", 0), model.card.get("seconds", 0.0)
    ended = (options.steps and steps >= options.steps) or (
        options.minutes and seconds >= 60.0 * options.minutes
    )
    return model if ended and model.card.get("scores") else None


def _clear(target: Path) -> None:
    """Remove what an earlier quickstart has made, so that nothing is taken for a result of this one."""
    from motionkit.data.folder import remove_dataset

    _remove_results(target)
    for path in (target / MODEL, _checkpoint(target), target / RUN / "log.jsonl"):
        path.unlink(missing_ok=True)
    remove_dataset(target / DATASET)


def _remove_results(target: Path) -> None:
    """Remove page, sheet and verdict, which belong to one model."""
    for name in (VERDICT, SHEET, PAGE):
        (target / name).unlink(missing_ok=True)


# ---- the stages ----


def _look(data: Path) -> None:
    """Print the warnings of doctor. Raises MotionkitError if there is no type that can be learnt."""
    from motionkit.data.diagnosis import diagnose

    with progress_bar() as bar:
        task = bar.add_task("looking", total=None)
        found = diagnose([data], None, lambda done, total: bar.update(task, completed=done, total=total))
    faults = [
        clip.fault if clip.name in clip.fault else f"{clip.name}: {clip.fault}"
        for clip in found.clips
        if clip.fault
    ]
    left_out = [*faults, *found.skipped]
    if not found.types:
        raise MotionkitError(f"{data}: none of the {len(left_out)} files can be used; {left_out[0]}")
    lost = [kind for kind in found.types if kind.unlearnable]
    if len(lost) == len(found.types):
        more = f" (and {counted(len(lost) - 1, 'more type')})" if len(lost) > 1 else ""
        raise MotionkitError(f"{data}: no type can be learnt; {lost[0].name}: {lost[0].unlearnable}{more}")
    for line in left_out[:SHOWN_SKIPS]:
        remark(f"left out: {line}")
    if len(left_out) > SHOWN_SKIPS:
        remark(f"left out: {len(left_out) - SHOWN_SKIPS} more; motionkit doctor lists them")
    for line in found.lines:
        remark(line)


def _preprocess(data: Path, folder: Path, mirror: bool) -> Dataset:
    from motionkit.api import preprocess
    from motionkit.cli.training_monitor import duration
    from motionkit.data.dataset import Dataset
    from motionkit.data.options import PreprocessOptions

    with progress_bar() as bar:
        # A folder of some dozen clips has none to spare: every type is judged by what it has learned from.
        options = PreprocessOptions(mirror=mirror, held_out=())
        report = preprocess([data], folder, options, stages_on(bar))
    clips = sum(file.clips for file in report.files)  # without mirror images
    remark(
        f"{folder}: {counted(clips, 'clip')}, {duration(report.seconds)}, {counted(len(report.types), 'type')}"
    )
    return Dataset(folder)


def _training_options(
    target: Path, resume: bool, minutes: float | None, steps: int | None, add: bool, seed: int
) -> TrainOptions:
    """The options of a run; those that a run to be resumed began with, but for its length where one is given."""
    from motionkit.api import FINE_TUNE_MINUTES
    from motionkit.cli.train import KEPT_SHARE
    from motionkit.training.presets import fine_tune_options
    from motionkit.training.run_state import run_options

    kept_share = KEPT_SHARE if add else None
    if resume and _checkpoint(target).exists():
        begun = run_options(_checkpoint(target))
        seed, kept_share = begun["seed"], begun["sampler.kept_share"] or None
        if add and kept_share is None:
            raise click.UsageError(f"--add: {target} was begun without it; begin anew with --force")
        if minutes is None and steps is None:
            minutes, steps = begun["minutes"], begun["steps"]
    if minutes is None and steps is None:
        minutes = FINE_TUNE_MINUTES
    return fine_tune_options(
        "tptn",
        steps=steps,
        minutes=minutes,
        seed=seed,
        kept_share=kept_share,
        score_minutes=1e6,  # the verdict comes afterwards; roll-outs at the end find the reference gains
        score_seconds=ROLL_OUT_SECONDS,
    )


def _train(dataset: Dataset, target: Path, options: TrainOptions, device: str, quiet: bool) -> MotionModel:
    """The trained model; goes on from a checkpoint. Raises KeyboardInterrupt if it is stopped."""
    from motionkit.api import load_model
    from motionkit.cli.training_monitor import TrainingMonitor
    from motionkit.training.trainer import train

    _remove_results(target)
    monitor = TrainingMonitor(quiet, options, None, target, losses=False)
    with monitor:
        result = train(
            dataset.folder,
            target / MODEL,
            options,
            resume=_checkpoint(target).exists(),
            run_folder=target / RUN,
            device=device,
            on_event=monitor,
        )
    if not result.finished:
        remark(f"{target / MODEL} is the model so far")
        raise TrainingStopped
    return load_model(target / MODEL)


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
    for path in (folder / PAGE, folder / SHEET):
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
    from motionkit.files import atomic_write
    from motionkit.training.verdict.judge import Judge
    from motionkit.training.verdict.real import RealMotion
    from motionkit.training.verdict.types import QUICK_TYPES, quick_verdicts, verdict_page

    with progress_bar() as bar:
        task = bar.add_task("judging", total=100)
        judge = Judge(RealMotion(dataset))
        verdicts = quick_verdicts(
            model, judge, QUICK_TYPES, lambda share: bar.update(task, completed=100 * share)
        )
    with atomic_write(folder / VERDICT) as out:
        out.write(verdict_page(verdicts, QUICK_TYPES))
    return verdicts
