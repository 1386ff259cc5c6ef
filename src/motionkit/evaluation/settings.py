"""How much is measured."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from motionkit.synthesis.rollout import Noise


@dataclass(frozen=True)
class EvaluationSettings:
    """How much is measured; the defaults are what the model card quotes.

    Attributes:
        seeds: roll-outs of each type.
        seconds: that each of them lasts from the command on.
        seed: of all random numbers; the same seed, model and dataset give the same scoreboard.
        noise: how frames are drawn.
    """

    seeds: int = 20
    seconds: float = 8.0
    seed: int = 0
    noise: Noise = field(default_factory=Noise)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for reports."""
        noise = f"{self.noise.kind}, temperature {self.noise.temperature:g}"
        return {"seeds": self.seeds, "seconds": self.seconds, "seed": self.seed, "noise": noise}


QUICK = EvaluationSettings(seeds=3, seconds=5.0)
