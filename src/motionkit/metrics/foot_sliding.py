"""Average foot sliding (AFS): horizontal movement of feet near the ground.

Feet are those of metrics.ground. The paper's heights H are settings.foot_height and settings.toe_height.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motionkit.arrays import Array
from motionkit.metrics.ground import ground_speed
from motionkit.metrics.value import MetricSettings, MetricValue, need


def average_foot_sliding(feet: Array, floor: float, settings: MetricSettings | None = None) -> MetricValue:
    """AFS in cm per frame (paper, equation AFS): ground speed, with a weight of 1 on the floor and 0 at height H.

    Raises:
        MotionkitError: there are fewer than two frames.
    """
    settings = settings or MetricSettings()
    need(len(feet), 2, "average foot sliding needs")
    limits = np.array([settings.foot_height, settings.toe_height] * 2, np.float64)
    exponent = np.clip((feet[1:, :, 1].astype(np.float64) - floor) / limits, 0.0, 1.0)
    sliding = ground_speed(feet) * (2.0 - np.exp2(exponent))
    parameters: dict[str, float | str] = {
        "foot_height_cm": settings.foot_height,
        "toe_height_cm": settings.toe_height,
        "floor_cm": floor,
    }
    return MetricValue("afs", float(sliding.mean()), "cm/frame", parameters)


def sliding_over_ground(feet: Array, settings: MetricSettings | None = None) -> MetricValue:
    """AFS in cm per frame exactly as in the paper: heights are above y = 0, wherever the clip's floor is.

    Raises:
        MotionkitError: there are fewer than two frames.
    """
    return replace(average_foot_sliding(feet, 0.0, settings), id="afs-ground")
