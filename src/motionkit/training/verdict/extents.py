"""How far, how fast and how often a body moves, measured and told in the words of a user."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array, spans
from motionkit.data.events import PUNCH_SPEED
from motionkit.metrics.body import HANDS, HIPS, LEFT_FOOT, LEFT_TOE, OFF_GROUND, RIGHT_FOOT, RIGHT_TOE, Body

ANKLES, TOES = (LEFT_FOOT, RIGHT_FOOT), (LEFT_TOE, RIGHT_TOE)
STEP_LIFT = 4.0  # cm above its standing height that a foot rises in a step
# What recordings show is widened by this share of their spread, and by the margins of the measure.
SPREAD = 0.5
EXTENT_SECONDS = 5.0  # windows of recordings, as long as what is judged of a roll-out


@dataclass(frozen=True)
class Measure:
    """A number that says how a body moves.

    Attributes:
        does, at, unit: how it is told: "feet rise", "to", "cm".
        of: measures a body.
        least, share: what is widened in either direction at least, and as a share of the value.
        digits: decimal places that are printed.
    """

    does: str
    at: str
    unit: str
    of: Callable[[Body], float]
    least: float
    share: float
    digits: int = 0


def _highest(*joints: int) -> Callable[[Body], float]:
    return lambda body: float(body.positions[:, list(joints), 1].max())


def _lowest(*joints: int) -> Callable[[Body], float]:
    return lambda body: float(body.positions[:, list(joints), 1].min())


def _sunk(body: Body) -> float:
    return max(0.0, -_lowest(*ANKLES, *TOES)(body))


def _a_second(flags: Array, body: Body) -> float:
    """How often a column of flags (T, N) begins to be true, per second."""
    return sum(len(spans(column)) for column in flags.T) / body.seconds


def _in_the_air(body: Body) -> float:
    return float(100.0 * (body.lifts.min(axis=-1) > OFF_GROUND).mean())


MEASURES = (
    Measure("feet rise", "to", "cm", _highest(*ANKLES), 8.0, 0.1),
    Measure("feet sink", "by", "cm into the floor", _sunk, 8.0, 0.1),
    Measure("hands rise", "to", "cm", _highest(*HANDS), 8.0, 0.1),
    Measure("hands sink", "to", "cm", _lowest(*HANDS), 8.0, 0.1),
    Measure("hips rise", "to", "cm", _highest(HIPS), 8.0, 0.1),
    Measure("hips sink", "to", "cm", _lowest(HIPS), 8.0, 0.1),
    Measure("it goes", "at", "m/s", lambda body: float(body.speed.mean()), 0.1, 0.2, 2),
    Measure("joints turn", "at", "rad/s", Body.joint_speed, 0.1, 0.2, 2),
    Measure("it is in the air", "for", "% of the time", _in_the_air, 5.0, 0.2),
    Measure("feet step", "at", "a second", lambda body: _a_second(body.lifts > STEP_LIFT, body), 0.4, 0.3, 1),
    Measure(
        "hands strike", "at", "a second", lambda body: _a_second(body.arm_thrust > PUNCH_SPEED, body), 0.4, 0.3, 1
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Extent:
    """What the recordings of a type show of a measure: the smallest and the largest value of their windows."""

    measure: Measure
    lowest: float
    highest: float

    @property
    def limits(self) -> tuple[float, float]:
        """The smallest and the largest value that are within: the recorded range with its margins."""
        size = max(abs(self.lowest), abs(self.highest))
        margin = max(self.measure.least, self.measure.share * size) + SPREAD * (self.highest - self.lowest)
        return self.lowest - margin, self.highest + margin

    def excess(self, value: float) -> float:
        """Return how far a value is outside the limits, in widths of the range within; 0 inside, infinity for NaN."""
        lowest, highest = self.limits
        if not np.isfinite(value):
            return float("inf")
        return max(lowest - value, value - highest, 0.0) / (highest - lowest)

    def described(self, value: float) -> str:
        """Return a value beside the recordings: "feet rise to 83 cm; in the clips to 116 to 134 cm"."""
        made, low, high = (f"{each:.{self.measure.digits}f}" for each in (value, self.lowest, self.highest))
        known = low if low == high else f"{low} to {high}"
        does, at, unit = self.measure.does, self.measure.at, self.measure.unit
        return f"{does} {at} {made} {unit}; in the clips {at} {known} {unit}"


def extents_of(windows: Sequence[Body]) -> tuple[Extent, ...]:
    """Return what windows of recordings show of each measure."""
    values = np.array([[measure.of(window) for measure in MEASURES] for window in windows])
    return tuple(
        Extent(measure, float(column.min()), float(column.max()))
        for measure, column in zip(MEASURES, values.T, strict=True)
    )


def what_is_off(extents: Sequence[Extent], windows: Sequence[Body]) -> str:
    """Return in words what most of the windows miss, with the median of those that miss it; "" if none misses any."""
    found = []
    for extent in extents:
        values = [value for value in map(extent.measure.of, windows) if extent.excess(value)]
        if values:
            found.append((len(values), extent.described(float(np.median(values)))))
    return max(found, key=lambda each: each[0])[1] if found else ""
