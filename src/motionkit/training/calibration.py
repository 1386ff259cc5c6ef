"""Calibrates sampling presets on roll-outs, so that each type moves as recorded.

Reference gain: a network makes smaller movements than its reference poses show, by an amount that depends on the type
and on the length of training. A gain makes up for it. Too large a gain makes the motion jerk and lifts the feet. With
one that does not suit, a type may not be shown at all: a handspring stays a jump.

Noise without references: a dance has neither a trajectory nor a phase to keep it moving. With too little noise it comes
to rest in its mean pose, with too much it shakes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np

from motionkit.control.steering import NEUTRAL_SECONDS, commanded
from motionkit.control.synthesize import SynthesisOptions, synthesize
from motionkit.data.dataset import Dataset
from motionkit.metrics.body import Body, body_of
from motionkit.metrics.smoothness import mean_jerk
from motionkit.metrics.touch import hover_share, planted_share
from motionkit.models.model import MotionModel
from motionkit.training.verdict.judge import Judge
from motionkit.training.verdict.real import RealMotion

# Reference gains to try. Some types shake less and stand more firmly with gains below 1.
GAINS = (0.4, 0.5, 0.7, 1.0, 1.5, 2.0, 2.25, 2.5)
# Noise scales to try without references. Movement grows much faster than the noise.
NOISES = (0.2, 0.5, 0.7, 0.85, 1.0, 1.1, 1.2, 1.3, 1.4, 1.5)
SEED, REPEATS = 500, 8  # first seed of the roll-outs, and their number per type
TOGETHER = 128  # roll-outs that run at once
# Seconds that a roll-out takes from standing or walking to its type, which are not measured. Roll-outs start like this
# because a roll-out from the type's own start pose moves more.
CHANGE = 1.0
LEAST_FRAMES = 8  # shortest roll-out that can be measured
# Longer roll-outs of types that no value shows every time. A balance of 5 s is shown as seldom with any gain.
LONGER = 2
JERK = 1.2  # jerk over recorded jerk that costs nothing: networks shake a little at any gain
JERK_WEIGHT = 0.25  # weight of jerk above JERK
# Jerk over recorded jerk above which jerk costs extra, with weight 1. The scoreboard allows 1.5 in a minute.
MOST_JERK = 1.4
SHOWN_WEIGHT = 3.0  # weight of showing the type: a motion that is another one is the worst fault
JERK_OF_NOISE = 1.0  # JERK_WEIGHT for the calibration of noise
SELDOM = 0.05  # added to shares before their ratio, so that small shares matter little
# Share of time that a motion may hover beyond the recorded share without cost, as in the scoreboard's target.
HOVERING = 0.02
NEARLY = 0.03  # of gains whose cost is at most this much above the lowest, the one nearest to 1 wins


@dataclass(frozen=True)
class Movement:
    """Measures of how a motion moves.

    Attributes:
        speed: mean angular speed of the joints in rad/s.
        planted: share of time in which a toe is planted.
        hovering: share of time in which nothing touches the ground and the body does not fall freely.
        shown: share of roll-outs that show their type; 1 where that cannot be judged.
    """

    speed: float
    jerk: float
    planted: float
    hovering: float
    shown: float = 1.0

    def cost(self, recorded: Movement, jerk_weight: float = JERK_WEIGHT) -> float:
        """Distance from the measures of a recorded motion, as a sum of logarithms of ratios.

        Speed and planted time count in both directions, hovering and jerk only where there is more, and showing the
        type only where it is seldom. Jerk has a small weight by default, because smoothed recordings have hardly any.
        """
        faster, shakier = (
            math.log(max(made, 1e-3) / max(real, 1e-3))
            for made, real in ((self.speed, recorded.speed), (self.jerk, recorded.jerk))
        )
        longer, higher, rarer = (
            math.log((made + SELDOM) / (real + SELDOM))
            for made, real in (
                (self.planted, recorded.planted),
                (self.hovering, recorded.hovering + HOVERING),
                (recorded.shown, self.shown),
            )
        )
        shaking = jerk_weight * max(0.0, shakier - math.log(JERK)) + max(0.0, shakier - math.log(MOST_JERK))
        return abs(faster) + abs(longer) + max(0.0, higher) + SHOWN_WEIGHT * max(0.0, rarer) + shaking


def training_judge(dataset: Dataset) -> Judge:
    """What calibration compares roll-outs with: the training recordings of a dataset."""
    return Judge(RealMotion(dataset, "train"))


def calibrated_gains(
    model: MotionModel, judge: Judge, frames: int, progress: Callable[[float], None] | None = None
) -> dict[str, float]:
    """Return the reference gain with which each type with reference clips moves most like its recordings.

    Among gains of nearly the lowest cost, the one nearest to 1 is taken. Types without recordings are left out.

    Args:
        judge: what knows the recordings, from training_judge.
        frames: length of each roll-out.
        progress: called with the finished share, 0 to 1.
    """
    if not model.uses_references:
        return {}
    moved = [
        kind for kind, known in model.types.items() if kind in judge.real.types and known.reference_clips
    ]
    tried = ("reference_gain", GAINS, JERK_WEIGHT)
    costs = _costs(model, moved, judge, tried, frames, progress)
    return {kind: _cheapest(GAINS, found) for kind, found in costs.items()}


def calibrated_noise(
    model: MotionModel, judge: Judge, frames: int, progress: Callable[[float], None] | None = None
) -> dict[str, float]:
    """Return the noise scale with which each type moves most like its recordings without references.

    Only types that need noise to move are calibrated. Arguments as for calibrated_gains.
    """
    if not model.uses_references:
        return {}
    alone = model.with_reference("none")
    moved = [kind for kind, known in alone.types.items() if kind in judge.real.types and known.moves_by_noise]
    tried = ("noise_scale", NOISES, JERK_OF_NOISE)
    costs = _costs(alone, moved, judge, tried, frames, progress)
    return {kind: NOISES[int(np.argmin(found))] for kind, found in costs.items()}


def _costs(
    model: MotionModel,
    kinds: Sequence[str],
    judge: Judge,
    tried: tuple[str, Sequence[float], float],
    frames: int,
    progress: Callable[[float], None] | None,
) -> dict[str, list[float]]:
    """For each recorded type, the costs of its roll-outs with a field of the presets, its values, by a jerk weight.

    Types that no value shows every time are measured again in longer roll-outs.
    """
    field, values, jerk_weight = tried
    real = recorded_movements(judge.real, kinds)
    models = [with_presets(model, field, dict.fromkeys(real, value)) for value in values]
    made = _measured(models, list(real), frames, judge, progress)
    seldom = [kind for kind in real if all(found[kind].shown < 1.0 for found in made)]
    if seldom:
        longer = _measured(models, seldom, LONGER * frames, judge, progress)
        made = [short | long for short, long in zip(made, longer, strict=True)]
    return {kind: [each[kind].cost(real[kind], jerk_weight) for each in made] for kind in real}


def _measured(
    models: Sequence[MotionModel],
    kinds: Sequence[str],
    frames: int,
    judge: Judge,
    progress: Callable[[float], None] | None,
) -> list[dict[str, Movement]]:
    """The movements of each model by type."""
    made = []
    for model in models:
        made.append(made_movements(model, kinds, frames, judge))
        if progress:
            progress(len(made) / len(models))
    return made


def with_presets(model: MotionModel, field: str, values: Mapping[str, float]) -> MotionModel:
    """Return the model with other values for one field of the sampling presets, by type."""
    presets = {kind: replace(model.types[kind].preset, **{field: value}) for kind, value in values.items()}
    return model.with_types({kind: {"preset": preset} for kind, preset in presets.items()})


def recorded_movements(real: RealMotion, kinds: Iterable[str]) -> dict[str, Movement]:
    """Mean measures of each type's training recordings; types without any are left out."""
    bodies = {kind: [stretch.body for stretch in real.of_type(kind, "train")] for kind in kinds}
    return {kind: _mean([(movement_of(b), len(b)) for b in each]) for kind, each in bodies.items() if each}


def made_movements(
    model: MotionModel, kinds: Sequence[str], frames: int, judge: Judge
) -> dict[str, Movement]:
    """Mean measures of roll-outs of each type over `frames` frames, made as `synthesize` does by default."""
    found: dict[str, list[tuple[Movement, int]]] = {kind: [] for kind in kinds}
    seconds = CHANGE + max(frames, LEAST_FRAMES) / model.fps
    command, start = round(NEUTRAL_SECONDS * model.fps), round((NEUTRAL_SECONDS + CHANGE) * model.fps)
    # Roll-outs of one type have successive seeds, which draw its recordings evenly.
    each = [kind for kind in found for _ in range(REPEATS)]
    for first in range(0, len(each), TOGETHER):
        some = each[first : first + TOGETHER]
        seed = SEED + first
        plans = [commanded(model, kind, seconds, seed + i) for i, kind in enumerate(some)]
        made = synthesize(model, plans, SynthesisOptions(len(plans), seed)).motions
        for kind, one in zip(some, made, strict=True):
            body = body_of(one.motion)
            whole, measured = body.cut(command, len(body)), body.cut(start, len(body))
            shown = float(judge.performs(kind, whole)) if judge.knows(kind) else 1.0
            found[kind].append((replace(movement_of(measured), shown=shown), len(measured)))
    return {kind: _mean(each) for kind, each in found.items()}


def movement_of(body: Body) -> Movement:
    """The measures of a motion of at least LEAST_FRAMES, but for whether it shows its type."""
    positions, fps = body.positions, body.fps
    return Movement(
        body.joint_speed(),
        mean_jerk(positions, fps, fps).value or 0.0,
        planted_share(positions).value or 0.0,
        hover_share(positions).value or 0.0,
    )


def _mean(found: Sequence[tuple[Movement, int]]) -> Movement:
    """The mean of measures, weighted by their numbers of frames."""
    values = np.array([astuple(movement) for movement, _ in found])
    return Movement(*np.average(values, axis=0, weights=[frames for _, frames in found]).tolist())


def _cheapest(gains: Sequence[float], costs: Sequence[float]) -> float:
    """The gain nearest to 1 whose cost is at most NEARLY above the lowest; 1 leaves reference poses unchanged."""
    good = [gain for gain, cost in zip(gains, costs, strict=True) if cost <= min(costs) + NEARLY]
    return min(good, key=lambda gain: abs(math.log(gain)))
