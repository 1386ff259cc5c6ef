"""How many clips and seconds of training motion each type has."""

from __future__ import annotations

import numpy as np

from motionkit.data.dataset import Dataset
from motionkit.data.repeat import FEW_SECONDS, LEAST_FRAMES


def type_amounts(dataset: Dataset) -> dict[str, tuple[int, float]]:
    """Clips and seconds of training motion for each type, without mirrored copies."""
    recordings = {clip.start: clip for clip in reversed(dataset.select("train"))}
    none, size = np.zeros(0, np.int64), len(dataset.types)
    tracks = [none, *map(dataset.clip_types, recordings.values())]
    frames = np.stack([np.bincount(types, minlength=size) for types in tracks])
    clips, seconds = (frames > 0).sum(axis=0), frames.sum(axis=0) / dataset.fps
    return dict(zip(dataset.types, zip(clips.tolist(), seconds.tolist(), strict=True), strict=True))


def small_types(dataset: Dataset) -> list[str]:
    """A warning for each type with no training clip, one clip, or only a few seconds."""
    lines, least = [], LEAST_FRAMES / dataset.fps
    for kind, (clips, seconds) in type_amounts(dataset).items():
        if clips == 0:
            lines.append(f"{kind!r} has no training clip, only held-out ones; it cannot be learnt")
        elif seconds < least:
            lines.append(
                f"{kind!r} has {seconds:.1f} s of motion, expected at least {least:g} s to learn from"
            )
        elif seconds < FEW_SECONDS:
            lines.append(f"{kind!r} has {seconds:.1f} s of motion to learn from; give it more clips")
        elif clips == 1:
            lines.append(f"{kind!r} has one clip, which will be memorized; give it several")
    return lines
