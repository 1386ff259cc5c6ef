from __future__ import annotations

import numpy as np
import pytest

from motionkit.control.plan import plan_types
from motionkit.control.script import TypePart, parse_types
from motionkit.errors import ControlError


def parsed(text: str, seconds: float | None = None) -> list[tuple[str, float]]:
    return [(part.type, part.seconds) for part in parse_types(text, seconds)]


@pytest.mark.parametrize(
    ("text", "seconds", "parts"),
    [
        ("running", None, [("running", 4.0)]),
        ("running,cartwheel", None, [("running", 4.0), ("cartwheel", 4.0)]),
        ("running:4,cartwheel:3", None, [("running", 4.0), ("cartwheel", 3.0)]),
        (" running : 2.5 , idle ", None, [("running", 2.5), ("idle", 4.0)]),
        ("running,cartwheel", 10.0, [("running", 5.0), ("cartwheel", 5.0)]),
        ("running:2,cartwheel,idle", 10.0, [("running", 2.0), ("cartwheel", 4.0), ("idle", 4.0)]),
        ("running:1,cartwheel:3", 8.0, [("running", 2.0), ("cartwheel", 6.0)]),
        ("running,running:1,running", 3.0, [("running", 1.0)] * 3),
        ("jumping-l:1e0", None, [("jumping-l", 1.0)]),
    ],
)
def test_types_and_times(text: str, seconds: float | None, parts: list[tuple[str, float]]) -> None:
    assert parsed(text, seconds) == [(kind, pytest.approx(time)) for kind, time in parts]


@pytest.mark.parametrize(
    ("text", "seconds", "complaint"),
    [
        ("", None, "found none"),
        (" , ", None, "found none"),
        ("running,,idle", None, "expected type or type:seconds, found ''"),
        (":3", None, "expected type or type:seconds, found ':3'"),
        ("running:fast", None, "expected seconds after the colon, found 'running:fast'"),
        ("running:0", None, "expected more than 0 and at most 3600 seconds"),
        ("running:-1", None, "expected more than 0 and at most 3600 seconds"),
        ("running:nan", None, "expected more than 0 and at most 3600 seconds"),
        ("running:inf", None, "expected more than 0 and at most 3600 seconds"),
        ("running:1:2", None, "expected seconds after the colon"),
        ("running:5,idle", 4.0, "the other parts take 5 of 4 s and leave none for idle"),
    ],
)
def test_what_is_no_list_of_types(text: str, seconds: float | None, complaint: str) -> None:
    with pytest.raises(ControlError) as caught:
        parse_types(text, seconds)
    assert complaint in str(caught.value)


def test_track_has_the_asked_number_of_frames(tiny_model) -> None:
    track = plan_types(tiny_model, [TypePart("running", 1.0), TypePart("idle", 0.5)]).track
    running, idle = (tiny_model.type_id(name) for name in ("running", "idle"))
    assert track.tolist() == [running] * 60 + [idle] * 30
    assert len(plan_types(tiny_model, [TypePart("idle", 0.001)]).track) == 1


def test_weights_blend_over_40_frames(tiny_model) -> None:
    weights = plan_types(tiny_model, [TypePart("running", 2.0), TypePart("idle", 2.0)]).weights
    assert np.allclose(weights.sum(-1), np.ones(240, np.float32))
    mixed = np.flatnonzero((weights > 0).sum(-1) == 2)
    assert (int(mixed[0]), int(mixed[-1]), len(mixed)) == (101, 139, 39)


def test_an_unknown_type(tiny_model) -> None:
    with pytest.raises(ControlError, match="did you mean 'cartwheel'"):
        plan_types(tiny_model, [TypePart("cart wheel", 1.0)])
