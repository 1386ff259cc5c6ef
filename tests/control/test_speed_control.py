"""A body that is told how fast to go goes that fast, whatever its network makes of a trajectory."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from control.steered import AT_ONCE, FPS, asked_of
from motionkit.control.drive import Driver, Wish
from motionkit.control.steering import SPEED_CONTROL, Pair, Steering
from motionkit.inference.character import CharacterStream
from motionkit.models.bundled import load_bundled_model
from motionkit.models.model import MotionModel

WALKS = (0.0, 90.0)  # of the tiny model, whose walks are recorded at up to 131 cm/s


def body(model: MotionModel) -> Steering:
    """The steering of a body that turns at once."""
    return Steering(model, AT_ONCE)


def asks(steering: Steering, kind: str, wish: Pair) -> Pair:
    """What is asked for in a frame."""
    return asked_of(steering, kind, wish, 0.0)[0]


def go(steering: Steering, wish: Pair, share: float, seconds: float) -> Pair:
    """What is asked for in the end of a body that goes at a share of what it is asked for."""
    asked, (x, z, _) = (0.0, 0.0), steering.words.before
    for _ in range(round(seconds * FPS)):
        x, z = x + share * asked[0] / FPS, z + share * asked[1] / FPS
        steering.observe(x, z, 0.0, False)
        asked = asks(steering, "walking", wish)
    return asked


def near(wish: Pair, share: float = 1e-3) -> Any:
    """A velocity, up to a share of it."""
    return pytest.approx(wish, abs=share * math.hypot(*wish))


@pytest.mark.parametrize("share", [0.8, 0.9, 1.0, 1.2])
def test_a_lasting_error_of_speed_is_made_up_for(tiny_model: MotionModel, share: float) -> None:
    asked = go(body(tiny_model), WALKS, share, 8.0)
    assert share * math.hypot(*asked) == pytest.approx(90.0, rel=0.01)
    assert asked[0] == pytest.approx(0.0, abs=0.01)


def test_nothing_is_made_up_for_on_the_way_to_a_wish(tiny_model: MotionModel) -> None:
    steering = body(tiny_model)
    assert go(steering, WALKS, 0.3, SPEED_CONTROL.wait) == near(WALKS)
    aside = (50.0, 75.0)
    assert go(steering, aside, 0.3, SPEED_CONTROL.wait) == near(aside), "another direction is another wish"
    trembles = (48.0, 78.0)
    assert go(steering, trembles, 0.3, SPEED_CONTROL.wait) != near(trembles, 0.02), (
        "a stick that trembles is not"
    )


def test_a_change_of_speed_is_asked_for_beyond_the_wish_at_first(tiny_model: MotionModel) -> None:
    steering = body(tiny_model)
    go(steering, (0.0, 110.0), 1.0, 3.0)
    assert asks(steering, "walking", WALKS) == near((0.0, 90.0 - 20.0 * SPEED_CONTROL.overshoot))
    assert go(steering, WALKS, 1.0, SPEED_CONTROL.overshoot_seconds) == near(WALKS, 0.01)
    assert asks(steering, "walking", (0.0, 110.0)) == near(
        (0.0, 110.0 + 20.0 * SPEED_CONTROL.overshoot), 0.01
    )
    slowest, fastest = tiny_model.speed_range("walking") or (0.0, 0.0)
    assert asks(steering, "walking", (0.0, fastest)) == near((0.0, fastest)), (
        "nothing that no recording shows"
    )
    assert asks(steering, "walking", (0.0, 1.01 * slowest))[1] >= slowest - 1e-2


def test_a_gait_keeps_its_share_over_a_change_of_speed_and_over_a_stop(tiny_model: MotionModel) -> None:
    steering = body(tiny_model)
    go(steering, WALKS, 0.8, 8.0)
    asks(steering, "idle", (0.0, 0.0))
    assert asks(steering, "running", (0.0, 300.0)) == near((0.0, 300.0)), "another gait has its own"
    assert asks(steering, "walking", (0.0, 100.0))[1] == pytest.approx(125.0, rel=0.01)


def test_what_cannot_go_faster_is_not_asked_for_more_and_more(tiny_model: MotionModel) -> None:
    slowest, fastest = tiny_model.speed_range("walking") or (0.0, 0.0)
    assert 0.0 < slowest < 90.0 < fastest
    assert go(body(tiny_model), WALKS, 0.2, 20.0)[1] <= min(SPEED_CONTROL.most * 90.0, fastest) + 0.01


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
