"""A gait is asked for what its feet can do, and whoever is to go goes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from motionkit.control.drive import Driver, Wish
from motionkit.control.gait_limits import MOST_ASIDE, MOST_ASIDE_RUNNING, speed_limits, within_limits
from motionkit.control.steering import GOES_FROM, steered_type
from motionkit.inference.character import CharacterStream
from motionkit.models.bundled import load_bundled_model
from motionkit.motion.floor import foot_positions


def test_speeds_are_those_of_the_recordings() -> None:
    model = load_bundled_model()
    slowest, fastest = speed_limits(model, "walking")
    for asked, goes in ((30.0, slowest), (100.0, 100.0), (900.0, fastest)):
        velocity, facing = within_limits(model, "walking", (0.0, -asked), math.pi)
        assert velocity == pytest.approx((0.0, -goes)) and facing == math.pi
    assert within_limits(model, "walking", (0.0, 5.0), 0.0) == ((0.0, 5.0), 0.0), "a wish to stand"
    assert within_limits(model, "idle", (0.0, 20.0), 1.0) == ((0.0, 0.0), 1.0), "who stands is not moved"
    assert within_limits(model, "dance-salsa", (0.0, 900.0), None) == ((0.0, 900.0), None)


@pytest.mark.parametrize("facing", [-3.0, -1.5, -0.5, 0.0, 0.7, 1.6, 3.0])
def test_a_gait_goes_aside_up_to_a_limit(facing: float) -> None:
    model = load_bundled_model()
    walks = (("walking", 0.0, MOST_ASIDE), ("b-walking", math.pi, MOST_ASIDE))
    for kind, own, most in (*walks, ("running", 0.0, MOST_ASIDE_RUNNING)):
        _, turned = within_limits(model, kind, (0.0, 100.0), facing)
        assert turned is not None
        away = math.remainder(turned - own, 2 * math.pi)
        wanted = math.remainder(facing - own, 2 * math.pi)
        assert abs(away) <= most + 0.01
        assert away == pytest.approx(math.copysign(min(abs(wanted), most), wanted), abs=0.01)


def test_nobody_glides_between_standing_and_going() -> None:
    model = load_bundled_model()
    assert steered_type(model, (0.0, GOES_FROM - 1.0), 0.0) == "idle"
    assert steered_type(model, (0.0, GOES_FROM), 0.0) == "walking"


@pytest.mark.parametrize("wish", [Wish((0.0, 20.0)), Wish((0.0, 30.0), 0.0), Wish((-100.0, 0.0), 0.0)])
def test_toes_stand_at_any_wish(wish: Wish) -> None:
    model = load_bundled_model()
    stream, driver = CharacterStream(model, 1), Driver(model)
    driver.set_wish(wish)
    feet = []
    for frame in range(360):
        made = stream.step(driver(frame, stream.ground))
        feet.append(foot_positions(made.positions)[0, [1, 3]])
    toes = np.stack(feet)[150:]
    speeds = np.linalg.norm(np.diff(toes[..., [0, 2]], axis=0), axis=-1) * model.fps
    assert float(np.median(speeds.min(axis=1))) < 2.0, "one of the feet stands"
    low = toes[1:, :, 1] < 5.0
    assert float((low & (speeds > 15.0)).sum() / low.sum()) < 0.25
