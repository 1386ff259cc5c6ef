"""Keeps a model's types while it learns new ones, by training on its own roll-outs.

A model file does not hold the clips it was trained on, so roll-outs stand in for them (Robins 1995, "Catastrophic
forgetting, rehearsal and pseudorehearsal").
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motionkit.data.dataset import ClipData, Dataset
from motionkit.models.model import MotionModel
from motionkit.training.scores import roll_out

ROLLOUTS, SECONDS = 4, 15.0  # number and length of roll-outs of each type; performances repeat
IN_CONTACT = 0.5  # predicted probability above which a contact is labelled


def keep_types(dataset: Dataset, model: MotionModel, seed: int = 0) -> tuple[str, ...]:
    """Add the types of a model that a dataset lacks, and return their names; roll-outs of the model are their clips."""
    kept = tuple(name for name, kind in model.types.items() if name not in dataset.types and kind.start_poses)
    if kept:
        names = kept * ROLLOUTS
        clips = model_clips(model, names, SECONDS, seed)
        ids = {name: len(dataset.types) + i for i, name in enumerate(kept)}
        for name, clip in zip(names, clips, strict=True):
            clip.types[:] = ids[name]
        dataset.append(kept, clips, {name: model.phase_seconds(name) for name in kept})
    return kept


def model_clips(model: MotionModel, names: tuple[str, ...], seconds: float, seed: int) -> list[ClipData]:
    """Roll out one character for each type name; returns clips with type id 0 and without reference poses."""
    poses = [model.types[name].start_poses for name in names]
    # Roll-outs of a type take its start poses in turn.
    before = [names[:i].count(name) for i, name in enumerate(names)]
    starts = [known[i % len(known)] for i, known in zip(before, poses, strict=True)]
    made, phases = roll_out(model, names, starts, seconds, seed)
    touching = (made.contacts > IN_CONTACT).astype(np.float32)
    types = np.zeros(phases.shape[1], np.int64)
    plain = [
        ClipData.plain(*each, types.copy()) for each in zip(made.features, touching, made.ground, strict=True)
    ]
    return [replace(clip, phases=phase) for clip, phase in zip(plain, phases, strict=True)]
