"""Detection of units from leg lengths."""

from __future__ import annotations

import pytest

from motionkit.motion.skeleton import canonical_skeleton, leg_length
from motionkit.rig.units import KNOWN_UNITS, SHORTEST, TALLEST, guess_scale, stature


@pytest.mark.parametrize("unit", KNOWN_UNITS)
@pytest.mark.parametrize("height", [150.0, 172.0, 195.0])
def test_a_human_in_any_known_unit_is_recognised(unit: str, height: float) -> None:
    leg = 0.491 * height / KNOWN_UNITS[unit]
    scale, source = guess_scale(leg)
    assert scale == KNOWN_UNITS[unit]
    assert unit in source


def test_the_canonical_skeleton_is_in_centimetres() -> None:
    leg = leg_length(canonical_skeleton())
    assert guess_scale(leg)[0] == 1.0
    assert SHORTEST < stature(leg) < TALLEST


@pytest.mark.parametrize("leg", [0.02, 3.9, 1e6])
def test_no_known_unit_scales_to_a_typical_body_and_says_so(leg: float) -> None:
    scale, source = guess_scale(leg)
    assert stature(leg * scale) == pytest.approx(172.0)
    assert "no known unit" in source
