"""How much is measured."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from motionkit.inference.rollout import Noise


@dataclass(frozen=True)
class EvaluationSettings:
    """How much is measured; the defaults are what the model card quotes.

    Attributes:
        seeds: roll-outs of each type (accuracy).
        seconds: that each of them lasts from the command on.
        few: roll-outs of each path, response, transition and held-out clip.
        stability: seconds of one type, mixed: seconds of random changes of type.
        reconstruction: seconds of a held-out clip that are compared at most.
        seed: of all random numbers; the same seed, model and dataset give the same scoreboard.
        noise: how frames are drawn.
    """

    seeds: int = 20
    seconds: float = 8.0
    few: int = 3
    stability: float = 60.0
    mixed: float = 300.0
    reconstruction: float = 10.0
    seed: int = 0
    noise: Noise = field(default_factory=Noise)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for reports."""
        noise = f"{self.noise.kind}, temperature {self.noise.temperature:g}"
        return {**asdict(self), "noise": noise}


QUICK = EvaluationSettings(seeds=3, seconds=5.0, few=1, stability=10.0, mixed=20.0, reconstruction=3.0)
