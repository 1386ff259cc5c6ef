"""The types of a model that trials are made of, found from their motion, whatever they are called."""

from __future__ import annotations

import math
from dataclasses import dataclass

from motionkit.control.steering import Gaits, usual_gaits
from motionkit.lab.scoreboard.trial import Trial
from motionkit.metrics.detectors import HANDS_DOWN, UPRIGHT_HIPS, Turn, turns
from motionkit.models.motion_type import GAIT_SPEED, GAIT_STEADINESS
from motionkit.training.bundle import ground_movement
from motionkit.training.verdict.real import RealMotion


@dataclass(frozen=True)
class Roles:
    """The types of a model by what they are; empty where it has none.

    Attributes:
        gaits: the usual ways to stand and go.
        performances: those performed once from beginning to end, the one with most recordings first.
        hops: jumps that keep going one way.
        strikes: those made of strikes, and of jumps on the spot.
        lasting: all others but gaits, such as dances.
    """

    gaits: Gaits
    performances: tuple[str, ...]
    hops: tuple[str, ...]
    strikes: tuple[str, ...]
    lasting: tuple[str, ...]


def find_roles(trial: Trial) -> Roles:
    """Sort the types of a trial's model that the dataset has training clips of."""
    model, events = trial.model, trial.dataset.phase_events
    clips = {kind: len({s.clip for s in trial.real.of_type(kind, "train")}) for kind in trial.recorded_types}
    known = [kind for kind in model.types if clips.get(kind)]
    movement = ground_movement(trial.dataset)
    once = sorted((kind for kind in known if events.get(kind) == ""), key=lambda kind: -clips[kind])
    hops = [kind for kind in known if events.get(kind) == "jump" and _keeps_going(*movement[kind])]
    return Roles(
        usual_gaits(model),
        tuple(once),
        tuple(hops),
        tuple(kind for kind in known if events.get(kind) and kind not in hops),
        tuple(kind for kind in known if kind not in events and not model.kind(kind).steered),
    )


def _keeps_going(frames: float, distance: float, x: float, z: float) -> bool:
    """Whether a type goes one way at the speed of a gait or faster."""
    return distance > GAIT_SPEED * frames and math.hypot(x, z) > GAIT_STEADINESS * distance


def bears_on_hands(real: RealMotion, kind: str) -> bool:
    """Whether hands bear the body in most recordings of a type: head down, hips high, feet above them."""

    def bears(turn: Turn) -> bool:
        return turn.hands <= HANDS_DOWN and turn.hips > UPRIGHT_HIPS and turn.ankles > 0.0

    found = real.of_type(kind)
    return 2 * sum(any(map(bears, turns(stretch.body))) for stretch in found) > len(found)
