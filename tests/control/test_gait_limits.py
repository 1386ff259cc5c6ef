"""A gait is asked for what its feet can do, and whoever is to go goes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from control.steered import AT_ONCE, FREE, asked_of
from motionkit.control.drive import Driver, Wish
from motionkit.control.steering import GAIT_CHOICE, GOES_FROM, Steering, steered_type
from motionkit.inference.character import CharacterStream
from motionkit.models.bundled import load_bundled_model
from motionkit.motion.floor import foot_positions


@pytest.mark.parametrize(
    ("kind", "asked"),
    [("walking", 30.0), ("walking", 100.0), ("walking", 900.0), (FREE, 900.0), ("idle", 20.0)],
)
def test_speeds_are_those_of_the_recordings(kind: str, asked: float) -> None:
    steering = Steering(load_bundled_model(), AT_ONCE)
    steering.observe(0.0, 0.0, math.pi, False)
    (aside, ahead), _ = asked_of(steering, kind, (0.0, -asked), math.pi)
    slowest, fastest = steering.model.speed_range(kind) or (0.0, math.inf)
    assert ahead == pytest.approx(0.0 if kind == "idle" else min(max(asked, slowest), fastest), rel=1e-3)
    assert aside == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("facing", [-3.0, -1.5, -0.5, 0.0, 0.7, 1.6, 3.0])
def test_a_gait_goes_aside_up_to_a_limit(facing: float) -> None:
    walks = (("walking", 0.0, GAIT_CHOICE.most_aside), ("b-walking", math.pi, GAIT_CHOICE.most_aside))
    for kind, own, most in (*walks, ("running", 0.0, GAIT_CHOICE.most_aside_running)):
        steering = Steering(load_bundled_model(), AT_ONCE)
        steering.observe(0.0, 0.0, 0.0, False)
        _, turned = asked_of(steering, kind, (0.0, 100.0), facing)
        away = math.remainder(turned - own, 2 * math.pi)
        wanted = math.remainder(facing - own, 2 * math.pi)
        assert away == pytest.approx(math.copysign(min(abs(wanted), most), wanted), abs=0.02)


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
