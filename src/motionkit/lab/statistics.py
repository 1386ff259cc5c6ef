"""Statistics over seeds, frames and raters: means, standard deviations, and the t-test."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Figure:
    """Mean and standard deviation of a value over seeds, and the number of seeds."""

    mean: float
    spread: float
    seeds: int


def figure(values: Sequence[float]) -> Figure | None:
    """Return mean and standard deviation of values; None without values."""
    if not values:
        return None
    mean = sum(values) / len(values)
    spread = math.sqrt(sum((v - mean) ** 2 for v in values) / (len(values) - 1)) if len(values) > 1 else 0.0
    return Figure(mean, spread, len(values))


def rounded(value: float, figures: int = 4) -> float:
    """Return a value rounded to significant figures; further ones depend on the machine."""
    return float(f"{value:.{figures}g}")


def upper_tail(t: float, freedom: int) -> float:
    """Return the probability that Student's t with `freedom` degrees of freedom exceeds t.

    With t = sqrt(freedom) tan(angle), the density is proportional to cos(angle) ** (freedom - 1).
    """
    nodes, weights = np.polynomial.legendre.leggauss(200)

    def area(start: float) -> float:
        """The integral from `start` to pi / 2, by Gauss-Legendre quadrature."""
        half = 0.5 * (0.5 * math.pi - start)
        angles = start + half * (nodes + 1.0)
        return float(half * (weights * np.cos(angles) ** (freedom - 1)).sum())

    return 0.5 * area(math.atan2(t, math.sqrt(freedom))) / area(0.0)


def weighted_mean(found: Sequence[tuple[float, float]]) -> float:
    """Return the weighted mean of (value, weight) pairs."""
    return sum(value * weight for value, weight in found) / sum(weight for _, weight in found)


@dataclass(frozen=True)
class Paired:
    """Differences of pairs: their mean and number, t, and the two-sided p that their mean is zero."""

    mean: float
    t: float
    p: float
    count: int


def paired(differences: Sequence[float]) -> Paired:
    """Return the paired t-test of at least two differences. Equal ones have an infinite t, or 0 where all are zero."""
    found = figure(differences)
    assert found is not None and found.seeds > 1, "one difference has no spread"
    if found.spread == 0.0:
        same = found.mean == 0.0
        return Paired(
            found.mean, 0.0 if same else math.copysign(math.inf, found.mean), float(same), found.seeds
        )
    t = found.mean / (found.spread / math.sqrt(found.seeds))
    return Paired(found.mean, t, min(1.0, 2.0 * upper_tail(abs(t), found.seeds - 1)), found.seeds)


def least_t(level: float, freedom: int) -> float:
    """Return the t beyond which the two-sided p is below a level."""
    low, high = 0.0, 1e6
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if 2.0 * upper_tail(middle, freedom) > level else (low, middle)
    return high


def corrected(values: Sequence[float]) -> list[float]:
    """Return p-values corrected for their number (Holm 1979), in the order given."""
    out, largest = [0.0] * len(values), 0.0
    for rank, place in enumerate(sorted(range(len(values)), key=lambda i: values[i])):
        largest = max(largest, min(1.0, values[place] * (len(values) - rank)))
        out[place] = largest
    return out
