"""The shipped model on the test sequences, as shipped: a second table beside the protocol's.

Reference poses, sampling presets, corrections and foot locks are on; the motion is made on the default body and put on
the performer's, as `synthesize --character` does.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from motionkit.arrays import Array
from motionkit.control.synthesize import on_character
from motionkit.data.dataset import Dataset
from motionkit.features.decode import decode_motion
from motionkit.features.encode import encode_motion
from motionkit.files import atomic_write
from motionkit.lab.paper.model_results import SHIPPED_GROUP, made_from
from motionkit.lab.paper.protocol import Continue, TestSequence, measure, sequences_of
from motionkit.lab.paper.variants import variant
from motionkit.lab.scoreboard.reconstruction import HeldOut, as_motion, roll_like
from motionkit.lab.scoreboard.settings import EvaluationSettings
from motionkit.models.model import MotionModel
from motionkit.models.presets import preset
from motionkit.motion.motion import Motion

GROUP = SHIPPED_GROUP
FIRST_SEED = 1000  # of test seeds (lab/scoreboard/settings.py)


def recorded_motion(dataset: Dataset, sequence: TestSequence) -> Motion:
    """Return a whole test sequence, its initial frames included, on the performer's body."""
    data, layout = sequence.data, dataset.layout.version
    body = dataset.skeleton(sequence.clip)
    return decode_motion(
        data.features, body, dataset.fps, data.ground[0], dataset.reference_rotations, layout
    )


def shipped_continues(model: MotionModel, dataset: Dataset, seed: int) -> Continue:
    """Return what the shipped model makes of a test sequence, as features of the dataset's layout."""

    def continues(sequence: TestSequence, number: int) -> tuple[Array, float]:
        body, first = dataset.skeleton(sequence.clip), sequence.initial
        recorded = recorded_motion(dataset, sequence)
        standard = on_character(recorded, model.character("default"))
        encoded = encode_motion(standard, model.reference_rotations, model.config.layout)
        data = replace(
            sequence.data, features=encoded.features, contacts=encoded.contacts, ground=encoded.ground
        )
        held = HeldOut(sequence.kind, data, standard, sequence.frames, first)
        settings = EvaluationSettings(seed=FIRST_SEED + 100 * seed + number)
        began = time.perf_counter()
        (take,) = roll_like(model, dataset, [held], settings, lambda share: None)
        seconds = time.perf_counter() - began
        made = on_character(as_motion(model, take.default), body)
        return features_after(dataset, recorded.cut(first - 1, first), made), seconds

    return continues


def features_after(dataset: Dataset, before: Motion, motion: Motion) -> Array:
    """Return the features of a motion in the dataset's layout; velocities begin with the step from the frame before."""
    joined = replace(
        motion,
        local_rotations=np.concatenate([before.local_rotations, motion.local_rotations]),
        root_positions=np.concatenate([before.root_positions, motion.root_positions]),
    )
    return encode_motion(joined, dataset.reference_rotations, dataset.layout.version).features[1:]


def held_out(dataset: Dataset, longest: int) -> list[TestSequence]:
    """Return the test sequences that are no mirror images of training clips: those the shipped model has not seen."""
    return [each for each in sequences_of(dataset, longest) if not each.clip.mirrored]


def run_shipped(
    models: dict[str, MotionModel],
    dataset: Dataset,
    selection: str,
    seeds: int,
    longest: int,
    results: Path,
    progress: Callable[[float], None],
) -> list[Path]:
    """Measure models by name, and write a result for each seed, beside those of the protocol.

    Raises:
        DatasetError: the dataset is not one that the protocol's networks are trained on.
    """
    dataset.check_layout(preset(variant("TPTN").preset).layout, "the networks to compare with need")
    sequences = held_out(dataset, longest)
    folder, out = results / selection / GROUP, []
    for name, model in models.items():
        for seed in range(seeds):
            measured, _ = measure(
                dataset, shipped_continues(model, dataset, seed), sequences, lambda share: None
            )
            result = {
                "name": name,
                "group": GROUP,
                "seed": seed,
                "data": selection,
                "longest": longest,
                "made": made_from(dataset),
            }
            file = folder / f"{name.replace(' ', '-')}-{seed}.json"
            with atomic_write(file, "w") as stream:
                stream.write(json.dumps({**result, "parameters": 0, **measured}, indent=1) + "\n")
            out.append(file)
            progress(len(out) / (seeds * len(models)))
    return out
