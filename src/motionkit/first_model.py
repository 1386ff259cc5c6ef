"""Trains a first model on a folder of clips and judges it: the library call behind `motionkit quickstart`."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from motionkit.errors import DatasetError, MotionkitError, OverwriteError
from motionkit.files import atomic_write, check_foreign, files_below
from motionkit.locks import locked
from motionkit.names import about, counted, duration, first_lines

if TYPE_CHECKING:
    from motionkit.data.dataset import Dataset
    from motionkit.models.model import MotionModel
    from motionkit.motion.motion import Motion
    from motionkit.training.options import TrainOptions
    from motionkit.training.trainer import TrainEvent
    from motionkit.training.verdict.types import TypeVerdict

EXAMPLE_SECONDS = 5.0  # seconds shown of each type, on page and sheet
ROLL_OUT_SECONDS = 6.0  # seconds of the roll-outs that choose the reference gains
TRAVELS = 100.0  # cm from start to end; a motion that travels less is not turned
LISTED_SKIPS = 8  # unusable files that are listed by name
NEVER = 1e6  # minutes between scores; longer than any run, so that scoring is off
DATASET, MODEL, RUN = "dataset", "model.safetensors", "model.run"
PAGE, SHEET, VERDICT = "motions.html", "motions.png", "verdict.md"


@dataclass(frozen=True)
class QuickstartOptions:
    """How to train a first model, and how to treat an earlier one.

    Attributes:
        minutes, steps: length of the training; 5 minutes by default.
        add: keep the types of the bundled model, too.
        mirror: train on mirror images of the clips, too.
        force: replace the results of an earlier quickstart.
        resume: continue with the dataset, checkpoint or model of an earlier quickstart.
        device: "auto", "cpu" or "cuda".
        seed: the same seed gives the same model.
    """

    minutes: float | None = None
    steps: int | None = None
    add: bool = False
    mirror: bool = True
    force: bool = False
    resume: bool = False
    device: str = "auto"
    seed: int = 0


def _unwatched(options: TrainOptions, samples: Path) -> AbstractContextManager[Any]:
    return nullcontext(lambda event: None)


@dataclass(frozen=True)
class Watcher:
    """Callbacks of a quickstart, which do nothing by default: messages, one line each; stage, amount done and total.

    training is called with the training options; it returns a context whose value is called with each event.
    """

    tell: Callable[[str], None] = lambda line: None
    progress: Callable[[str, float, float], None] = lambda stage, done, total: None
    training: Callable[[TrainOptions, Path], AbstractContextManager[Callable[[TrainEvent], None]]] = (
        _unwatched
    )


@dataclass(frozen=True)
class QuickstartResult:
    """The model file, the pictures of its types, a verdict on each, and how long the model was trained, in words."""

    model: Path
    pictures: tuple[Path, ...]
    verdicts: tuple[TypeVerdict, ...]
    training: str = ""


class QuickstartStopped(KeyboardInterrupt):
    """Ctrl-C, or SIGTERM in the command.

    Attributes:
        resumes: whether resume=True continues from here; False if nothing was begun.
        reported: whether training has reported the stop already.
    """

    def __init__(self, resumes: bool, reported: bool) -> None:
        super().__init__()
        self.resumes, self.reported = resumes, reported


class _TrainingStopped(KeyboardInterrupt):
    """Ctrl-C ended training, which has reported it already."""


def quickstart(
    data: str | Path,
    output: str | Path | None = None,
    options: QuickstartOptions | None = None,
    watcher: Watcher | None = None,
) -> QuickstartResult:
    """Train a model on the clips in a folder, show each of its types, and judge whether it works. Needs torch.

    Args:
        data: folder of BVH files; types come from folder and file names, or from a labels.csv.
        output: folder to write to; by default the data folder's name with -model appended.

    Returns:
        The model and its results; beside the model are the dataset, motions.html, motions.png (with Pillow) and
            verdict.md.

    Raises:
        OverwriteError: a model exists and neither force nor resume is set; a file is in the way that motionkit did
            not write; output is inside data; or a run is resumed with other clips, add, another seed or without mirror
            images although it was begun otherwise.
        MotionkitError: torch is not installed, no type can be learnt, or another process makes the model.
        QuickstartStopped: Ctrl-C.
    """
    data, options, watcher = Path(data), options or QuickstartOptions(), watcher or Watcher()
    target = output_folder(data) if output is None else Path(output)
    _check(data, target, options)
    with locked(target, "making this model") as notes:
        for line in notes:
            watcher.tell(line)
        return _quickstart(data, target, options, watcher)


def _quickstart(data: Path, target: Path, options: QuickstartOptions, watcher: Watcher) -> QuickstartResult:
    """Go through the stages that are left."""
    resumes = options.resume or not options.force
    try:
        dataset = _made_dataset(target) if options.resume else None
        if dataset is not None:
            if not options.mirror and any(clip.mirrored for clip in dataset.clips):
                raise OverwriteError(f"--no-mirror: {target} was begun without it; begin anew with --force")
            _check_same(data, dataset)
            _tell_changed(data, target, watcher)
        else:
            _look(data, watcher)
            if not options.resume:
                _clear(target)
            resumes = True
            dataset = _preprocess(data, target / DATASET, options.mirror, watcher)
        training = _training_options(target, options)
        model = _whole_model(target / MODEL, training) if options.resume else None
        if model is None:
            model = _train(dataset, target, training, options.device, watcher)
        pictures = _show(model, dataset, target, watcher)
        verdicts = _judge(model, dataset, target, watcher)
    except KeyboardInterrupt as stop:
        raise QuickstartStopped(resumes, isinstance(stop, _TrainingStopped)) from None
    from motionkit.training.verdict.types import training_summary

    return QuickstartResult(target / MODEL, tuple(pictures), tuple(verdicts), training_summary(model))


# ---- results of an earlier quickstart ----


def output_folder(data: Path) -> Path:
    """The default output folder of a quickstart."""
    return data.resolve().with_name(f"{data.resolve().name}-model")


def begun(target: Path) -> Path | None:
    """The model, else the checkpoint, of an earlier quickstart; None if neither exists."""
    return next((path for path in (target / MODEL, _checkpoint(target)) if path.exists()), None)


def _check(data: Path, target: Path, options: QuickstartOptions) -> None:
    """Raise for invalid options, before any clip is read."""
    if target.resolve().is_relative_to(data.resolve()):
        where = "the folder of the clips" if target.resolve() == data.resolve() else f"inside {data}"
        raise OverwriteError(f"{target}: is {where}; give a folder beside it")
    if options.force and options.resume:
        raise OverwriteError("resume cannot be combined with force")
    if begun(target) and not (options.force or options.resume):
        raise OverwriteError(f"{begun(target)}: exists; go on with it by resume, or overwrite it by force")
    if not options.force:  # --resume writes these anew, too
        check_foreign([target / name for name in (PAGE, SHEET, VERDICT)])
    if find_spec("torch") is None:
        raise MotionkitError("training needs torch: pip install 'motionkit[train]'")
    if options.device != "auto":  # importing torch takes seconds
        from motionkit.training.processes import resolve_device

        resolve_device(options.device)
    above = next(folder for folder in (target, *target.absolute().parents) if os.path.lexists(folder))
    if not (above.is_dir() and os.access(above, os.W_OK | os.X_OK)):
        raise MotionkitError(f"{target}: cannot be written ({above} is no folder to write to)")


def _checkpoint(target: Path) -> Path:
    return target / RUN / "checkpoint.safetensors"


def _made_dataset(target: Path) -> Dataset | None:
    """The dataset, or None if it is incomplete."""
    from motionkit.data.dataset import Dataset

    try:
        return Dataset(target / DATASET)
    except DatasetError:
        return None


def _check_same(data: Path, dataset: Dataset) -> None:
    """Raise OverwriteError if no file of the data is one that the dataset was made of."""
    from motionkit.data.first_pass import file_hash
    from motionkit.rig.read_file import ENDINGS

    known = {file.get("sha256") for file in dataset.manifest.get("files", [])} - {None, ""}

    def same(path: Path) -> bool:
        try:
            return file_hash(path) in known
        except MotionkitError:  # it was left out then, too
            return False

    if known and not any(map(same, files_below(data, ENDINGS))):
        raise OverwriteError(
            f"{dataset.folder}: was made of other clips than {data}; begin anew with --force"
        )


def _tell_changed(data: Path, target: Path, watcher: Watcher) -> None:
    """Report clips and tables of labels that are newer than the dataset; the dataset stays as it is."""
    from motionkit.data.folder import MANIFEST
    from motionkit.rig.read_file import ENDINGS

    made = (target / DATASET / MANIFEST).stat().st_mtime
    read = files_below(data, (".csv", *ENDINGS))
    read = [path for path in read if path.suffix.lower() != ".csv" or path.name == "labels.csv"]
    newer = [path for path in read if path.stat().st_mtime > made]
    if newer:
        more = f" and {len(newer) - 1} more are" if len(newer) > 1 else " is"
        watcher.tell(
            f"{newer[0]}{more} newer than {target / DATASET}, which goes on without them; --force begins anew"
        )


def _whole_model(path: Path, options: TrainOptions) -> MotionModel | None:
    """The model if training has finished as the options ask and its final scores exist; else None."""
    from motionkit.models.checkpoint import load_model

    if not path.exists():
        return None
    model = load_model(path)
    steps, seconds = model.card.get("steps", 0), model.card.get("seconds", 0.0)
    ended = (options.steps and steps >= options.steps) or (
        options.minutes and seconds >= 60.0 * options.minutes
    )
    return model if ended and model.card.get("scores") else None


def _clear(target: Path) -> None:
    """Remove the results of an earlier quickstart, so that they are not taken for new ones."""
    from motionkit.data.folder import remove_dataset

    _remove_results(target)
    for path in (target / MODEL, _checkpoint(target), target / RUN / "log.jsonl"):
        path.unlink(missing_ok=True)
    remove_dataset(target / DATASET)


def _remove_results(target: Path) -> None:
    """Remove page, sheet and verdict."""
    for name in (VERDICT, SHEET, PAGE):
        (target / name).unlink(missing_ok=True)


# ---- the stages ----


def _look(data: Path, watcher: Watcher) -> None:
    """Report the warnings of doctor. Raises MotionkitError if no type can be learnt."""
    from motionkit.data.diagnosis import diagnose

    found = diagnose([data], None, lambda done, total: watcher.progress("looking", done, total))
    left_out = [*(about(clip.name, clip.fault) for clip in found.clips if clip.fault), *found.skipped]
    if not found.types:
        raise MotionkitError(f"{data}: none of the {len(left_out)} files can be used; {left_out[0]}")
    lost = [kind for kind in found.types if kind.unlearnable]
    if len(lost) == len(found.types):
        more = f" (and {counted(len(lost) - 1, 'more type')})" if len(lost) > 1 else ""
        raise MotionkitError(f"{data}: no type can be learnt; {lost[0].name}: {lost[0].unlearnable}{more}")
    lines = [f"left out: {line}" for line in left_out]
    for line in [
        *first_lines(lines, LISTED_SKIPS, "files are left out", "motionkit doctor lists all"),
        *found.lines,
    ]:
        watcher.tell(line)


def _preprocess(data: Path, folder: Path, mirror: bool, watcher: Watcher) -> Dataset:
    from motionkit.data.dataset import Dataset
    from motionkit.data.options import PreprocessOptions
    from motionkit.data.preprocess import preprocess
    from motionkit.models.bundled import reference_rotations

    # A folder of a few dozen clips can spare none: each type is judged on its training clips.
    options = PreprocessOptions(mirror=mirror, held_out=())
    options = replace(options, reference_rotations=reference_rotations("bundled", options.layout))
    report = preprocess([data], folder, options, watcher.progress)
    clips = sum(file.clips for file in report.files)  # without mirror images
    words = (counted(clips, "clip"), duration(report.seconds), counted(len(report.types), "type"))
    watcher.tell(f"{folder}: {', '.join(words)}")
    return Dataset(folder)


def _training_options(target: Path, options: QuickstartOptions) -> TrainOptions:
    """Training options; a resumed run keeps its own, except a length that is given anew."""
    from motionkit.training.presets import FINE_TUNE_MINUTES, KEPT_SHARE, fine_tune_options
    from motionkit.training.run_state import run_options

    minutes, steps, seed = options.minutes, options.steps, options.seed
    kept_share = KEPT_SHARE if options.add else None
    if options.resume and _checkpoint(target).exists():
        earlier = run_options(_checkpoint(target))
        if options.seed not in (QuickstartOptions.seed, earlier["seed"]):
            begun_with = f"{target} was begun with --seed {earlier['seed']}"
            raise OverwriteError(f"--seed {options.seed}: {begun_with}; begin anew with --force")
        seed, kept_share = earlier["seed"], earlier["sampler.kept_share"] or None
        if options.add and kept_share is None:
            raise OverwriteError(f"--add: {target} was begun without it; begin anew with --force")
        if minutes is None and steps is None:
            minutes, steps = earlier["minutes"], earlier["steps"]
    if minutes is None and steps is None:
        minutes = FINE_TUNE_MINUTES
    return fine_tune_options(
        "tptn",
        steps=steps,
        minutes=minutes,
        seed=seed,
        kept_share=kept_share,
        score_minutes=NEVER,  # the verdict scores the model afterwards; final roll-outs choose the reference gains
        score_seconds=ROLL_OUT_SECONDS,
    )


def _train(
    dataset: Dataset, target: Path, options: TrainOptions, device: str, watcher: Watcher
) -> MotionModel:
    """Train a model, from a checkpoint if there is one. Raises KeyboardInterrupt if stopped."""
    from motionkit.models.checkpoint import load_model
    from motionkit.training.trainer import train

    _remove_results(target)
    resume = _checkpoint(target).exists()
    with watcher.training(options, target) as on_event:
        result = train(
            dataset.folder, target / MODEL, options, resume, target / RUN, device=device, on_event=on_event
        )
    if not result.finished:
        watcher.tell(f"{target / MODEL} is the model so far")
        raise _TrainingStopped
    return load_model(target / MODEL)


def _show(model: MotionModel, dataset: Dataset, folder: Path, watcher: Watcher) -> list[Path]:
    """Write a page and a sheet that show every type of the dataset."""
    from motionkit.requests import synthesis_request
    from motionkit.view.write import write_view

    names = [name for name in model.types if name in dataset.types]
    motions = []
    for done, name in enumerate(names):
        watcher.progress("showing", done, len(names))
        seconds = max(EXAMPLE_SECONDS, model.phase_seconds(name))
        motions.append(_straight_ahead(synthesis_request(f"{name}:{seconds:g}", model=model).run().motion))
    files = [folder / PAGE, *([folder / SHEET] if find_spec("PIL") else [])]
    for done, path in enumerate(files):
        watcher.progress(f"drawing {path.name}", done, len(files))
        write_view(path, *motions, names=names)
    return files


def _straight_ahead(motion: Motion) -> Motion:
    """The motion turned so that it travels along z, which keeps figures close together on a page."""
    x, _, z = (motion.root_positions[-1] - motion.root_positions[0]).tolist()
    return motion.turned(-math.atan2(x, z)) if math.hypot(x, z) > TRAVELS else motion


def _judge(model: MotionModel, dataset: Dataset, folder: Path, watcher: Watcher) -> list[TypeVerdict]:
    from motionkit.training.verdict.judge import Judge
    from motionkit.training.verdict.real import RealMotion
    from motionkit.training.verdict.types import (
        QUICK_TYPES,
        quick_verdicts,
        training_summary,
        verdict_page,
    )

    watch = watcher.progress
    watch("reading the clips", 0, 1)
    judge = Judge(RealMotion(dataset))
    verdicts = quick_verdicts(model, judge, QUICK_TYPES, lambda share: watch("judging", 100 * share, 100))
    with atomic_write(folder / VERDICT) as out:
        out.write(verdict_page(verdicts, QUICK_TYPES, training_summary(model)))
    return verdicts
