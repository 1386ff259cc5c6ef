"""How much there is to learn each type from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motionkit.data.dataset import Dataset
from motionkit.data.repeat import FEW_SECONDS, LEAST_FRAMES


@dataclass(frozen=True)
class TypeAmount:
    """Recordings of one type: clips and seconds for training, and clips held out. Mirrored copies do not count."""

    type: str
    clips: int
    seconds: float
    test_clips: int


def type_amounts(dataset: Dataset) -> list[TypeAmount]:
    """How much there is of each type of a dataset, in its order."""
    counts = {split: np.zeros((len(dataset.types), 2)) for split in ("train", "test")}
    seen = set()
    for clip in dataset.clips:
        if clip.split not in counts or (clip.split, clip.start) in seen:
            continue
        seen.add((clip.split, clip.start))
        kinds, frames = np.unique(dataset.clip_types(clip), return_counts=True)
        counts[clip.split][kinds] += np.stack([np.ones(len(kinds)), frames / dataset.fps], axis=1)
    return [
        TypeAmount(kind, int(counts["train"][i, 0]), float(counts["train"][i, 1]), int(counts["test"][i, 0]))
        for i, kind in enumerate(dataset.types)
    ]


def small_types(dataset: Dataset) -> list[str]:
    """A line for each type that is hard to learn: without training clips, with one clip, or with a few seconds."""
    lines = []
    for amount in type_amounts(dataset):
        if amount.clips == 0:
            lines.append(f"{amount.type!r} has no training clip, only held-out ones; it cannot be learnt")
        elif amount.seconds < LEAST_FRAMES / dataset.fps:
            lines.append(
                f"{amount.type!r} has {amount.seconds:.1f} s of motion, expected at least "
                f"{LEAST_FRAMES / dataset.fps:g} s to learn from"
            )
        elif amount.seconds < FEW_SECONDS:
            lines.append(
                f"{amount.type!r} has {amount.seconds:.1f} s of motion to learn from; give it more clips"
            )
        elif amount.clips == 1:
            lines.append(f"{amount.type!r} has one clip, which will be memorized; give it several")
    return lines
