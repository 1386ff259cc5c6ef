"""The LaFAN1 protocol on a folder of its files: performers, statistics, and what fills the gaps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from motionkit.control.keys import Key, clip_pose
from motionkit.control.script import TypePart
from motionkit.control.synthesize import SynthesisOptions, synthesize
from motionkit.errors import MotionkitError
from motionkit.inference.noise import Noise
from motionkit.metrics.in_betweening import (
    GAPS,
    PAST,
    TEST,
    TRAINING,
    Scale,
    Windows,
    gap_errors,
    interpolated,
    last_pose,
    windows_of,
)  # fmt: skip
from motionkit.metrics.value import MetricValue
from motionkit.models.model import MotionModel
from motionkit.motion.bvh import bvh_to_motion, read_bvh
from motionkit.motion.motion import Motion, resample
from motionkit.motion.rotations import quat_continuous
from motionkit.rig.on_rig import from_rig, read_rig
from motionkit.rig.read_file import motion_files
from motionkit.rig.rig import Rig
from motionkit.rig.to_rig import to_rig

HELD_OUT = "subject5"
FPS = 30.0
# L2P, L2Q and NPSS by gap (Harvey et al. 2020, as the data set's own tests have them); a copy of the data gives these.
PUBLISHED: dict[str, dict[int, tuple[float, float, float]]] = {
    "zero velocity": {
        5: (1.52, 0.56, 0.0053), 15: (3.69, 1.10, 0.0522), 30: (6.60, 1.51, 0.2318), 45: (9.33, 1.81, 0.4918),
    },
    "interpolation": {
        5: (0.37, 0.22, 0.0023), 15: (1.25, 0.62, 0.0391), 30: (2.32, 0.98, 0.2013), 45: (3.45, 1.25, 0.4493),
    },
}  # fmt: skip
Fill = Callable[[Windows, int], Windows]
Row = tuple[int, str, int, tuple[MetricValue, ...]]  # frames of the gap, what filled it, windows, errors


def performers(folder: Path) -> tuple[list[Path], list[Path]]:
    """Return the training and the test files of a folder, by the performer in the names: walk1_subject5.bvh.

    Raises:
        MotionkitError: one of the two is empty.
    """
    files = [
        path for path in motion_files(folder) if path.suffix.lower() == ".bvh" and "_subject" in path.stem
    ]
    test = [path for path in files if path.stem.lower().endswith(f"_{HELD_OUT}")]
    training = [path for path in files if path not in test]
    if not training or not test:
        raise MotionkitError(
            f"{folder}: expected LaFAN1's BVH files, such as walk1_subject1.bvh, of {HELD_OUT} and of others"
        )
    return training, test


def read_at_rate(path: Path) -> Motion:
    """Return the motion of a file in its own unit at 30 frames a second."""
    return resample(bvh_to_motion(read_bvh(path)), FPS)


def in_between(
    folder: Path, model: MotionModel | None = None, kind: str = "", most: int = 0
) -> Iterator[Row]:
    """Yield the errors of every way to fill the gaps, for each length of gap.

    Args:
        model: fills the gaps as one more way, and its error of mapping the recordings there and back as another.
        most: windows that are tested, evenly spread; all if 0.

    Raises:
        MotionkitError: the folder has not the files, or they have other joints.
    """
    training, test = performers(folder)
    scale = Scale.of(windows_of(map(read_at_rate, training), *TRAINING))
    windows = windows_of(map(read_at_rate, test), *TEST)
    if 0 < most < len(windows.roots):
        at = np.linspace(0, len(windows.roots) - 1, most).round().astype(int)
        windows = replace(windows, rotations=windows.rotations[at], roots=windows.roots[at])
    methods: dict[str, Fill] = {"zero velocity": last_pose, "interpolation": interpolated}
    if model is not None:
        rig = read_rig(test[0])
        methods["recording, mapped there and back"] = lambda each, gap: _mapped(
            each.part(PAST, PAST + gap), rig
        )
        methods["model"] = lambda each, gap: _filled(each, gap, model, kind, rig)
    for gap in GAPS:
        truth = windows.part(PAST, PAST + gap)
        for name, fill in methods.items():
            yield gap, name, len(windows.roots), gap_errors(fill(windows, gap), truth, scale)


def _each(windows: Windows) -> Iterator[Motion]:
    for rotations, roots in zip(windows.rotations, windows.roots, strict=True):
        yield Motion(windows.skeleton, rotations.astype(np.float32), roots.astype(np.float32), FPS)


def _together(windows: Windows, motions: list[Motion]) -> Windows:
    """Motions as windows, with the signs of quaternions that go on from the frame before the gap of windows."""
    turns = [
        quat_continuous(np.concatenate([before[None], motion.local_rotations]))[1:]
        for before, motion in zip(windows.rotations[:, PAST - 1], motions, strict=True)
    ]
    return replace(
        windows,
        rotations=np.stack(turns).astype(np.float64),
        roots=np.stack([motion.root_positions for motion in motions]).astype(np.float64),
    )


def _mapped(truth: Windows, rig: Rig) -> Windows:
    made = [resample(to_rig(resample(from_rig(each, rig), 60.0), rig), FPS) for each in _each(truth)]
    turns = [np.where((m.local_rotations * r).sum(-1, keepdims=True) < 0, -m.local_rotations, m.local_rotations)
             for m, r in zip(made, truth.rotations, strict=True)]  # fmt: skip
    return replace(
        truth, rotations=np.stack(turns).astype(np.float64), roots=np.stack([m.root_positions for m in made])
    )


def _filled(windows: Windows, gap: int, model: MotionModel, kind: str, rig: Rig) -> Windows:
    """Gaps filled by a model, which is given the frames before and the goal as a key."""
    bridge = interpolated(windows, gap)  # how fast the goal is reached is not known
    goal = windows.part(PAST + gap, PAST + gap + 1)
    made = []
    for past, between, end in zip(*map(_each, (windows.part(0, PAST), bridge, goal)), strict=True):
        clip = resample(from_rig(past.followed_by(between).followed_by(end), rig), model.fps)
        first, last = round((PAST - 1) * model.fps / FPS) + 1, len(clip) - 1
        pose, place = clip_pose(model, clip, last)
        key = Key((last - first) / model.fps, pose, position=place[:2], facing=float(place[2]))
        options = SynthesisOptions(noise=Noise("mean", 0.0), init=clip.cut(0, first), keys=(key,))
        drawn = synthesize(model, [TypePart(kind, (last - first + 1) / model.fps)], options).motion
        whole = resample(to_rig(clip.cut(0, first).followed_by(drawn), rig), FPS)
        made.append(whole.cut(PAST, PAST + gap))
    return _together(windows, made)
