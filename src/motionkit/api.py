"""Public functions of `import motionkit as mk` that combine several packages: the steps of the command line as calls.

Defaults are those of the commands; a test compares them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing_extensions import Unpack  # in typing from Python 3.11 on

    from motionkit.control.follow import FollowResult
    from motionkit.control.path import Path2D
    from motionkit.control.synthesize import SynthesisResult
    from motionkit.data.options import PreprocessOptions
    from motionkit.data.preprocess import PreprocessReport
    from motionkit.editing.loop import Loop
    from motionkit.export.clip import Clip
    from motionkit.finish.finish import Unfinished
    from motionkit.first_model import QuickstartOptions, QuickstartResult, Watcher
    from motionkit.metrics.report import MetricReport
    from motionkit.metrics.value import MetricSettings
    from motionkit.motion.motion import Motion
    from motionkit.requests import MotionWords, PathWords, SynthesisWords
    from motionkit.rig.rig import Rig


def read_bvh(path: str | Path, scale: float = 1.0, fps: float | None = None) -> Motion:
    """Read a BVH file; the motion keeps the file's joints and unit.

    Args:
        scale: multiplies every length.
        fps: the true frame rate, where the file's header is wrong.

    Raises BvhError for a file that cannot be read.
    """
    from motionkit.motion import bvh

    return bvh.bvh_to_motion(bvh.read_bvh(path), scale, fps)


def read_canonical(path: str | Path, scale: float | None = None, fps: float | None = None) -> Motion:
    """Read a BVH file of any human rig as a motion on the 23 canonical joints, in cm, at the file's frame rate.

    Args:
        scale: centimetres per file unit; by default estimated from the length of the legs.
        fps: the true frame rate, where the file's header is wrong.

    Raises BvhError for a file that cannot be read, SkeletonError for a rig that is not human.
    """
    from motionkit.rig.canonical import load_canonical

    return load_canonical(path, scale, fps)[0]


def read_rig(path: str | Path, map: str | Path | None = None) -> Rig:
    """Read the rig of a BVH, GLB or VRM file, for use with retarget.

    Args:
        path: the file, or the name of a built-in rig, such as "@mixamo".
        map: a bone map (JSON); by default joints are recognized by name and shape.

    Raises:
        MotionkitError: a file or a map cannot be read, or the rig is not human.
    """
    from motionkit.rig import on_rig

    return on_rig.read_rig(path, map)


def retarget(
    motion: Motion | SynthesisResult | FollowResult | str | Path,
    rig: Rig | str | Path,
    *,
    ik: bool = True,
    clip: str | Path | None = None,
    fps: float | None = None,
) -> Clip:
    """Retarget a motion to a user's rig; mk.write saves the result. A .bvh file keeps the rig's hierarchy and channels.
    A .glb or .vrm file is that of the rig, if it is one, with the motion as one more animation.

    The motion is resized as a whole. To meet keys or a path in the rig's world, make it with places divided by
    `rig.size(model.character("default"))`: `Key.scaled`, `Path2D.scaled` (the command line does).

    Args:
        motion: on the 23 canonical joints in cm, the floor at height zero; a result of synthesize or follow_path, whose
            feet are then locked on the rig's body alone, or of loop, which is closed again; or a BVH file of any human
            rig.
        rig: result of read_rig, or what it takes.
        ik: keep the rig's feet on the floor, and hold them while those of the motion are in contact.
        clip: BVH file of the rig that animates its other joints (fingers, props); by default they keep their rest pose.
        fps: frame rate of the clip; by default the one that readers of a built-in rig expect, else that of the motion.

    Returns:
        The clip; its `motion` is on the rig's skeleton, in the rig's unit and axes.

    Raises:
        MotionkitError: a file cannot be read, or a rig is not human.
    """
    from motionkit.control.synthesize import SynthesisResult
    from motionkit.editing.loop import at_rate, cycle_on_rig
    from motionkit.errors import naming
    from motionkit.export.clip import rig_clip
    from motionkit.finish.on_rig import on_rig
    from motionkit.motion.motion import Motion
    from motionkit.rig.on_rig import canonical_for, read_clip
    from motionkit.rig.read_file import read_file

    target = read_rig(rig) if isinstance(rig, (str, Path)) else rig
    drawn: Unfinished | None = None
    types: tuple[tuple[str, float], ...] = ()
    cyclic = False
    if isinstance(motion, (str, Path)):
        with naming(motion):
            motion = canonical_for(read_file(motion), target)[0]
    elif not isinstance(motion, Motion):
        types = tuple((part.type, part.seconds) for part in motion.types)
        if isinstance(motion, SynthesisResult):
            cyclic = motion.motions[0].cyclic
        drawn, motion = motion.unfinished, motion.motion
    rate = target.fps if fps is None else fps
    if rate is not None:
        motion = at_rate(motion, rate, cyclic)
    other = None if clip is None else read_clip(clip, target)
    made = cycle_on_rig(motion, target, ik, other) if cyclic else on_rig(motion, target, ik, other, drawn)
    return rig_clip(made, target, "motion", types)


def synthesize(types: str | Sequence[str], **options: Unpack[SynthesisWords]) -> SynthesisResult:
    """Synthesize motion types one after another; the same seed gives the same motion.

    Args:
        types: motion types in order, such as "running,cartwheel" or "running:4,cartwheel:3" (seconds). A list of such
            texts is assigned to the characters in turn.
        model: a model or its file; the bundled model by default.
        seconds: length of the whole motion; by default 4 s per type, and one performance of types such as flips.
        count: number of motions, 1 by default, made in one batch; motion i has the seed seed + i.
        seed: 0 by default.
        noise: how frames are sampled from the predicted distribution. By default noise is correlated in time, at
            temperature 0.05; models of tptn-paper sample frames independently, at full sigma.
        reference: "auto", or "none" to run the network without its reference recordings.
        character: body of the character, "default" by default; several names, separated by commas, are used in turn.
        init: start pose: a BVH file, or a canonical motion in cm.
        ik: lock feet during contacts, True by default.
        fps: frame rate of the motions; by default the model's, 60.
        keys: key poses to reach (docs/keys.md): a JSON file or Key records.

    Returns:
        The motions; `motion` is the first one.

    Raises:
        ControlError: an unknown type or character, too many frames, or keys that cannot be reached.
    """
    from motionkit.requests import synthesis_request

    return synthesis_request(types, **options).run()


def loop(
    types: str, *, seconds: float | None = None, **options: Unpack[MotionWords]
) -> tuple[SynthesisResult, list[Loop]]:
    """Synthesize a gait or a dance and close its best cycle. It begins at the origin, facing +Z (`synthesize --loop`).

    Args:
        types: one motion type, such as "walking".
        seconds: length of the cycle; by default that of the shortest good one.
        options: as in synthesize.

    Returns:
        The result, whose motion is the cycle; and the cycle with its seam (mk.make_loop).

    Raises:
        MotionkitError: the motion never repeats.
    """
    from motionkit.editing.loop import loop_seconds
    from motionkit.requests import loop_wish, synthesis_request

    seconds = loop_wish(types, seconds)
    return synthesis_request(types, seconds=loop_seconds(seconds), **options).loops(seconds)


def follow_path(path: Path2D | str | Path, **options: Unpack[PathWords]) -> FollowResult:
    """Make a character follow a path on the ground; the same seed gives the same motion.

    Args:
        path: a path, a JSON or CSV file, or a named shape: line, circle, figure-eight, square, pentagram, u-turn.
        types: for a named shape: types for equal parts of its length, such as "running,cartwheel,running"; by default
            the model's walk.
        size: for a named shape: length, radius or side in metres.
        speed: for a named shape: metres per second; by default the speed of each type.
        strict: refuse speeds outside the range of a gait's recordings; without it, speeds are limited to that range.
        model, seed, noise, reference, character, init, ik, fps: as in synthesize.

    Returns:
        The motion, its distance from the path in cm, and whether it reached the end.

    Raises:
        ControlError: an unknown type, shape or character; a path that cannot be read; with strict, a speed outside the
            range; types, size or speed for a path that is not a named shape.
    """
    from motionkit.requests import path_request

    return path_request(path, **options).run()


def quickstart(
    data: str | Path,
    output: str | Path | None = None,
    options: QuickstartOptions | None = None,
    watcher: Watcher | None = None,
) -> QuickstartResult:
    """Train a model on a folder of clips, show its types and judge each; arguments as for first_model.quickstart."""
    from motionkit import first_model

    return first_model.quickstart(data, output, options, watcher)


def measure(
    motion: Motion | SynthesisResult | FollowResult | Clip | str | Path,
    reference: Motion | SynthesisResult | FollowResult | Clip | str | Path | None = None,
    *,
    skip: int = 0,
    align_start: bool = False,
    given: int = 0,
    settings: MetricSettings | None = None,
) -> MetricReport:
    """Compute the metrics of a motion, alone or against its ground truth (docs/metrics.md defines them).

    Args:
        motion: on the 23 canonical joints in cm, what holds one, or a BVH file of any rig.
        reference: the ground truth, likewise.
        skip: frames at 60 fps to leave out at the start of both.
        align_start: turn and move the motion so that it starts like the reference.
        given: frames at 60 fps at the start of the reference that the motion does not contain, because it continues
            them.
        settings: thresholds; the documented definitions by default.

    Raises:
        MotionkitError: a file cannot be used, there are fewer than two common frames, or given or align_start comes
            without a reference.
    """
    from motionkit.metrics.report import evaluate_files, evaluate_motion

    if isinstance(motion, (str, Path)) and isinstance(reference, (str, Path)):
        return evaluate_files(reference, motion, settings, skip, align_start, given=given)
    ground_truth = None if reference is None else _canonical(reference)
    return evaluate_motion(_canonical(motion), ground_truth, settings, skip, align_start, given)


def _canonical(motion: Motion | SynthesisResult | FollowResult | Clip | str | Path) -> Motion:
    if isinstance(motion, (str, Path)):
        return read_canonical(motion)
    from motionkit.motion.motion import Motion

    return motion if isinstance(motion, Motion) else motion.motion


def preprocess(
    folders: Sequence[str | Path],
    output: str | Path,
    options: PreprocessOptions | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    *,
    references: str | Path = "bundled",
) -> PreprocessReport:
    """Make a dataset folder from BVH files. It is written atomically.

    Args:
        folders: folders (or files) to read.
        output: dataset folder to write; replaces an old dataset there and keeps other files.
        options: defaults if None.
        progress: called with the stage, the number of files done and the number of all files.
        references: model that training will start from: features use its reference rotations. "own" uses the mean
            rotations of the data. options.reference_rotations takes precedence.

    Raises:
        DatasetError: no file is usable, a file is inside output, or, with strict, any file is unusable.
        ModelError: references is not a model, or has another layout.
    """
    from motionkit.data import preprocess as room
    from motionkit.data.options import PreprocessOptions
    from motionkit.models.bundled import reference_rotations

    options = options or PreprocessOptions()
    if options.reference_rotations is None:
        options = replace(options, reference_rotations=reference_rotations(references, options.layout))
    return room.preprocess(folders, output, options, progress)
