"""Figures over seeds, frames and raters: means, spreads, and the t-test."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Figure:
    """The mean of a figure over seeds, its standard deviation, and how many seeds there are."""

    mean: float
    spread: float
    seeds: int


def figure(values: Sequence[float]) -> Figure | None:
    """Return mean and standard deviation of values; None of none."""
    if not values:
        return None
    mean = sum(values) / len(values)
    spread = math.sqrt(sum((v - mean) ** 2 for v in values) / (len(values) - 1)) if len(values) > 1 else 0.0
    return Figure(mean, spread, len(values))


def rounded(value: float, figures: int = 4) -> float:
    """Return a value with so many figures: more depend on the machine."""
    return float(f"{value:.{figures}g}")


def upper_tail(t: float, freedom: int) -> float:
    """Return the probability that Student's t with so many degrees of freedom exceeds t.

    With t = sqrt(freedom) tan(angle), the density is proportional to cos(angle) ** (freedom - 1).
    """
    nodes, weights = np.polynomial.legendre.leggauss(200)

    def area(start: float) -> float:
        """The area from an angle to a right one."""
        half = 0.5 * (0.5 * math.pi - start)
        angles = start + half * (nodes + 1.0)
        return float(half * (weights * np.cos(angles) ** (freedom - 1)).sum())

    return 0.5 * area(math.atan2(t, math.sqrt(freedom))) / area(0.0)


def weighted_mean(found: Sequence[tuple[float, float]]) -> float:
    """Return the mean of values, each with its weight, such as a number of frames."""
    return sum(value * weight for value, weight in found) / sum(weight for _, weight in found)
