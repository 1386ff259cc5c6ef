"""Detects the unit of a file's lengths from the length of the legs."""

from __future__ import annotations

from motionkit.errors import SkeletonError
from motionkit.motion.skeleton import LEG_TO_STATURE

# cm per file unit. The CMU unit is an inch divided by 0.45.
KNOWN_UNITS: dict[str, float] = {
    "centimetres": 1.0,
    "metres": 100.0,
    "millimetres": 0.1,
    "inches": 2.54,
    "CMU units": 2.54 / 0.45,
    "decimetres": 10.0,
}
# Standing height in cm: the plausible range, and the most likely height.
SHORTEST, TALLEST, TYPICAL = 130.0, 215.0, 172.0
# Leg length in file units; kilometres and micrometres are out of range. Dividing by less would overflow.
SHORTEST_LEG, LONGEST_LEG = 1e-3, 1e6


def stature(leg: float) -> float:
    """Standing height of a body with this leg length (thigh plus shin), in the same unit."""
    return leg / LEG_TO_STATURE


def guess_scale(leg: float) -> tuple[float, str]:
    """Detect the unit from a leg length in file units.

    The known unit with the most likely stature wins. If none gives a human stature, the body is scaled to a typical
    one.

    Returns:
        cm per file unit, and how it was determined.

    Raises:
        SkeletonError: the leg length is out of range.
    """
    check_leg(leg)
    errors = {
        name: abs(stature(leg * scale) - TYPICAL)
        for name, scale in KNOWN_UNITS.items()
        if SHORTEST <= stature(leg * scale) <= TALLEST
    }
    if errors:
        name = min(errors, key=lambda unit: errors[unit])
        return KNOWN_UNITS[name], f"detected from leg length: {name}"
    scale = TYPICAL / stature(leg)
    return scale, f"no known unit fits a leg of {leg:.4g}, scaled to a stature of {TYPICAL:.0f} cm"


def check_leg(leg: float) -> None:
    """Raise SkeletonError for a leg length in file units that is out of range."""
    if not SHORTEST_LEG <= leg <= LONGEST_LEG:
        raise SkeletonError(
            f"expected a leg length of {SHORTEST_LEG:g} to {LONGEST_LEG:,.0f} file units, found {leg:.3g}"
        )
