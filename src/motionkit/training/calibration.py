"""Sampling presets from roll-outs: what a type needs to move as recorded.

Reference gains: a network falls short of the movements it is shown, in some types more than in others, and more after a
short training than after a long one. A gain makes up for it; more of it than needed makes the motion jerk and lifts the
feet.

Noise without references: a dance has neither a trajectory nor a phase to keep it moving. Drawn with too little noise it
comes to rest in its mean pose, with too much it shakes.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np

from motionkit.control.steering import NEUTRAL_SECONDS, commanded
from motionkit.control.synthesize import SynthesisOptions, synthesize
from motionkit.data.dataset import Dataset
from motionkit.data.phases import type_stretches
from motionkit.metrics.body_movement import angular_speed
from motionkit.metrics.smoothness import mean_jerk
from motionkit.metrics.touch import hover_share, planted_share
from motionkit.models.model import MotionModel
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import JOINT_COUNT

# That are tried. With less than its poses a type that a network shakes through shakes less and stands more firmly.
GAINS = (0.4, 0.5, 0.7, 1.0, 1.5, 2.0, 2.25, 2.5)
# Factors on the sampling temperature that are tried without references. What noise moves grows much faster than it.
NOISES = (0.2, 0.5, 0.7, 0.85, 1.0, 1.1, 1.2, 1.3, 1.4, 1.5)
SEED, REPEATS = 500, 8  # of the validation split
TOGETHER = 128  # roll-outs that are made at once
# Seconds in which a roll-out, which stands or walks first, is on its way to its type: one that is begun from its own
# poses moves more than one that is changed to.
CHANGE = 1.0
LEAST_FRAMES = 8  # of a recorded stretch that counts
JERK = 1.2  # times the recorded jerk costs nothing: a network shakes a little at any gain
JERK_WEIGHT = 0.25
MOST_JERK = 1.4  # times the recorded; more counts in full besides, for the scoreboard allows 1.5 in a minute
JERK_OF_NOISE = 1.0  # its weight where noise makes it
SELDOM = 0.05  # share of time that hardly counts beside more
# Share of time beyond the recorded in which hovering costs nothing, as in the scoreboard's target.
HOVERING = 0.02
NEARLY = 0.03  # a gain nearer to 1 is taken where it costs at most so much more than the best


@dataclass(frozen=True)
class Manner:
    """How a motion moves: joints in rad/s, their jerk in m/s^3, and the shares of time that it stands and hovers.

    planted: a toe is; hovering: nothing touches the ground, and the body does not fall freely.
    """

    speed: float
    jerk: float
    planted: float
    hovering: float

    def cost(self, recorded: Manner, jerk_weight: float = JERK_WEIGHT) -> float:
        """How far it is from a recorded one: in speed, planted time, more hovering than HOVERING, more jerk than JERK.

        All count by the logarithms of their ratios. Jerk counts little by default, since recordings that have been
        smoothed have hardly any.
        """
        faster, shakier = (
            math.log(max(made, 1e-3) / max(real, 1e-3))
            for made, real in ((self.speed, recorded.speed), (self.jerk, recorded.jerk))
        )
        longer, higher = (
            math.log((made + SELDOM) / (real + SELDOM))
            for made, real in (
                (self.planted, recorded.planted),
                (self.hovering, recorded.hovering + HOVERING),
            )
        )
        shaking = jerk_weight * max(0.0, shakier - math.log(JERK)) + max(0.0, shakier - math.log(MOST_JERK))
        return abs(faster) + abs(longer) + max(0.0, higher) + shaking


def calibrated_gains(
    model: MotionModel, dataset: Dataset, frames: int, repeats: int = REPEATS, gains: Sequence[float] = GAINS
) -> dict[str, float]:
    """Return the reference gain of each type that reference poses move, by the manner of default roll-outs.

    Of the gains with which they move nearly as much like training recordings as with any it is the one nearest to 1.

    Args:
        dataset: has the recordings; types without any are left out.
        frames: length of each roll-out.
        repeats: roll-outs of each type, with successive seeds.
    """
    if not model.uses_references:
        return {}
    moved = [kind for kind, known in model.types.items() if kind in dataset.types and known.reference_clips]
    real = recorded_manners(dataset, moved)
    tried = [with_presets(model, "reference_gain", dict.fromkeys(real, gain)) for gain in gains]
    costs = _costs(tried, real, frames, repeats, JERK_WEIGHT)
    return {kind: _cheapest(gains, found) for kind, found in costs.items()}


def calibrated_noise(
    model: MotionModel,
    dataset: Dataset,
    frames: int,
    repeats: int = REPEATS,
    noises: Sequence[float] = NOISES,
) -> dict[str, float]:
    """Return the noise of each type that moves by it alone without references, by the manner of such roll-outs.

    Arguments as for calibrated_gains.
    """
    if not model.uses_references:
        return {}
    alone = model.with_reference("none")
    moved = [kind for kind, known in alone.types.items() if kind in dataset.types and known.moves_by_noise]
    real = recorded_manners(dataset, moved)
    tried = [with_presets(alone, "noise_scale", dict.fromkeys(real, noise)) for noise in noises]
    costs = _costs(tried, real, frames, repeats, JERK_OF_NOISE)
    return {kind: noises[int(np.argmin(found))] for kind, found in costs.items()}


def _costs(
    tried: Sequence[MotionModel], real: Mapping[str, Manner], frames: int, repeats: int, jerk_weight: float
) -> dict[str, list[float]]:
    """What roll-outs of each recorded type cost with each of the models that are tried."""
    made = [made_manners(model, list(real), frames, repeats) for model in tried]
    return {kind: [each[kind].cost(real[kind], jerk_weight) for each in made] for kind in real}


def with_presets(model: MotionModel, field: str, values: Mapping[str, float]) -> MotionModel:
    """Return the model with another value of a field of the sampling presets of some types."""
    presets = {kind: replace(model.types[kind].preset, **{field: value}) for kind, value in values.items()}
    return model.with_types({kind: {"preset": preset} for kind, preset in presets.items()})


def recorded_manners(dataset: Dataset, kinds: Collection[str]) -> dict[str, Manner]:
    """How the training recordings of each type move that has any of at least LEAST_FRAMES."""
    found: dict[str, list[tuple[Manner, int]]] = {kind: [] for kind in kinds}
    for clip in dataset.select("train"):
        stretches = [
            (start, end, dataset.types[kind])
            for start, end, kind in type_stretches(dataset.clip_types(clip))
            if dataset.types[kind] in found and end - start >= LEAST_FRAMES
        ]
        if not stretches:
            continue
        motion = dataset.motion(clip, dataset.read(clip))
        for start, end, kind in stretches:
            found[kind].append((manner_of(motion.cut(start, end)), end - start))
    return {kind: _mean(each) for kind, each in found.items() if each}


def made_manners(model: MotionModel, kinds: Sequence[str], frames: int, repeats: int) -> dict[str, Manner]:
    """How roll-outs of each type move for so many frames, made as `synthesize` does by default."""
    found: dict[str, list[tuple[Manner, int]]] = {kind: [] for kind in kinds}
    seconds = CHANGE + max(frames, LEAST_FRAMES) / model.fps
    begun = round((NEUTRAL_SECONDS + CHANGE) * model.fps)
    # Of one type with successive seeds, which draw its recordings evenly.
    each = [kind for kind in found for _ in range(repeats)]
    for first in range(0, len(each), TOGETHER):
        some = each[first : first + TOGETHER]
        seed = SEED + first
        plans = [commanded(model, kind, seconds, seed + i) for i, kind in enumerate(some)]
        made = synthesize(model, plans, SynthesisOptions(len(plans), seed)).motions
        for kind, one in zip(some, made, strict=True):
            motion = one.motion.cut(begun, len(one.motion))
            found[kind].append((manner_of(motion), len(motion)))
    return {kind: _mean(each) for kind, each in found.items()}


def manner_of(motion: Motion) -> Manner:
    """How a motion of at least LEAST_FRAMES moves."""
    positions = motion_kinematics(motion)[1]
    return Manner(
        angular_speed(motion.local_rotations, range(1, JOINT_COUNT), motion.fps),
        mean_jerk(positions, motion.fps, motion.fps).value or 0.0,
        planted_share(positions).value or 0.0,
        hover_share(positions).value or 0.0,
    )


def _mean(found: Sequence[tuple[Manner, int]]) -> Manner:
    """The mean of manners, by the number of frames of each."""
    values = np.array([astuple(manner) for manner, _ in found])
    return Manner(*np.average(values, axis=0, weights=[frames for _, frames in found]).tolist())


def _cheapest(gains: Sequence[float], costs: Sequence[float]) -> float:
    """Of the gains that cost nearly the least the one nearest to 1, which shows the poses as they are."""
    good = [gain for gain, cost in zip(gains, costs, strict=True) if cost <= min(costs) + NEARLY]
    return min(good, key=lambda gain: abs(math.log(gain)))
