"""Long roll-outs from 30 initial frames (paper section 5.2): whether a network holds without a given trajectory.

Types are given; the trajectory is the network's own prediction, fed back. A roll-out falls apart where its poses leave
those of the recordings.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from motionkit.arrays import Array, distances_between
from motionkit.data.dataset import Dataset
from motionkit.errors import ControlError, DatasetError, MotionkitError
from motionkit.features.control import Controls
from motionkit.lab.held_out import HeldOut, continued, decoded
from motionkit.lab.paper.datasets import is_dance
from motionkit.lab.statistics import rounded
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import FOOT_JOINTS

INITIAL = 30  # frames
SPANS = 4  # a roll-out is measured in so many parts
NEAREST = 20_000  # training frames of a type to compare with, at most
LONG_HEADER = (
    "type", "seed", "cm from recordings", "held out", "swing (cm)", "recorded", "cm/s", "recorded", "at most", "holds",
)  # fmt: skip
CHUNK = 200  # frames that are compared at a time
# Of the recording that was held out: a roll-out that is further from the training clips than this many times its
# distance, or whose feet swing this many times more or less, has fallen apart; so has one that goes faster than any
# part of a training stretch of its type that is as long.
APART = 2.0


@dataclass(frozen=True, eq=False)
class LongRollout:
    """A roll-out of one type: its motion, and what was measured in each part of it."""

    type: str
    motion: Motion
    facts: dict[str, Any]


def long_types(dataset: Dataset, requested: Sequence[str] = ()) -> list[str]:
    """Return the types to roll out: those asked for, else walking, running and the dance with the longest test stretch.

    Raises:
        DatasetError: if one of them has no test clip.
    """
    counts: dict[str, int] = {}
    for _, start, end, kind in dataset.stretches("test"):
        counts[kind] = max(counts.get(kind, 0), end - start)
    dances = sorted((kind for kind in counts if is_dance(kind)), key=lambda k: (-counts[k], k))
    kinds = list(requested) or ["walking", "running", *dances[:1]]
    lacking = [kind for kind in kinds if counts.get(kind, 0) < INITIAL]
    if lacking or not (requested or dances):
        raise DatasetError(
            f"{dataset.folder}: no test clip of {', '.join(lacking) or 'a dance'} to begin from"
        )
    return kinds


def types_known(model: MotionModel, kinds: Sequence[str], requested: bool) -> list[str]:
    """Return those of the types that a model knows.

    Raises:
        ControlError: it does not know one that was requested, or none.
    """
    if requested:
        for kind in kinds:
            model.type_id(kind)
    known = [kind for kind in kinds if kind in model.types]
    if not known:
        raise ControlError(f"the model knows none of {', '.join(kinds)}; choose others with --type")
    return known


def check_layout(dataset: Dataset, model: MotionModel) -> None:
    """Check that a dataset has the features that a model was trained on. Raises DatasetError if not."""
    dataset.check_layout(model.config.layout, "the model needs")
    if dataset.fps != model.fps:
        raise DatasetError(
            f"{dataset.folder}: {dataset.fps:g} frames a second, but the model needs {model.fps:g}: run preprocess "
            f"with --fps {model.fps:g}"
        )


def initial_stretch(dataset: Dataset, kind: str) -> HeldOut:
    """Return the first INITIAL frames of the longest stretch of a type in the test clips, and the frames after them."""
    clip, start, end, _ = max(dataset.stretches("test", kind), key=lambda each: each[2] - each[1])
    stretch = replace(clip, start=clip.start + start, frames=end - start)
    return HeldOut(stretch, dataset.read(stretch), INITIAL, end - start - INITIAL, kind)


def long_rollout(
    model: MotionModel,
    dataset: Dataset,
    kind: str,
    seconds: float,
    seed: int,
    progress: Callable[[float], None],
) -> LongRollout:
    """Roll out a type from INITIAL recorded frames, and compare its poses with those of the training clips.

    Raises:
        MotionkitError: the model is not one of tptn-paper's kind, which predict their trajectory.
        DatasetError: the dataset has other features than the model.
    """
    if not model.plain:
        raise MotionkitError("long roll-outs are for models that feed their own trajectory back (tptn-paper)")
    check_layout(dataset, model)
    sequence = initial_stretch(dataset, kind)
    frames = round(seconds * model.fps)
    features = continued(
        model,
        sequence,
        dataset.skeleton(sequence.clip),
        Controls.of_types(model.type_weights(kind)[None]),
        frames,
        seed,
        lambda frame: progress(frame / frames),
    )
    motion = decoded(dataset, sequence, features)
    facts = {"type": kind, "clip": sequence.clip.name, "seed": seed, "seconds": seconds}
    facts |= _measured(dataset, sequence, features, motion)
    return LongRollout(kind, motion, facts | {"holds": holds(facts)})


def _measured(dataset: Dataset, sequence: HeldOut, features: Array, motion: Motion) -> dict[str, Any]:
    """Poses, feet and speed of each part of a roll-out, beside those of the recording."""
    recorded, layout = sequence.data.features[sequence.initial :], dataset.layout
    poses, feet = layout.blocks["joint_positions"], layout.block_columns("joint_positions", FOOT_JOINTS)
    library = _poses(dataset, sequence.kind)
    made = _distances(features[:, poses], library)
    recorded_distance = float(_distances(recorded[:, poses], library).mean()) if len(recorded) else math.nan
    parts = np.array_split(np.arange(len(features)), SPANS)
    return {
        "distance": [rounded(float(made[part].mean())) for part in parts],
        "distance-recorded": rounded(recorded_distance),
        "swing": [_swing(features[part][:, feet]) for part in parts],
        "swing-recorded": _swing(recorded[:, feet]),
        "speed": [_speed(motion, part) for part in parts],
        "speed-recorded": _speed(decoded(dataset, sequence, recorded), np.arange(len(recorded))),
        "speed-fastest": fastest_recorded(dataset, sequence.kind, len(parts[0])),
    }


def holds(facts: dict[str, Any]) -> bool:
    """Return whether no part of a roll-out has fallen apart (APART)."""
    swing = facts["swing-recorded"]
    return bool(
        max(facts["distance"]) < APART * facts["distance-recorded"]
        and all(swing / APART < each < swing * APART for each in facts["swing"])
        and max(facts["speed"]) <= facts["speed-fastest"]
    )


def _poses(dataset: Dataset, kind: str) -> Array:
    """Joint positions (N, D) of the training frames of a type, thinned out evenly to NEAREST."""
    number, rows = dataset.types.index(kind), []
    for clip in dataset.select("train"):
        data = dataset.read(clip)
        rows.append(data.features[data.types == number][:, dataset.layout.blocks["joint_positions"]])
    poses = np.concatenate(rows)
    return poses[:: -(-len(poses) // NEAREST)]


def _distances(poses: Array, library: Array) -> Array:
    """Distance (T,) of each pose to the nearest of a library: the root mean square over joints, in cm."""
    parts = [poses[start : start + CHUNK] for start in range(0, len(poses), CHUNK)]
    nearest = np.concatenate([distances_between(part, library).min(axis=1) for part in parts])
    return nearest / math.sqrt(library.shape[1] / 3.0)


def _swing(feet: Array) -> float:
    """How far feet (T, D) swing about their mean place, cm: trembling hardly counts, steps do."""
    spread = feet.astype(np.float64).var(axis=0).sum() / len(FOOT_JOINTS)
    return rounded(math.sqrt(spread))


def _speed(motion: Motion, frames: Array) -> float:
    """Mean speed of the root over the ground in cm/s."""
    steps = np.diff(motion.root_positions[frames][:, [0, 2]].astype(np.float64), axis=0)
    return rounded(float(np.linalg.norm(steps, axis=1).mean()) * motion.fps)


def fastest_recorded(dataset: Dataset, kind: str, frames: int) -> float:
    """Mean speed over the ground, in cm/s, of the fastest frames in a row of a type in the training clips.

    Shorter stretches count as a whole if they last a second.
    """
    speeds = [0.0]
    for clip, start, end, _ in dataset.stretches("train", kind):
        if end - start >= dataset.fps:
            ground = dataset.read(clip, start, end).ground[:, :2].astype(np.float64)
            steps = np.linalg.norm(np.diff(ground, axis=0), axis=1)
            distance, count = np.pad(steps.cumsum(), (1, 0)), min(len(steps), frames - 1)
            speeds.append(float((distance[count:] - distance[:-count]).max()) / count * dataset.fps)
    return rounded(max(speeds))


def long_row(facts: dict[str, Any]) -> tuple[str, ...]:
    """Return the cells of a roll-out in a table, under LONG_HEADER."""
    distances = ", ".join(f"{d:.1f}" for d in facts["distance"])
    moves, speeds = (", ".join(f"{v:.0f}" for v in facts[key]) for key in ("swing", "speed"))
    return (
        facts["type"],
        f"{facts['seed']}",
        distances,
        f"{facts['distance-recorded']:.1f}",
        moves,
        f"{facts['swing-recorded']:.0f}",
        speeds,
        f"{facts['speed-recorded']:.0f}",
        f"{facts['speed-fastest']:.0f}",
        "yes" if facts["holds"] else "no",
    )


def sheet_name(model: str) -> str:
    """Return the file name of a model's contact sheet beside docs/experiments.md."""
    return f"long-{model}.png"
