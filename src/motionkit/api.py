"""The functions behind `import motionkit as mk` that are more than a room's own: the command line's steps, as calls.

Their defaults are those of the commands; a test compares the two.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing_extensions import Unpack  # a part of typing from Python 3.11 on

    from motionkit.control.follow import FollowResult
    from motionkit.control.path import Path2D
    from motionkit.control.synthesize import SynthesisResult
    from motionkit.data.options import PreprocessOptions
    from motionkit.data.preprocess import PreprocessReport
    from motionkit.editing.loop import Loop
    from motionkit.evaluation.report import Scoreboard
    from motionkit.evaluation.settings import EvaluationSettings
    from motionkit.export.clip import Clip
    from motionkit.first_model import QuickstartOptions, QuickstartResult, Watcher
    from motionkit.metrics.report import MetricReport
    from motionkit.metrics.value import MetricSettings
    from motionkit.models.model import MotionModel
    from motionkit.motion.motion import Motion
    from motionkit.requests import MotionWords, PathWords, SynthesisWords
    from motionkit.rig.rig import Rig


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


def synthesize(types: str | Sequence[str], **options: Unpack[SynthesisWords]) -> SynthesisResult:
    """Synthesize motion types one after another; the same seed gives the same motion.

    Args:
        types: motion types in order, such as "running,cartwheel" or "running:4,cartwheel:3" (seconds); a list of
            such texts gives the characters of count different types, in turn.
        model: the bundled model by default.
        seconds: length of the whole motion; by default 4 s for each type, one performance for types such as flips.
        count: how many motions, made in one batch, 1 by default; motion i has the seed seed + i.
        seed: 0 by default.
        noise: how frames are drawn from the predicted distribution; by default correlated in time at temperature
            0.05, for models of tptn-paper independently at full sigma.
        reference: "auto", or "none" for the network without its reference recordings.
        character: the body to move; several names with commas are taken in turn; "default" by default.
        init: a BVH file, or a canonical motion in cm, to start from.
        ik: hold feet still while they touch the floor, True by default.
        fps: rate of the motions; the model's 60 by default.
        keys: poses to meet (docs/keys.md), a JSON file or Key records.

    Returns:
        The motions; `motion` is the first one.

    Raises:
        ControlError: for an unknown type or character, too many frames, or keys that cannot be met.
    """
    from motionkit.requests import synthesis_request

    return synthesis_request(types, **options).run()


def loop(
    types: str, *, seconds: float | None = None, **options: Unpack[MotionWords]
) -> tuple[SynthesisResult, list[Loop]]:
    """Synthesize a gait or a dance and close its best cycle, from the origin, facing +Z: `motionkit synthesize --loop`.

    Args:
        types: one motion type, such as "walking".
        seconds: length to look for; that of the shortest good cycle by default.
        options: as in synthesize.

    Returns:
        The result with the cycle as its motion, and the cycle with its seam (mk.make_loop).

    Raises:
        MotionkitError: the motion never repeats.
    """
    from motionkit.editing.loop import loop_seconds
    from motionkit.requests import synthesis_request

    return synthesis_request(types, seconds=loop_seconds(seconds), **options).loops(seconds)


def follow_path(path: Path2D | str | Path, **options: Unpack[PathWords]) -> FollowResult:
    """Let a character follow a path on the ground; the same seed gives the same motion.

    Args:
        path: a path, a JSON or CSV file, or a named shape: line, circle, figure-eight, square, pentagram, u-turn.
        types: for a named shape: types that share its length, such as "running,cartwheel,running"; the model's walk
            by default.
        size: for a named shape: length, radius or side in metres.
        speed: for a named shape: metres per second; each type's own by default.
        strict: refuse speeds at which a gait does not look right, by its recordings; without it the nearest is taken.
        model, seed, noise, reference, character, init, ik, fps: as in synthesize.

    Returns:
        The motion, its distance from the path in cm, and whether it reached the end.

    Raises:
        ControlError: for an unknown type, shape or character, a path that cannot be read, or, if strict, its speed;
            for types, size or speed beside a path that has its own.
    """
    from motionkit.requests import path_request

    return path_request(path, **options).run()


def quickstart(
    data: str | Path,
    output: str | Path | None = None,
    options: QuickstartOptions | None = None,
    watcher: Watcher | None = None,
) -> QuickstartResult:
    """Train a model on a folder of clips, show its types and judge each; arguments as in first_model.quickstart."""
    from motionkit import first_model

    return first_model.quickstart(data, output, options, watcher)


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
    from motionkit.models.bundled import open_model

    return evaluate_model(model or open_model(), Dataset(dataset), settings, only, jobs=jobs)
