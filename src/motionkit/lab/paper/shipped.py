"""The shipped model on the test sequences, as shipped: a second table beside the protocol's.

Reference poses, sampling presets, corrections and foot locks are on; the motion is made on the default body and put on
the performer's, as `synthesize --character` does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from motionkit.arrays import Array
from motionkit.control.synthesize import on_character
from motionkit.data.dataset import Dataset
from motionkit.features.encode import encode_motion
from motionkit.files import write_json
from motionkit.lab.held_out import Continue, HeldOut, held_out
from motionkit.lab.paper.model_results import SHIPPED_GROUP, made_from
from motionkit.lab.paper.protocol import measure
from motionkit.lab.paper.variants import variant
from motionkit.lab.scoreboard.reconstruction import as_motion, roll_like
from motionkit.lab.scoreboard.settings import EvaluationSettings
from motionkit.models.model import MotionModel
from motionkit.models.presets import preset
from motionkit.motion.motion import Motion

GROUP = SHIPPED_GROUP
FIRST_SEED = 1000  # of test seeds (lab/scoreboard/settings.py)


def shipped_continues(model: MotionModel, dataset: Dataset, seed: int) -> Continue:
    """Return what the shipped model makes of a test sequence, as features of the dataset's layout."""

    def continues(sequence: HeldOut, number: int) -> Array:
        body, first = dataset.skeleton(sequence.clip), sequence.initial
        recorded = dataset.motion(sequence.clip, sequence.data)
        standard = on_character(recorded, model.character("default"))
        encoded = encode_motion(standard, model.reference_rotations, model.config.layout)
        data = replace(
            sequence.data, features=encoded.features, contacts=encoded.contacts, ground=encoded.ground
        )
        settings = EvaluationSettings(seed=FIRST_SEED + 100 * seed + number)
        (take,) = roll_like(model, dataset, [replace(sequence, data=data)], settings, lambda share: None)
        made = on_character(as_motion(model, take.default), body)
        return features_after(dataset, recorded.cut(first - 1, first), made)

    return continues


def features_after(dataset: Dataset, before: Motion, motion: Motion) -> Array:
    """Return the features of a motion in the dataset's layout; velocities begin with the step from the frame before."""
    joined = replace(
        motion,
        local_rotations=np.concatenate([before.local_rotations, motion.local_rotations]),
        root_positions=np.concatenate([before.root_positions, motion.root_positions]),
    )
    return encode_motion(joined, dataset.reference_rotations, dataset.layout.version).features[1:]


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
    # Those that the shipped model has not seen: mirror images are of training clips.
    sequences = [each for each in held_out(dataset, longest) if not each.clip.mirrored]
    folder, out = results / selection / GROUP, []
    for name, model in models.items():
        for seed in range(seeds):
            measured = measure(
                dataset, shipped_continues(model, dataset, seed), sequences, lambda share: None
            )
            result = {"name": name, "group": GROUP, "seed": seed, "data": selection, "longest": longest}
            result |= {"made": made_from(dataset), "parameters": 0, **measured}
            file = folder / f"{name.replace(' ', '-')}-{seed}.json"
            write_json(file, result)
            out.append(file)
            progress(len(out) / (seeds * len(models)))
    return out
