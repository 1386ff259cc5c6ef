"""A folder of clips to a model, pictures of it and a plain verdict: the library call behind `motionkit quickstart`."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from motionkit.data.dataset import Dataset
from motionkit.data.folder import MANIFEST, remove_dataset
from motionkit.errors import DatasetError, MotionkitError, OverwriteError
from motionkit.files import atomic_write, files_below
from motionkit.names import about, counted, duration

if TYPE_CHECKING:
    from motionkit.evaluation.quick import TypeVerdict
    from motionkit.models.model import MotionModel
    from motionkit.motion.motion import Motion
    from motionkit.training.options import TrainOptions
    from motionkit.training.trainer import TrainEvent

SHOWN_SECONDS = 5.0  # of each type, on page and sheet
ROLL_OUT_SECONDS = 6.0  # of those that find the reference gains
TRAVELS = 100.0  # cm from beginning to end; what goes less far stays as it is
SHOWN_SKIPS = 8
NEVER = 1e6  # minutes between scores
DATASET, MODEL, RUN = "dataset", "model.safetensors", "model.run"
PAGE, SHEET, VERDICT = "motions.html", "motions.png", "verdict.md"


@dataclass(frozen=True)
class QuickstartOptions:
    """How to train a first model, and what becomes of an earlier one.

    Attributes:
        minutes, steps: length of the training; 5 minutes by default.
        add: also keep the types of the bundled model.
        mirror: also learn from the mirror image of each clip.
        force: replace what an earlier quickstart has made.
        resume: go on with the dataset, the checkpoint or the model that an earlier quickstart has made.
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
    """Who is told what a quickstart does; nobody by default.

    Attributes:
        tell: called with each remark, one line.
        progress: called with the name of a stage, what is done of it, and the whole.
        training: gives a context for training with some options, whose value is called with each event.
    """

    tell: Callable[[str], None] = lambda line: None
    progress: Callable[[str, float, float], None] = lambda stage, done, total: None
    training: Callable[[TrainOptions, Path], AbstractContextManager[Callable[[TrainEvent], None]]] = (
        _unwatched
    )


@dataclass(frozen=True)
class QuickstartResult:
    """The model file, the pictures of its types, and a verdict on each."""

    model: Path
    pictures: tuple[Path, ...]
    verdicts: tuple[TypeVerdict, ...]


class QuickstartStopped(KeyboardInterrupt):
    """Ctrl-C, or SIGTERM in the command.

    Attributes:
        resumes: whether resume=True goes on from here; else nothing was begun.
        told: whether training has said so.
    """

    def __init__(self, resumes: bool, told: bool) -> None:
        super().__init__()
        self.resumes, self.told = resumes, told


class _TrainingStopped(KeyboardInterrupt):
    """Ctrl-C ended training, which has said so."""


def quickstart(
    data: str | Path,
    output: str | Path | None = None,
    options: QuickstartOptions | None = None,
    watcher: Watcher | None = None,
) -> QuickstartResult:
    """Train a model on the clips in a folder, show each of its types, and say whether it works. Needs torch.

    Args:
        data: folder of BVH files; types are folder and file names, or those of a labels.csv.
        output: folder to write to; by default that of the data with -model added to its name.

    Returns:
        What was made: beside the model stand the dataset, motions.html, motions.png (with Pillow) and verdict.md.

    Raises:
        OverwriteError: a model is there already and neither force nor resume is set, output is inside data, or a run
            that was begun without add cannot go on with it.
        MotionkitError: without torch, or where no type can be learnt.
        QuickstartStopped: Ctrl-C.
    """
    data, options, watcher = Path(data), options or QuickstartOptions(), watcher or Watcher()
    target = output_folder(data) if output is None else Path(output)
    _check(data, target, options)
    resumes = options.resume or not options.force
    try:
        dataset = _made_dataset(target) if options.resume else None
        if dataset is not None:
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
    return QuickstartResult(target / MODEL, tuple(pictures), tuple(verdicts))


# ---- what an earlier quickstart has made ----


def output_folder(data: Path) -> Path:
    """The folder that a quickstart writes to by default."""
    return data.resolve().with_name(f"{data.resolve().name}-model")


def begun(target: Path) -> Path | None:
    """The model or the checkpoint of an earlier quickstart."""
    return next((path for path in (target / MODEL, _checkpoint(target)) if path.exists()), None)


def _check(data: Path, target: Path, options: QuickstartOptions) -> None:
    """Refuse what cannot be made, before the clips are read."""
    if target.resolve().is_relative_to(data.resolve()):
        where = "the folder of the clips" if target.resolve() == data.resolve() else f"inside {data}"
        raise OverwriteError(f"{target}: is {where}; give a folder beside it")
    if options.force and options.resume:
        raise OverwriteError("resume cannot be combined with force")
    if begun(target) and not (options.force or options.resume):
        raise OverwriteError(f"{begun(target)}: exists; go on with it by resume, or overwrite it by force")
    if find_spec("torch") is None:
        raise MotionkitError("training needs torch: pip install 'motionkit[train]'")
    if options.device != "auto":  # torch takes seconds to import
        from motionkit.training.processes import resolve_device

        resolve_device(options.device)
    above = next(folder for folder in (target, *target.absolute().parents) if os.path.lexists(folder))
    if not (above.is_dir() and os.access(above, os.W_OK | os.X_OK)):
        raise MotionkitError(f"{target}: cannot be written ({above} is no folder to write to)")


def _checkpoint(target: Path) -> Path:
    return target / RUN / "checkpoint.safetensors"


def _made_dataset(target: Path) -> Dataset | None:
    """The dataset, if it is whole."""
    try:
        return Dataset(target / DATASET)
    except DatasetError:
        return None


def _tell_changed(data: Path, target: Path, watcher: Watcher) -> None:
    """Remark on files that are newer than the dataset, which is left as it is."""
    made = (target / DATASET / MANIFEST).stat().st_mtime
    newer = [path for path in files_below(data, ".bvh") if path.stat().st_mtime > made]
    if newer:
        more = f" and {len(newer) - 1} more are" if len(newer) > 1 else " is"
        watcher.tell(
            f"{newer[0]}{more} newer than {target / DATASET}, which goes on without them; --force begins anew"
        )


def _whole_model(path: Path, options: TrainOptions) -> MotionModel | None:
    """The model, if its training has come to the end that the options ask for, and was scored as the last thing."""
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
    """Remove what an earlier quickstart has made, so that nothing is taken for a result of this one."""
    _remove_results(target)
    for path in (target / MODEL, _checkpoint(target), target / RUN / "log.jsonl"):
        path.unlink(missing_ok=True)
    remove_dataset(target / DATASET)


def _remove_results(target: Path) -> None:
    """Remove page, sheet and verdict, which belong to one model."""
    for name in (VERDICT, SHEET, PAGE):
        (target / name).unlink(missing_ok=True)


# ---- the stages ----


def _look(data: Path, watcher: Watcher) -> None:
    """Tell the warnings of doctor. Raises MotionkitError if there is no type that can be learnt."""
    from motionkit.data.diagnosis import diagnose

    found = diagnose([data], None, lambda done, total: watcher.progress("looking", done, total))
    left_out = [*(about(clip.name, clip.fault) for clip in found.clips if clip.fault), *found.skipped]
    if not found.types:
        raise MotionkitError(f"{data}: none of the {len(left_out)} files can be used; {left_out[0]}")
    lost = [kind for kind in found.types if kind.unlearnable]
    if len(lost) == len(found.types):
        more = f" (and {counted(len(lost) - 1, 'more type')})" if len(lost) > 1 else ""
        raise MotionkitError(f"{data}: no type can be learnt; {lost[0].name}: {lost[0].unlearnable}{more}")
    for line in left_out[:SHOWN_SKIPS]:
        watcher.tell(f"left out: {line}")
    if len(left_out) > SHOWN_SKIPS:
        watcher.tell(f"left out: {len(left_out) - SHOWN_SKIPS} more; motionkit doctor lists them")
    for line in found.lines:
        watcher.tell(line)


def _preprocess(data: Path, folder: Path, mirror: bool, watcher: Watcher) -> Dataset:
    from motionkit.api import preprocess
    from motionkit.data.options import PreprocessOptions

    # A folder of some dozen clips has none to spare: every type is judged by what it has learned from.
    options = PreprocessOptions(mirror=mirror, held_out=())
    report = preprocess([data], folder, options, watcher.progress)
    clips = sum(file.clips for file in report.files)  # without mirror images
    words = (counted(clips, "clip"), duration(report.seconds), counted(len(report.types), "type"))
    watcher.tell(f"{folder}: {', '.join(words)}")
    return Dataset(folder)


def _training_options(target: Path, options: QuickstartOptions) -> TrainOptions:
    """The options of a run; those that a run to be resumed began with, but for its length where one is given."""
    from motionkit.training.presets import FINE_TUNE_MINUTES, KEPT_SHARE, fine_tune_options
    from motionkit.training.run_state import run_options

    minutes, steps, seed = options.minutes, options.steps, options.seed
    kept_share = KEPT_SHARE if options.add else None
    if options.resume and _checkpoint(target).exists():
        earlier = run_options(_checkpoint(target))
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
        score_minutes=NEVER,  # the verdict comes afterwards; roll-outs at the end find the reference gains
        score_seconds=ROLL_OUT_SECONDS,
    )


def _train(
    dataset: Dataset, target: Path, options: TrainOptions, device: str, watcher: Watcher
) -> MotionModel:
    """The trained model; goes on from a checkpoint. Raises KeyboardInterrupt if it is stopped."""
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
    """Write a page and a sheet of every type of the dataset."""
    from motionkit.api import synthesize
    from motionkit.view.write import write_view

    names = [name for name in model.types if name in dataset.types]
    motions = []
    for done, name in enumerate(names):
        watcher.progress("showing", done, len(names))
        seconds = max(SHOWN_SECONDS, model.phase_seconds(name))
        motions.append(_straight_ahead(synthesize(f"{name}:{seconds:g}", model=model).motion))
    files = [folder / PAGE, *([folder / SHEET] if find_spec("PIL") else [])]
    for path in files:
        write_view(path, *motions, names=names)
    return files


def _straight_ahead(motion: Motion) -> Motion:
    """The motion turned so that it goes along z: on a page side by side, figures then stand near each other."""
    x, _, z = (motion.root_positions[-1] - motion.root_positions[0]).tolist()
    return motion.turned(-math.atan2(x, z)) if math.hypot(x, z) > TRAVELS else motion


def _judge(model: MotionModel, dataset: Dataset, folder: Path, watcher: Watcher) -> list[TypeVerdict]:
    from motionkit.evaluation.judge import Judge
    from motionkit.evaluation.quick import QUICK_TYPES, quick_verdicts, verdict_page
    from motionkit.evaluation.real import RealMotion

    judge = Judge(RealMotion(dataset))
    watch = watcher.progress
    verdicts = quick_verdicts(model, judge, QUICK_TYPES, lambda share: watch("judging", 100 * share, 100))
    with atomic_write(folder / VERDICT) as out:
        out.write(verdict_page(verdicts, QUICK_TYPES))
    return verdicts
