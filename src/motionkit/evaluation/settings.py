"""How many roll-outs an evaluation makes, and how long they are."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from motionkit.inference.rollout import Noise


@dataclass(frozen=True)
class EvaluationSettings:
    """How many roll-outs an evaluation makes, and how long they are. The model card quotes the defaults.

    Attributes:
        seeds: roll-outs per type for action accuracy.
        accuracy_seconds: length of each of these roll-outs, counted from the command.
        repeats: roll-outs per path, response, transition and held-out clip.
        stability_seconds: length of the roll-out of each type.
        mixed_seconds: length of the roll-out with random changes of type.
        reconstruction_seconds: longest stretch of a held-out clip to compare.
        seed: random seed. The same seed, model and dataset give the same scoreboard.
        noise: how frames are sampled.
    """

    seeds: int = 20
    accuracy_seconds: float = 8.0
    repeats: int = 3
    stability_seconds: float = 60.0
    mixed_seconds: float = 300.0
    reconstruction_seconds: float = 10.0
    seed: int = 0
    noise: Noise = field(default_factory=Noise)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for reports."""
        noise = f"{self.noise.kind}, temperature {self.noise.temperature:g}"
        return {**asdict(self), "noise": noise}


QUICK = EvaluationSettings(
    seeds=3,
    accuracy_seconds=5.0,
    repeats=1,
    stability_seconds=10.0,
    mixed_seconds=20.0,
    reconstruction_seconds=3.0,
)
