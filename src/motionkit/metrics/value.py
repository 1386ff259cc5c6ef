"""A measured value, and the settings shared by all metrics."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from motionkit.errors import MotionkitError
from motionkit.names import counted

FRAME_RATE = 60.0  # per-frame metrics are per frame at this rate


@dataclass(frozen=True)
class MetricValue:
    """One measured value (docs/metrics.md).

    Attributes:
        id: the metric, such as "bm-euler".
        unit: such as "cm/frame", or "" for a share or index.
        parameters: thresholds that the value depends on.
        reason: why value is None.
    """

    id: str
    value: float | None
    unit: str
    parameters: dict[str, float | str] = field(default_factory=dict)
    reason: str | None = None


def need(count: int, least: int, who: str, things: str = "frame") -> None:
    """Raise MotionkitError if count is below least; `who` begins the message, such as "foot skate needs"."""
    if count < least:
        raise MotionkitError(f"{who} at least {counted(least, things)}, found {count}")


def measured(
    measure: Callable[[], MetricValue | tuple[MetricValue, ...]], units: Mapping[str, str]
) -> tuple[MetricValue, ...]:
    """The values of a metric; if measuring fails, a value of None with the reason for each id of units."""
    try:
        result = measure()
    except MotionkitError as error:
        return tuple(MetricValue(name, None, unit, reason=str(error)) for name, unit in units.items())
    return result if isinstance(result, tuple) else (result,)


@dataclass(frozen=True)
class MetricSettings:
    """Thresholds of the metrics; the defaults are the documented definitions."""

    foot_height: float = 10.85  # cm, H of the foot joints in AFS (paper, equation AFS)
    toe_height: float = 1.55  # cm, H of the toe joints in AFS (paper, equation AFS)
    skate_height: float = 2.5  # cm above the floor below which a toe counts as standing
    skate_speed: float = 50.0  # cm/s along the ground above which a standing toe skates
    ssim_window: int = 11  # frames (paper, section Metrics)
    ssim_k1: float = 0.01
    ssim_k2: float = 0.03
    path_tolerance: float = 10.0  # cm within which a stretch of the reference path counts as covered
    floor: float | None = None  # cm, a known floor height; None estimates it for each clip

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name != "floor" and not 0.0 < value < math.inf:
                raise MotionkitError(f"expected {name} above 0, found {value:g}")
        if self.floor is not None and not math.isfinite(self.floor):
            raise MotionkitError(f"expected a finite floor, found {self.floor:g}")
