"""The centre of mass and its acceleration in flight, which must be that of free fall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from motionkit.arrays import Array, spans
from motionkit.metrics.value import FRAME_RATE, need
from motionkit.motion.skeleton import JOINT_NAMES

FREE_FALL = -9.81  # m/s^2
LEAST_SECONDS = 0.2  # shortest flight that is measured; the fit to a shorter one is too uncertain
EDGE_FRAMES = 2  # frames left out at both ends of a flight, where a foot may still push
FIT_FRAMES = 7  # frames of the fit of the acceleration around a frame

# Body segments: joints at both ends, share of the body's mass, and centre of mass as a share of the length from the
# first joint (Winter 2009, Biomechanics and Motor Control of Human Movement, table 4.1). The skeleton ends at wrist
# and head joint, so the mass of hand and head is there.
_SEGMENTS: tuple[tuple[str, str, float, float], ...] = (
    ("Hips", "Neck", 0.497, 0.5),
    ("Neck1", "Head", 0.081, 0.5),
    *(
        (side + first, side + last, mass, place)
        for side in ("Left", "Right")
        for first, last, mass, place in (
            ("Arm", "ForeArm", 0.028, 0.436),
            ("ForeArm", "Hand", 0.016, 0.430),
            ("Hand", "Hand", 0.006, 0.0),
            ("UpLeg", "Leg", 0.100, 0.433),
            ("Leg", "Foot", 0.0465, 0.433),
            ("Foot", "ToeBase", 0.0145, 0.5),
        )
    ),
)


def _joint_masses() -> Array:
    """Share (23,) of the body's mass that is attributed to each joint."""
    masses = np.zeros(len(JOINT_NAMES))
    for first, last, mass, place in _SEGMENTS:
        masses[JOINT_NAMES.index(first)] += mass * (1.0 - place)
        masses[JOINT_NAMES.index(last)] += mass * place
    return masses / masses.sum()


JOINT_MASSES = _joint_masses()


@dataclass(frozen=True)
class Flight:
    """Frames start to end (exclusive) in the air, and their fitted vertical acceleration in m/s^2."""

    start: int
    end: int
    acceleration: float

    @property
    def error(self) -> float:
        """Difference from free fall in m/s^2."""
        return self.acceleration - FREE_FALL


def centre_of_mass(positions: Array) -> Array:
    """Centre of mass (T, 3) of canonical joint positions (T, 23, 3)."""
    return np.einsum("tjc,j->tc", positions.astype(np.float64), JOINT_MASSES)


def vertical_acceleration(heights: Array) -> Array:
    """Acceleration (T,) in m/s^2 of heights (T,) in cm at 60 fps, from a parabola fitted to FIT_FRAMES frames.

    Raises:
        MotionkitError: there are fewer than FIT_FRAMES frames.
    """
    need(len(heights), FIT_FRAMES, "acceleration needs")
    half = FIT_FRAMES // 2
    fitted = _parabola(FIT_FRAMES) @ sliding_window_view(heights.astype(np.float64), FIT_FRAMES).T
    return np.pad(fitted, half, mode="edge")


def flights(positions: Array, in_air: Array) -> list[Flight]:
    """Flights of at least LEAST_SECONDS in positions (T, 23, 3) in cm at 60 fps; in_air (T,) flags their frames."""
    heights = centre_of_mass(positions)[:, 1]
    found = []
    for start, end in spans(in_air):
        if end - start < LEAST_SECONDS * FRAME_RATE - 0.5:
            continue
        inside = heights[start + EDGE_FRAMES : end - EDGE_FRAMES]
        found.append(Flight(start, end, float(_parabola(len(inside)) @ inside)))
    return found


def _parabola(frames: int) -> Array:
    """Weights (T,) whose product with heights (cm, 60 fps) is the acceleration (m/s^2) of the fitted parabola."""
    times = np.arange(frames) / FRAME_RATE
    design = np.stack([np.ones(frames), times, 0.5 * times**2], axis=1)
    return np.linalg.pinv(design)[2] / 100.0
