"""The noise in drawn frames: white, or correlated in time by two filters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Floats
from motionkit.errors import ControlError
from motionkit.features.layout import FEATURE_COUNT
from motionkit.models.model import MotionModel
from motionkit.seeds import check_seed

NOISE_KINDS = ("mean", "sample", "correlated")
MOST_TEMPERATURE = 2.0


@dataclass(frozen=True)
class Noise:
    """How frames are drawn from the predicted Gaussians.

    kind "mean" takes the mean. "sample" draws each frame independently (the paper's default). "correlated" draws noise
    of the same variance that is correlated over time: white noise through two first-order filters with coefficients
    rho and smoothing. After one filter alone the steps between frames would still be white, and the body would shake.
    """

    kind: str = "correlated"
    temperature: float = 0.05
    rho: float = 0.95
    smoothing: float = 0.8

    def __post_init__(self) -> None:
        if self.kind not in NOISE_KINDS:
            raise ControlError(f"noise {self.kind!r} is unknown, expected one of {', '.join(NOISE_KINDS)}")
        if not 0.0 <= self.temperature <= MOST_TEMPERATURE:
            raise ControlError(
                f"expected a temperature from 0 to {MOST_TEMPERATURE:g}, found {self.temperature:g}"
            )

    @property
    def filters(self) -> tuple[float, float, float, float]:
        """For both filters, the share of the last output that is kept and the share of the input that is added."""
        if self.kind != "correlated":
            return 0.0, 1.0, 0.0, 1.0
        a, b = self.rho, self.smoothing
        # The output has the variance of the input.
        variance = (1.0 - b) / (1.0 + b) * (1.0 + a * b) / (1.0 - a * b)
        return a, (1.0 - a * a) ** 0.5, b, (1.0 - b) / variance**0.5


def default_noise(model: MotionModel) -> Noise:
    """The default noise of a model; plain models sample at full sigma, as in the paper."""
    return Noise("sample", 1.0) if model.plain else Noise()


class NoiseState:
    """White noise of B characters and the states of its two filters.

    Attributes:
        random: one generator per character, so that its motion does not depend on the others.
        fresh: (B, 276) standard normal numbers of the next frame.
        first, second: (B, 276) outputs of the filters at the last frame.
    """

    def __init__(self, batch: int, seed: int | Sequence[int]) -> None:
        """Seed the characters: with seed, seed + 1 and so on, or with one seed for each. Raises ControlError."""
        for each in seed if isinstance(seed, Sequence) else (seed,):
            check_seed(each)
        seeds = seed if isinstance(seed, Sequence) else range(seed, seed + batch)
        self.random = [np.random.default_rng(each) for _, each in zip(range(batch), seeds, strict=True)]
        self.fresh, self.first, self.second = (np.zeros((batch, FEATURE_COUNT), np.float32) for _ in range(3))

    def start(self) -> None:
        """Set the filters to a state as after a long run."""
        self._draw(self.first)
        self.second[:] = self.first

    def renew(self) -> None:
        """Draw fresh numbers for the next frame."""
        self._draw(self.fresh)

    def adopt(self, index: int, other: NoiseState) -> None:
        """Replace the filter state of one character by that of the only character of another NoiseState."""
        self.first[index], self.second[index] = other.first[0], other.second[0]

    def _draw(self, out: Floats) -> None:
        for generator, row in zip(self.random, out, strict=True):
            generator.standard_normal(dtype=np.float32, out=row)
