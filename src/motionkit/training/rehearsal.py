"""Keeps a model's types while it learns new ones, by training on its own roll-outs.

A model file does not hold the clips it was trained on, so roll-outs stand in for them (Robins 1995, "Catastrophic
forgetting, rehearsal and pseudorehearsal").
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motionkit.arrays import Array
from motionkit.control.opening import Shown, last_poses
from motionkit.control.plan import plan_types
from motionkit.control.planned_controls import CrowdController
from motionkit.control.script import TypePart
from motionkit.data.dataset import ClipData, Dataset
from motionkit.features.control import Controls
from motionkit.inference.noise import Noise
from motionkit.inference.rollout import RolloutState, run, start_batch
from motionkit.models.model import MotionModel

ROLLOUTS, SECONDS = 4, 15.0  # number and length of roll-outs of each type; performances repeat
IN_CONTACT = 0.5  # predicted probability above which a contact is labelled


def keep_types(dataset: Dataset, model: MotionModel, seed: int = 0) -> tuple[str, ...]:
    """Add the types of a model that a dataset lacks, with roll-outs of the model as their training clips.

    Returns:
        The names of the types added.
    """
    kept = tuple(name for name, kind in model.types.items() if name not in dataset.types and kind.start_poses)
    if kept:
        names = kept * ROLLOUTS
        clips = roll_out(model, names, SECONDS, seed)
        ids = {name: len(dataset.types) + i for i, name in enumerate(kept)}
        for name, clip in zip(names, clips, strict=True):
            clip.types[:] = ids[name]
        dataset.append(kept, clips, {name: model.phase_seconds(name) for name in kept})
    return kept


def roll_out(model: MotionModel, names: tuple[str, ...], seconds: float, seed: int = 0) -> list[ClipData]:
    """Roll out one character for each type name; returns clips with type id 0 and without reference poses."""
    frames = round(seconds * model.fps)
    state = RolloutState(model, len(names), Noise(), seed)
    weights = np.eye(len(model.types), dtype=np.float32)[[model.type_id(name) for name in names]]
    poses = [model.types[name].start_poses for name in names]
    features, contacts = start_batch([known[i % len(known)] for i, known in enumerate(poses)])
    state.start(features, contacts, weights)
    behind = features.shape[1]
    plans = [
        plan_types(model, [TypePart(name, seconds)], Shown(last_poses(model, seen), behind))
        for name, seen in zip(names, features, strict=True)
    ]
    controller = CrowdController(model, plans, seed)
    phases: list[Array] = []

    def controls(frame: int, ground: Array) -> Controls:
        asked = controller(frame, ground)
        phases.append(asked.phase)
        return asked

    made = run(state, frames, controls)
    phase = np.stack(phases, 1).astype(np.float32)
    touching = (made.contacts > IN_CONTACT).astype(np.float32)
    types = np.zeros(frames, np.int64)
    plain = [
        ClipData.plain(*each, types.copy()) for each in zip(made.features, touching, made.ground, strict=True)
    ]
    return [replace(clip, phases=phase[i]) for i, clip in enumerate(plain)]
