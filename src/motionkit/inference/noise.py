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


@dataclass(frozen=True)
class Noise:
    """How frames are drawn from the predicted Gaussians.

    kind "mean" takes the mean, "sample" draws each frame independently (the paper's default), "correlated" draws
    noise of the same variance that is correlated in time: white noise through two first-order filters, with
    coefficients rho and smoothing. After one filter alone the steps would still be white, and the body would shake.
    """

    kind: str = "correlated"
    temperature: float = 0.05
    rho: float = 0.95
    smoothing: float = 0.8

    def __post_init__(self) -> None:
        if self.kind not in NOISE_KINDS:
            raise ControlError(f"noise {self.kind!r} is unknown, expected one of {', '.join(NOISE_KINDS)}")

    @property
    def filters(self) -> tuple[float, float, float, float]:
        """The shares that each filter keeps of its last output and takes of its input: rho, share, smoothing, share."""
        if self.kind != "correlated":
            return 0.0, 1.0, 0.0, 1.0
        a, b = self.rho, self.smoothing
        # What comes out has the variance of what goes in.
        variance = (1.0 - b) / (1.0 + b) * (1.0 + a * b) / (1.0 - a * b)
        return a, (1.0 - a * a) ** 0.5, b, (1.0 - b) / variance**0.5


def default_noise(model: MotionModel) -> Noise:
    """How frames of a model are drawn by default: of plain models at full sigma, as in the paper."""
    return Noise("sample", 1.0) if model.plain else Noise()


class NoiseState:
    """White noise of B characters, and the two filters it goes through.

    Attributes:
        random: a generator for each, so that a character's motion does not depend on those beside it.
        fresh: (B, 276) standard normal numbers of the coming frame.
        first, second: (B, 276) outputs of the filters at the last frame.
    """

    def __init__(self, batch: int, seed: int | Sequence[int]) -> None:
        """seed: of the first character, the others count on from it; or one for each. Raises ControlError."""
        for each in seed if isinstance(seed, Sequence) else (seed,):
            check_seed(each)
        seeds = seed if isinstance(seed, Sequence) else range(seed, seed + batch)
        self.random = [np.random.default_rng(each) for _, each in zip(range(batch), seeds, strict=True)]
        self.fresh, self.first, self.second = (np.zeros((batch, FEATURE_COUNT), np.float32) for _ in range(3))

    def start(self) -> None:
        """Begin in the middle of the noise: filters that have run for long."""
        self._draw(self.first)
        self.second[:] = self.first

    def renew(self) -> None:
        """Draw the fresh numbers of the coming frame."""
        self._draw(self.fresh)

    def adopt(self, index: int, other: NoiseState) -> None:
        """Go on, as one character, with the filters of the only one of another state."""
        self.first[index], self.second[index] = other.first[0], other.second[0]

    def _draw(self, out: Floats) -> None:
        for generator, row in zip(self.random, out, strict=True):
            generator.standard_normal(dtype=np.float32, out=row)
