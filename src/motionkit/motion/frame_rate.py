"""Exact frame rates from the rounded frame times of files."""

from __future__ import annotations

# Largest relative difference of a rate from a whole number: of frame times with few digits, and of those with many.
WHOLE_WITHIN, EXACT_WITHIN = 0.01, 1e-4
ENOUGH_DIGITS = 5  # significant digits of a frame time that is exact
# Largest relative difference from a rate of NTSC video, which is 1000 / 1001 of 24, 30, 60 or 120. It accepts a frame
# time of 0.033367, but not 0.0334.
NTSC_WITHIN = 1.5e-4
NTSC = 1000.0 / 1001.0


RATE = 60.0  # frames a second of settings that count frames


def frames_at(count: float, fps: float) -> int:
    """The number of frames that last as long as `count` frames at 60 fps, at least 1."""
    return max(1, round(count * fps / RATE))


def rate_within(frame_time: str) -> float:
    """The largest relative difference of a rate from a whole number that the digits of a frame time allow."""
    return min(WHOLE_WITHIN, max(EXACT_WITHIN, 2.0 * 10.0 ** (1 - significant_digits(frame_time))))


def significant_digits(number: str) -> int:
    """How many digits a decimal number has from the first one that is not zero."""
    return len(number.lower().partition("e")[0].replace(".", "").lstrip("+-0"))


def nominal_rate(rate: float, within: float = WHOLE_WITHIN) -> float:
    """The exact rate for a measured one above 0: an NTSC rate, a whole number, or the measured rate itself.

    within is the largest relative difference from a whole number (rate_within).
    """
    whole = round(rate)
    if whole in (24, 30, 60, 120) and abs(rate - NTSC * whole) < NTSC_WITHIN * rate:
        return NTSC * whole
    return float(whole) if whole and abs(rate - whole) < within * whole else rate
