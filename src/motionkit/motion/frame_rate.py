"""Frame rates of files, whose frame times are rounded."""

from __future__ import annotations

WHOLE_WITHIN = 0.01  # share by which a rate may differ from a whole number
# Share by which it may differ from those of NTSC video, 1000 / 1001 of 24, 30, 60 or 120 and 0.1 % below them: what
# is left of 0.033367, but not of 0.0334.
NTSC_WITHIN = 1.5e-4
NTSC = 1000.0 / 1001.0


def nominal_rate(rate: float) -> float:
    """The frame rate that a measured one stands for: that of NTSC video, a whole number, or itself.

    Args:
        rate: frames a second, above 0.
    """
    whole = round(rate)
    if whole in (24, 30, 60, 120) and abs(rate - NTSC * whole) < NTSC_WITHIN * rate:
        return NTSC * whole
    return float(whole) if whole and abs(rate - whole) < WHOLE_WITHIN * whole else rate
