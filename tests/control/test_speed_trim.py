"""A body that is told how fast to go goes that fast, whatever its network makes of a trajectory."""

from __future__ import annotations

import math

import numpy as np
import pytest

from motionkit.control.drive import Driver, Wish
from motionkit.control.memory import TRIM, SpeedTrim
from motionkit.inference.character import CharacterStream
from motionkit.models.bundled import load_bundled_model
from motionkit.models.model import MotionModel

WALKS = (0.0, 90.0)  # of the tiny model, whose walks are recorded at up to 131 cm/s


def go(trim: SpeedTrim, wish: tuple[float, float], share: float, seconds: float) -> tuple[float, float]:
    """What is asked for in the end of a body that goes at a share of what it is asked for."""
    asked = wish
    for _ in range(round(seconds * trim.model.fps)):
        asked = trim("walking", wish, (share * asked[0], share * asked[1]))
    return asked


@pytest.mark.parametrize("share", [0.8, 0.9, 1.0, 1.2])
def test_a_lasting_error_of_speed_is_made_up_for(tiny_model: MotionModel, share: float) -> None:
    asked = go(SpeedTrim(tiny_model), WALKS, share, 8.0)
    assert share * math.hypot(*asked) == pytest.approx(90.0, rel=0.01)
    assert asked[0] == 0.0


def test_nothing_is_made_up_for_on_the_way_to_a_wish(tiny_model: MotionModel) -> None:
    trim = SpeedTrim(tiny_model)
    assert go(trim, WALKS, 0.3, TRIM.wait) == WALKS
    assert go(trim, (90.0, 0.0), 0.3, TRIM.wait) == (90.0, 0.0), "another direction is another wish"
    assert go(trim, (88.0, 3.0), 0.3, TRIM.wait) != (88.0, 3.0), "a stick that trembles is not"


def test_a_change_of_speed_is_asked_for_beyond_the_wish_at_first(tiny_model: MotionModel) -> None:
    trim = SpeedTrim(tiny_model)
    go(trim, (0.0, 110.0), 1.0, 3.0)
    assert trim("walking", WALKS, (0.0, 110.0)) == pytest.approx((0.0, 90.0 - 20.0 * TRIM.lead))
    assert go(trim, WALKS, 1.0, TRIM.lead_seconds) == pytest.approx(WALKS, rel=0.01)
    assert trim("walking", (0.0, 110.0), WALKS) == pytest.approx((0.0, 110.0 + 20.0 * TRIM.lead), rel=0.01)
    slowest, fastest = tiny_model.speed_range("walking") or (0.0, 0.0)
    assert trim("walking", (0.0, fastest), WALKS) == pytest.approx((0.0, fastest)), (
        "nothing that no recording shows"
    )
    assert trim("walking", (0.0, 1.01 * slowest), WALKS)[1] >= slowest - 1e-6


def test_a_gait_keeps_its_share_over_a_change_of_speed_and_over_a_stop(tiny_model: MotionModel) -> None:
    trim = SpeedTrim(tiny_model)
    go(trim, WALKS, 0.8, 8.0)
    assert trim("idle", (0.0, 0.0), (0.0, 0.0)) == (0.0, 0.0)
    assert trim("running", (0.0, 300.0), (0.0, 0.0)) == (0.0, 300.0), "another gait has its own"
    assert trim("walking", (0.0, 100.0), (0.0, 0.0))[1] == pytest.approx(125.0, rel=0.01)


def test_what_cannot_go_faster_is_not_asked_for_more_and_more(tiny_model: MotionModel) -> None:
    slowest, fastest = tiny_model.speed_range("walking") or (0.0, 0.0)
    assert 0.0 < slowest < 90.0 < fastest
    assert go(SpeedTrim(tiny_model), WALKS, 0.2, 20.0)[1] <= min(TRIM.limits[1] * 90.0, fastest) + 1e-6
    beyond = (0.0, fastest + 50.0)
    assert go(SpeedTrim(tiny_model), beyond, 0.2, 20.0) == pytest.approx(beyond)


def test_a_body_pushed_backwards_by_a_wish_of_nothing_stands(tiny_model: MotionModel) -> None:
    trim = SpeedTrim(tiny_model)
    assert trim("walking", (0.0, 10.0), (0.0, 0.0)) == (0.0, 10.0), "so slow a wish is one to stand"


@pytest.mark.parametrize(("kind", "speed"), [("walking", 100.0), ("walking", 140.0), ("running", 300.0)])
def test_a_live_character_goes_at_the_speed_it_is_told(kind: str, speed: float) -> None:
    model = load_bundled_model()
    stream, driver = CharacterStream(model, 1), Driver(model)
    driver.set_wish(Wish((0.0, speed), 0.0, kind))
    places = []
    for frame in range(420):
        stream.step(driver(frame, stream.ground))
        places.append(stream.ground[0, :2].copy())
    gone = np.linalg.norm(places[-1] - places[-181]) / 180 * model.fps
    assert gone == pytest.approx(speed, rel=0.05)
