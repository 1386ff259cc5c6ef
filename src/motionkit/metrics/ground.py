"""Measures of feet against the floor: average foot sliding (AFS), foot skate and penetration.

Feet are (T, 4, 3): left foot, left toe, right foot, right toe, in cm with Y up, at 60 fps. The floor is the height in
cm of standing toe joints.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.metrics.value import FRAME_RATE, MetricSettings, MetricValue, need

TOES = (1, 3)  # indices of the toes in the four foot joints
# cm from the ground under the soles to the floor, which is the height of the lowest standing toe joints; median of the
# CMU recordings.
FLOOR_HEIGHT = 3.5


def ground_speed(feet: Array) -> Array:
    """Horizontal distance (T - 1, 4) in cm by which each foot joint moves per frame."""
    return np.linalg.norm(np.diff(feet.astype(np.float64)[..., [0, 2]], axis=0), axis=-1)


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


def foot_skate_ratio(feet: Array, floor: float, settings: MetricSettings | None = None) -> MetricValue:
    """Share of standing toes that slide along the ground faster than settings.skate_speed.

    Each toe in each frame is a sample. A toe stands if it is within skate_height of the floor in this frame and the
    previous one. The paper has no such metric. Unlike in AFS, feet in the air do not lower the value.

    Raises:
        MotionkitError: there are fewer than two frames, or no toe ever stands.
    """
    settings = settings or MetricSettings()
    need(len(feet), 2, "foot skate needs")
    toes = feet.astype(np.float64)[:, list(TOES)]
    low = toes[..., 1] - floor < settings.skate_height
    standing = low[1:] & low[:-1]
    if not bool(standing.any()):
        raise MotionkitError(
            f"no toe is within {settings.skate_height:g} cm of the floor in two consecutive frames"
        )
    skating = standing & (ground_speed(toes) * FRAME_RATE > settings.skate_speed)
    parameters: dict[str, float | str] = {
        "height_cm": settings.skate_height,
        "speed_cm_s": settings.skate_speed,
        "floor_cm": floor,
    }
    return MetricValue("skate-ratio", float(skating.sum() / standing.sum()), "", parameters)


def penetration(feet: Array, floor: float) -> tuple[MetricValue, MetricValue]:
    """Depth of the lowest foot joint below the floor in cm: mean over all frames, and maximum.

    Raises:
        MotionkitError: there are no frames.
    """
    need(len(feet), 1, "penetration needs")
    depth = np.maximum((floor - feet.astype(np.float64)[..., 1]).max(axis=1), 0.0)
    parameters: dict[str, float | str] = {"floor_cm": floor}
    return (
        MetricValue("penetration-mean", float(depth.mean()), "cm", parameters),
        MetricValue("penetration-max", float(depth.max()), "cm", parameters),
    )
