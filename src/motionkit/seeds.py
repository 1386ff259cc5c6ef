"""Checks seeds of random numbers."""

from __future__ import annotations

from numbers import Integral

from motionkit.errors import ControlError

LARGEST_SEED = 2**32 - 1


def check_seed(seed: int) -> None:
    """Raise ControlError for a seed that is not a whole number from 0 to LARGEST_SEED."""
    if isinstance(seed, bool) or not isinstance(seed, Integral) or not 0 <= seed <= LARGEST_SEED:
        raise ControlError(f"expected a whole number from 0 to {LARGEST_SEED} as seed, found {seed!r}")
