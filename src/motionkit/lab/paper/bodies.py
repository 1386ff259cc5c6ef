"""The skeleton control signal c^s (paper section 3), shown with several performers.

All roll-outs begin with the same recorded frames, have the same types and trajectory, and differ in c^s alone. The
network predicts joint positions beside rotations, so the limbs of a body that it moves can be measured in them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from motionkit.arrays import Array
from motionkit.data.dataset import Clip, Dataset
from motionkit.errors import DatasetError, MotionkitError
from motionkit.features.decode import joint_positions
from motionkit.lab.held_out import continued
from motionkit.lab.paper.long_rollouts import INITIAL, check_layout, initial_stretch
from motionkit.lab.paper.protocol import sequence_controls
from motionkit.lab.statistics import rounded
from motionkit.models.model import MotionModel
from motionkit.motion.skeleton import JOINT_NAMES, Skeleton, canonical_skeleton, leg_length

PERFORMERS = 5
FORGOTTEN = 90  # frames after which the network no longer sees the initial ones
MADE = 240  # frames of a roll-out
LEAST = 60  # frames of a performer's recordings to compare with
SHORT = 30  # frames; shorter stretches are left out
LIMBS = {
    "legs": (("LeftUpLeg", "LeftLeg", "LeftFoot"), ("RightUpLeg", "RightLeg", "RightFoot")),
    "arms": (("LeftArm", "LeftForeArm", "LeftHand"), ("RightArm", "RightForeArm", "RightHand")),
}
MEASURES = ("legs", "arms", "hips", "step")  # cm
BODIES_HEADER = ("performer", *(f"{name}, {what}" for name in MEASURES for what in ("own", "made")))


def performers(dataset: Dataset, kind: str, count: int = PERFORMERS) -> dict[str, int]:
    """Return performers with recordings of a type, by name their body: from short to long legs, evenly spread.

    Raises:
        DatasetError: if fewer than count bodies have recordings of the type.
    """
    names: dict[int, str] = {}
    for clip in dataset.clips:
        names.setdefault(clip.body, clip.subject or f"body-{clip.body}")
    found = [
        body
        for body in names
        if sum(end - start for _, start, end in _stretches(dataset, body, kind)) >= LEAST
    ]
    if len(found) < count:
        raise DatasetError(
            f"{dataset.folder}: bodies with {kind}: {len(found)}, expected at least {count} (preprocess --own-bodies "
            "keeps those of all performers)"
        )
    found.sort(key=lambda body: (leg_length(_body(dataset, body)), body))
    chosen = [found[round(i * (len(found) - 1) / (count - 1))] for i in range(count)]
    return {names[body]: body for body in chosen}


def _stretches(dataset: Dataset, body: int, kind: str) -> list[tuple[Clip, int, int]]:
    """Recorded stretches of a type by a body: clip, start, end; without very short ones."""
    return [
        (clip, start, end)
        for clip, start, end, _ in dataset.stretches(None, kind)
        if clip.body == body and not clip.mirrored and end - start >= SHORT
    ]


def _body(dataset: Dataset, body: int) -> Skeleton:
    return canonical_skeleton(dataset.bodies[body])


def show_bodies(
    model: MotionModel,
    dataset: Dataset,
    kind: str,
    seeds: int,
    progress: Callable[[float], None],
) -> list[dict[str, Any]]:
    """Roll out one recording with the bodies of several performers, and measure each.

    Returns:
        For each performer "recorded", the measures of MEASURES in cm of the body and its own recordings, and "made",
        the mean of each over seeds.

    Raises:
        DatasetError: if the dataset has other features than the model, or too few performers or frames.
        MotionkitError: if the network is not shown bodies.
    """
    if not model.shows_bodies:
        raise MotionkitError("the network is not shown bodies; train on a dataset made with --own-bodies")
    check_layout(dataset, model)
    chosen = performers(dataset, kind)
    sequence = initial_stretch(dataset, kind)
    if sequence.frames < FORGOTTEN + LEAST:
        raise DatasetError(f"{sequence.clip.name}: expected {INITIAL + FORGOTTEN + LEAST} frames of {kind}")
    controls, frames = sequence_controls(dataset, sequence, model), min(sequence.frames, MADE)
    out: list[dict[str, Any]] = []
    for name, body in chosen.items():
        made = []
        for seed in range(seeds):
            rolled = continued(model, sequence, _body(dataset, body), controls, frames, seed)
            made.append(measures(dataset, rolled[FORGOTTEN:]))
            progress((len(out) + len(made) / seeds) / len(chosen))
        mean = {key: rounded(float(np.mean([each[key] for each in made]))) for key in MEASURES}
        out.append({"performer": name, "recorded": recorded_measures(dataset, body, kind), "made": mean})
    return out


def measures(dataset: Dataset, features: Array) -> dict[str, float]:
    """Return what MEASURES names, in cm, from the joint positions in features (T, 276).

    hips is their height over the lower ankle, step the largest distance over the ground between the ankles in a
    second; both are means over the frames.
    """
    places = joint_positions(features, dataset.layout.version).astype(np.float64)
    joint = {name: places[:, number] for number, name in enumerate(JOINT_NAMES)}
    out = {
        limb: float(np.mean([_length([joint[name] for name in chain]) for chain in chains]))
        for limb, chains in LIMBS.items()
    }
    left, right = joint["LeftFoot"], joint["RightFoot"]
    out["hips"] = float((joint["Hips"][:, 1] - np.minimum(left[:, 1], right[:, 1])).mean())
    apart = np.linalg.norm((left - right)[:, [0, 2]], axis=-1)
    seconds = max(1, round(len(apart) / dataset.fps))
    out["step"] = float(np.mean([part.max() for part in np.array_split(apart, seconds)]))
    return {key: rounded(value) for key, value in out.items()}


def _length(chain: Sequence[Array]) -> float:
    """Mean length of a chain of joints, each (T, 3)."""
    bones = [np.linalg.norm(a - b, axis=-1) for a, b in pairwise(chain)]
    return float(np.sum(bones, axis=0).mean())


def recorded_measures(dataset: Dataset, body: int, kind: str) -> dict[str, float]:
    """Return the measures of a performer's recordings of a type, means over their frames."""
    found = [
        (end - start, measures(dataset, dataset.read(clip).features[start:end]))
        for clip, start, end in _stretches(dataset, body, kind)
    ]
    frames = sum(length for length, _ in found)
    return {key: rounded(sum(length * each[key] for length, each in found) / frames) for key in MEASURES}


def slopes(performers: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Return for each measure how far what is made follows the performer: 1 fully, 0 not at all (least squares)."""
    out = {}
    for key in MEASURES:
        real, made = (np.array([each[side][key] for each in performers]) for side in ("recorded", "made"))
        spread = real - real.mean()
        out[key] = float(spread @ (made - made.mean()) / max(float(spread @ spread), 1e-9))
    return out


def bodies_row(each: dict[str, Any]) -> tuple[str, ...]:
    """Return the cells of a performer in a table, under BODIES_HEADER."""
    cells = [f"{each[side][key]:.1f}" for key in MEASURES for side in ("recorded", "made")]
    return (each["performer"], *cells)
