"""Exact frame rates from the rounded frame times of files."""

from __future__ import annotations

WHOLE_WITHIN = 0.01  # largest relative difference from a whole number
# Largest relative difference from a rate of NTSC video, which is 1000 / 1001 of 24, 30, 60 or 120. It accepts a frame
# time of 0.033367, but not 0.0334.
NTSC_WITHIN = 1.5e-4
NTSC = 1000.0 / 1001.0


RATE = 60.0  # frames a second of settings that count frames


def frames_at(count: float, fps: float) -> int:
    """The number of frames that last as long as `count` frames at 60 fps, at least 1."""
    return max(1, round(count * fps / RATE))


def nominal_rate(rate: float, within: float = WHOLE_WITHIN) -> float:
    """The exact rate for a measured one above 0: an NTSC rate, a whole number, or the measured rate itself.

    within is the largest relative difference from a whole number; frame times of .bvh files have few digits.
    """
    whole = round(rate)
    if whole in (24, 30, 60, 120) and abs(rate - NTSC * whole) < NTSC_WITHIN * rate:
        return NTSC * whole
    return float(whole) if whole and abs(rate - whole) < within * whole else rate
