"""Reference gains from roll-outs: how much of a reference pose a type needs to be shown to move as recorded.

A network falls short of the movements it is shown, in some types more than in others, and more after a short training
than after a long one. A gain makes up for it; more of it than needed makes the motion jerk.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from motionkit.arrays import Array
from motionkit.data.dataset import Dataset
from motionkit.data.phases import type_stretches
from motionkit.inference.rollout import rollout_motion
from motionkit.metrics.body_movement import angular_speed
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import JOINT_COUNT
from motionkit.training.scores import rollout_types

GAINS = (1.0, 1.5, 2.0)  # that are tried; between them the speed is taken to change evenly
SEEDS = (500, 501, 502)  # of the validation split
# Share of the recorded speed that is enough, or of what the largest gain brings where that is less: the last twentieth
# would cost a type more jerk than it is worth.
ENOUGH = 0.95


def calibrated_gains(
    model: MotionModel, dataset: Dataset, frames: int, seeds: Sequence[int] = SEEDS
) -> dict[str, float]:
    """Return the reference gain of each type that reference poses move, by the speed of its joints.

    The gain is the smallest of at least 1 with which roll-outs are ENOUGH times as fast as the training recordings.

    Args:
        dataset: has the recordings; types without any are left out.
        frames: length of each roll-out.
        seeds: of the roll-outs of each type.
    """
    if not model.uses_references:
        return {}
    moved = {kind for kind, known in model.types.items() if kind in dataset.types and known.reference_clips}
    real = recorded_speeds(dataset, moved)
    speeds = np.stack(
        [_speeds(with_gains(model, dict.fromkeys(real, gain)), frames, seeds) for gain in GAINS]
    )
    place = list(model.types).index
    return {kind: _gain(speeds[:, place(kind)] / max(speed, 1e-3)) for kind, speed in real.items()}


def with_gains(model: MotionModel, gains: Mapping[str, float]) -> MotionModel:
    """Return the model with other reference gains of some types."""
    presets = {kind: replace(model.types[kind].preset, reference_gain=gain) for kind, gain in gains.items()}
    return model.with_types({kind: {"preset": preset} for kind, preset in presets.items()})


def recorded_speeds(dataset: Dataset, kinds: Collection[str]) -> dict[str, float]:
    """Mean angular speed (rad/s) of the joints in the training recordings of each type that has any."""
    sums: dict[str, Array] = {kind: np.zeros(2) for kind in kinds}
    for clip in dataset.select("train"):
        stretches = [
            (start, end, dataset.types[kind])
            for start, end, kind in type_stretches(dataset.clip_types(clip))
            if dataset.types[kind] in sums and end - start > 1
        ]
        if not stretches:
            continue
        motion = dataset.motion(clip, dataset.read(clip))
        for start, end, kind in stretches:
            frames = end - start
            sums[kind] += frames * np.array([_speed(motion.cut(start, end)), 1.0])
    return {kind: float(total / frames) for kind, (total, frames) in sums.items() if frames}


def _speeds(model: MotionModel, frames: int, seeds: Sequence[int]) -> Array:
    """Mean angular speeds of the joints (types,) of roll-outs in rad/s."""
    skeleton = model.character("default")
    rolled = [rollout_types(model, frames, seed) for seed in seeds]
    return np.array(
        [
            [_speed(rollout_motion(model, each, i, skeleton)) for i in range(len(model.types))]
            for each in rolled
        ]
    ).mean(axis=0)


def _speed(motion: Motion) -> float:
    return angular_speed(motion.local_rotations, range(1, JOINT_COUNT), motion.fps)


def _gain(ratios: Array) -> float:
    """The smallest gain that reaches the recorded speed, from speeds over the recorded one (gains,)."""
    wanted = ENOUGH * min(1.0, float(ratios.max()))
    if ratios[0] >= wanted:
        return GAINS[0]
    reached = int((ratios >= wanted).argmax())
    return round(
        float(np.interp(wanted, ratios[reached - 1 : reached + 1], GAINS[reached - 1 : reached + 1])), 2
    )
