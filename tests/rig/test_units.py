"""Detection of units from leg lengths."""

from __future__ import annotations

import pytest

from motionkit.motion.skeleton import LEG_TO_STATURE, canonical_skeleton, leg_length
from motionkit.rig.units import SHORTEST, TALLEST, UNITS, Unit, guess_scale


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("height", [150.0, 172.0, 195.0])
def test_a_human_in_any_known_unit_is_recognised(unit: Unit, height: float) -> None:
    leg = LEG_TO_STATURE * height / unit.cm
    scale, source = guess_scale(leg)
    assert scale == unit.cm
    assert unit.name in source


def test_the_canonical_skeleton_is_in_centimetres() -> None:
    leg = leg_length(canonical_skeleton())
    assert guess_scale(leg)[0] == 1.0
    assert SHORTEST < leg / LEG_TO_STATURE < TALLEST


@pytest.mark.parametrize("leg", [0.02, 3.9, 1e6])
def test_no_known_unit_scales_to_a_typical_body_and_says_so(leg: float) -> None:
    scale, source = guess_scale(leg)
    assert leg * scale / LEG_TO_STATURE == pytest.approx(172.0)
    assert "no known unit" in source
