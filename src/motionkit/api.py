"""The functions behind `import motionkit as mk` that are more than a room's own: the command line's steps, as calls.

Their defaults are those of the commands; a test compares the two.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from motionkit.errors import MotionkitError
from motionkit.names import nfc

if TYPE_CHECKING:
    from motionkit.control.follow import FollowResult
    from motionkit.control.keys import Key
    from motionkit.control.path import Path2D
    from motionkit.control.synthesize import SynthesisResult
    from motionkit.data.options import PreprocessOptions
    from motionkit.data.preprocess import PreprocessReport
    from motionkit.evaluation.report import Scoreboard
    from motionkit.evaluation.settings import EvaluationSettings
    from motionkit.export.clip import Clip
    from motionkit.inference.rollout import Noise
    from motionkit.metrics.report import MetricReport
    from motionkit.metrics.value import MetricSettings
    from motionkit.models.model import MotionModel
    from motionkit.motion.motion import Motion
    from motionkit.rig.rig import Rig
    from motionkit.training.options import TrainOptions
    from motionkit.training.trainer import TrainEvent, TrainResult

# Where a run is given neither steps nor minutes: from random weights, and from a model.
TRAIN_MINUTES, FINE_TUNE_MINUTES = 30.0, 5.0


def read_bvh(path: str | Path, scale: float = 1.0, fps: float | None = None) -> Motion:
    """The motion in a BVH file, on the file's own joints and in its own unit.

    Args:
        scale: multiplies every length.
        fps: the true frame rate, where the file's header is wrong.

    Raises BvhError for a file that cannot be read.
    """
    from motionkit.motion import bvh

    return bvh.bvh_to_motion(bvh.read_bvh(path), scale, fps)


def read_canonical(path: str | Path, scale: float | None = None, fps: float | None = None) -> Motion:
    """The motion in a BVH file of any human rig, on the 23 canonical joints, in cm, at the file's own rate.

    Args:
        scale: centimetres per file unit; guessed from the length of the legs by default.
        fps: the true frame rate, where the file's header is wrong.

    Raises BvhError for a file that cannot be read, SkeletonError for a rig that is not a human one.
    """
    from motionkit.rig.canonical import load_canonical

    return load_canonical(path, scale, fps)[0]


def read_rig(path: str | Path, map: str | Path | None = None) -> Rig:
    """The rig of a BVH, GLB or VRM file, to give to retarget.

    Args:
        path: the file.
        map: a bone map (JSON); by default joints are found by names and shape.

    Raises:
        MotionkitError: for a file or a map that cannot be read, or a rig that is not a human one.
    """
    from motionkit.rig import on_rig

    return on_rig.read_rig(path, map)


def retarget(
    motion: Motion | str | Path, rig: Rig | str | Path, *, ik: bool = True, clip: str | Path | None = None
) -> Clip:
    """A motion on a user's rig, for mk.write; a .bvh file gets the rig's own hierarchy and channels.

    Args:
        motion: on the 23 canonical joints in cm, the floor at height zero, or a BVH file of any human rig.
        rig: from read_rig, or its file.
        ik: put the feet of the rig on the floor and hold them where those of the motion stand.
        clip: BVH file of the rig, whose other joints (fingers, props) move as they do there; at rest by default.

    Returns:
        The clip; its `motion` is on the rig's skeleton, in the rig's unit and axes.

    Raises:
        MotionkitError: for a file that cannot be read, or a rig that is not a human one.
    """
    from motionkit.export.clip import Clip
    from motionkit.finish.on_rig import on_rig
    from motionkit.rig.on_rig import read_clip, read_on_any_rig

    target = read_rig(rig) if isinstance(rig, (str, Path)) else rig
    if isinstance(motion, (str, Path)):
        motion = read_on_any_rig(motion, target)[0]
    made = on_rig(motion, target, ik, None if clip is None else read_clip(clip, target))
    return Clip(made, channels=target.channels, hierarchy=target.hierarchy)


def load_model(path: str | Path | None = None) -> MotionModel:
    """The model in a file; the bundled one by default. Raises ModelError for a file that is no model."""
    from motionkit.models.bundled import open_model

    return open_model(path)


def synthesize(
    types: str | Sequence[str],
    *,
    model: MotionModel | None = None,
    seconds: float | None = None,
    count: int = 1,
    seed: int = 0,
    noise: Noise | None = None,
    reference: str = "auto",
    character: str = "default",
    init: str | Path | Motion | None = None,
    ik: bool = True,
    fps: float | None = None,
    keys: str | Path | Sequence[Key] = (),
) -> SynthesisResult:
    """Synthesize motion types one after another; the same seed gives the same motion.

    Args:
        types: motion types in order, such as "running,cartwheel" or "running:4,cartwheel:3" (seconds); a list of
            such texts gives the characters of count different types, in turn.
        model: the bundled model by default.
        seconds: length of the whole motion; by default 4 s for each type, one performance for types such as flips.
        count: how many motions, made in one batch; motion i has the seed seed + i.
        noise: how frames are drawn from the predicted distribution; by default correlated in time at temperature
            0.05, for models of tptn-paper independently at full sigma.
        reference: "auto", or "none" for the network without its reference recordings.
        character: the body to move; several names with commas are taken in turn.
        init: a BVH file, or a canonical motion in cm, to start from.
        ik: hold feet still while they touch the floor.
        fps: rate of the motions; the model's 60 by default.
        keys: poses to meet (docs/keys.md), a JSON file or Key records.

    Returns:
        The motions; `motion` is the first one.

    Raises:
        ControlError: for an unknown type or character, too many frames, or keys that cannot be met.
    """
    from motionkit.control.keys import check_keys, read_keys
    from motionkit.control.script import parse_types
    from motionkit.control.synthesize import SynthesisOptions
    from motionkit.control.synthesize import synthesize as run

    model = (model or load_model()).with_reference(reference)
    texts = [types] if isinstance(types, str) else list(types)
    plans = [parse_types(text, seconds, model.phase_seconds) for text in texts]
    met = read_keys(keys, model) if isinstance(keys, (str, Path)) else check_keys(keys)
    options = SynthesisOptions(count, seed, noise, character, init, ik, fps, keys=met)
    return run(model, plans, replace(options, count=max(count, len(plans))))


def follow_path(
    path: Path2D | str | Path,
    *,
    model: MotionModel | None = None,
    types: str | None = None,
    size: float | None = None,
    speed: float | None = None,
    strict: bool = False,
    seed: int = 0,
    noise: Noise | None = None,
    reference: str = "auto",
    character: str = "default",
    init: str | Path | None = None,
    ik: bool = True,
    fps: float | None = None,
) -> FollowResult:
    """Let a character follow a path on the ground; the same seed gives the same motion.

    Args:
        path: a path, a JSON or CSV file, or a named shape: line, circle, figure-eight, square, pentagram, u-turn.
        model: the bundled model by default.
        types: for a named shape: types that share its length, such as "running,cartwheel,running"; the model's walk
            by default.
        size: for a named shape: length, radius or side in metres.
        speed: for a named shape: metres per second; each type's own by default.
        strict: refuse speeds at which a gait does not look right, by its recordings; without it the nearest is taken.
        seed, noise, reference, character, init, ik, fps: as in synthesize.

    Returns:
        The motion, its distance from the path in cm, and whether it reached the end.

    Raises:
        ControlError: for an unknown type, shape or character, a path that cannot be read, or, if strict, its speed;
            for types, size or speed beside a path that has its own.
    """
    from motionkit.control import follow
    from motionkit.control.path import Path2D, check_shape_options, read_path, shape_path
    from motionkit.control.speeds import check_speeds
    from motionkit.control.steering import walking_type
    from motionkit.control.synthesize import SynthesisOptions

    model = model or load_model()
    if isinstance(path, Path2D):
        target = path
        check_shape_options(types, size, speed)
    elif Path(path).suffix.lower() in (".json", ".csv") or Path(path).is_file():
        check_shape_options(types, size, speed)
        target = read_path(path)
    else:
        kinds = [walking_type(model)] if types is None else [nfc(word.strip()) for word in types.split(",")]
        target = shape_path(str(path), size, kinds, speed)
    if strict:
        check_speeds(model, target)
    options = SynthesisOptions(1, seed, noise, character, init, ik, fps)
    return follow.follow_path(model.with_reference(reference), target, options)


def measure(
    motion: Motion | str | Path,
    reference: Motion | str | Path | None = None,
    *,
    skip: int = 0,
    align_start: bool = False,
    given: int = 0,
    settings: MetricSettings | None = None,
) -> MetricReport:
    """The metrics of a motion, alone or beside its ground truth (docs/metrics.md defines each).

    Args:
        motion: on the 23 canonical joints in cm, or a BVH file of any rig.
        reference: the ground truth, likewise.
        skip: frames at 60 fps to leave out at the start of both.
        align_start: turn and move the motion to start as the reference does.
        given: frames at 60 fps at the start of the reference alone, which the motion continues.
        settings: thresholds; the documented definitions by default.

    Raises:
        MotionkitError: for a file that cannot be used, or fewer than two common frames.
    """
    from motionkit.metrics.report import evaluate_motion

    ground_truth = None if reference is None else _canonical(reference)
    return evaluate_motion(_canonical(motion), ground_truth, settings, skip, align_start, given)


def _canonical(motion: Motion | str | Path) -> Motion:
    return read_canonical(motion) if isinstance(motion, (str, Path)) else motion


def write_view(
    path: str | Path, *motions: Motion, names: Sequence[str] = (), width: int | None = None
) -> None:
    """Write motions as a page that plays them (.html), a contact sheet (.png), a GIF or a film (.mp4).

    Args:
        path: the file; its ending says what it is.
        motions: of any rig and rate.
        names: captions; "motion 1", "motion 2" ... by default.
        width: in pixels; by default 1800 for a sheet, 480 for a GIF and 960 for a film.

    Raises MotionkitError for another ending, and without Pillow for pictures (`pip install 'motionkit[view]'`).
    """
    from motionkit.view.figure_data import shown_motions

    shown = shown_motions(motions, names or ())
    kind = Path(path).suffix.lower()
    if kind == ".html":
        from motionkit.view.viewer import write_viewer

        write_viewer(path, shown)
    elif kind == ".png":
        from motionkit.view.contact_sheet import write_contact_sheet

        write_contact_sheet(path, [(one.name, one.motion) for one in shown], width=width or 1800)
    elif kind in (".gif", ".mp4"):
        from motionkit.view.film import write_film

        write_film(path, shown, width)
    else:
        raise MotionkitError(f"{path}: expected a file that ends with .html, .png, .gif or .mp4")


def preprocess(
    folders: Sequence[str | Path],
    output: str | Path,
    options: PreprocessOptions | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    *,
    references: str | Path = "bundled",
) -> PreprocessReport:
    """Make a dataset folder from BVH files, atomically.

    Args:
        folders: folders (or files) to read.
        output: dataset folder to write; an old dataset there is replaced, other files in it are kept.
        options: the defaults if None.
        progress: called with a stage name, the number of files done and of all files.
        references: the model that training is to begin from, whose reference rotations the features are relative to;
            "own" for the mean rotations of the data. options.reference_rotations takes precedence.

    Raises:
        DatasetError: no file is usable, a file is inside output, or, with strict, a file is unusable.
        ModelError: references is no model, or one of another layout.
    """
    from motionkit.data import preprocess as room
    from motionkit.data.options import PreprocessOptions
    from motionkit.models.bundled import reference_rotations

    options = options or PreprocessOptions()
    if options.reference_rotations is None:
        options = replace(options, reference_rotations=reference_rotations(references, options.layout))
    return room.preprocess(folders, output, options, progress)


def train(
    dataset: str | Path,
    output: str | Path = "model.safetensors",
    options: TrainOptions | None = None,
    *,
    resume: bool = False,
    run_folder: str | Path | None = None,
    device: str = "auto",
    on_event: Callable[[TrainEvent], None] | None = None,
) -> TrainResult:
    """Train a motion model on a dataset folder and write one model file. Needs torch.

    Args:
        dataset: the folder that preprocess wrote.
        output: the model file; an old one is replaced.
        options: from train_options; by default the preset tptn for 5 minutes from the bundled model.
        resume: go on from the checkpoint in the run folder.
        run_folder: for checkpoint, log and samples; beside the model by default.
        device: "auto", "cpu", "cuda" or "cuda:1".
        on_event: called with losses, scores and notes.

    Raises:
        MotionkitError: without torch, or for a dataset or checkpoint that does not fit.
    """
    if find_spec("torch") is None:
        raise MotionkitError("training needs torch: pip install 'motionkit[train]'")
    from motionkit.training import trainer
    from motionkit.training.presets import fine_tune_options

    options = options or fine_tune_options("tptn", minutes=FINE_TUNE_MINUTES)
    return trainer.train(dataset, output, options, resume, run_folder, device, on_event)


def evaluate(
    dataset: str | Path,
    *,
    model: MotionModel | None = None,
    only: Sequence[str] = (),
    settings: EvaluationSettings | None = None,
    jobs: int = 1,
) -> Scoreboard:
    """The scoreboard of a model against the recordings of a dataset folder (docs/evaluation.md).

    Args:
        model: the bundled model by default.
        only: names of the sections to measure; all by default.
        settings: how much is measured, on which split, with or without reference recordings; the test split, 20
            roll-outs of each type by default.
        jobs: processes that roll out; the result does not depend on them.

    Raises:
        ControlError: for an unknown section.
        DatasetError: for a folder that is no dataset, or does not fit the model.
    """
    from motionkit.data.dataset import Dataset
    from motionkit.evaluation.scoreboard import evaluate_model

    return evaluate_model(model or load_model(), Dataset(dataset), settings, only, jobs=jobs)
