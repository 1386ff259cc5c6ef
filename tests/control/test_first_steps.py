"""First steps from standing are those of recordings, live and on paths, and bodies do not drop."""

from __future__ import annotations

import numpy as np
import pytest

from model_changes import with_clips
from motionkit.control.drive import Driver, Wish, together
from motionkit.control.follow import GUIDED, follow_path
from motionkit.control.memory import FIRST_STEPS, FirstSteps
from motionkit.control.path import PathPart, make_path, shape_path
from motionkit.control.recording_choice import ENTRY, RecordingChoice, few_clips
from motionkit.control.synthesize import SynthesisOptions
from motionkit.features.control import Controls
from motionkit.inference.character import CharacterStream
from motionkit.models.bundled import load_bundled_model
from motionkit.models.model import MotionModel
from motionkit.motion.floor import TOES

HIPS = 0
AT_ORIGIN = np.zeros((1, 3), np.float32)
AHEAD = np.zeros((1, 24), np.float32)


def gains(driver: Driver, wish: Wish, frames: int, first: int) -> list[float]:
    driver.set_wish(wish)
    return [float(driver(frame, AT_ORIGIN).reference_gain[0]) for frame in range(first, first + frames)]


def test_a_gait_is_shown_recordings_for_its_first_steps_from_standing(tiny_model: MotionModel) -> None:
    driver = Driver(tiny_model)
    assert gains(driver, Wish((0.0, 0.0)), 30, 0) == [0.0] * 30
    gain = tiny_model.types["walking"].preset.reference_gain
    walked = gains(driver, Wish((0.0, 120.0), type="walking"), FIRST_STEPS + 10, 30)
    assert walked == [pytest.approx(gain)] * FIRST_STEPS + [0.0] * 10
    assert gains(driver, Wish((0.0, 300.0), type="running"), 10, 200) == [0.0] * 10, "it goes already"


def test_a_path_from_standing_begins_with_first_steps_too(tiny_model: MotionModel) -> None:
    driver = Driver(tiny_model)
    gains(driver, Wish((0.0, 0.0)), 30, 0)
    gain = tiny_model.types["walking"].preset.reference_gain
    path = Wish(path=shape_path("line", 10.0, ["walking"], 1.2))
    assert gains(driver, path, 10, 30) == [pytest.approx(gain)] * 10
    assert driver.follower is not None and driver.follower.route.speeds[0] == pytest.approx(60.0)
    going = Driver(tiny_model)
    gains(going, Wish((0.0, 120.0), type="walking"), FIRST_STEPS + 10, 0)
    assert gains(going, path, 10, 100) == [pytest.approx(GUIDED * gain)] * 10, "it goes already"
    assert going.follower is not None and going.follower.route.speeds[0] == pytest.approx(120.0)


def test_another_gait_ends_the_first_steps(tiny_model: MotionModel) -> None:
    steps = FirstSteps(tiny_model)
    assert not steps.takes("walking")
    steps.begin("walking")
    assert steps.takes("walking") and not steps.takes("running") and not steps.takes("walking")


def test_every_start_enters_the_recordings_anew(tiny_model: MotionModel) -> None:
    asked = Controls.of_types(np.zeros((1, len(tiny_model.types)), np.float32))
    once, again = FirstSteps(tiny_model, 3), FirstSteps(tiny_model, 3)
    again.begin("running")
    for steps in (once, again):
        steps._player.recordings.random.seed(0)
        steps._player.recordings.draws = 0
        steps.begin("walking")
    first, second = (steps.reference(asked, AHEAD) for steps in (once, again))
    assert np.array_equal(first.reference, second.reference), "nothing fades in from the run before"


def test_few_clips_are_the_first_ones_and_one_at_least(tiny_model: MotionModel) -> None:
    clips = tiny_model.types["walking"].reference_clips
    longest = max(clips, key=len)
    fps = len(longest) / ENTRY.few_seconds  # it lasts as long as all may
    assert few_clips((longest, *clips), fps) == (longest,)
    assert few_clips((longest,), fps / 2.0) == (longest,)
    assert few_clips((), 60.0) == ()
    recordings = RecordingChoice(with_clips(tiny_model, {"walking": [longest] * 40}), few=True)
    assert len(recordings.clips("")) == 0
    assert 0 < len(recordings.clips("walking")) < 40


def test_a_body_that_goes_on_after_a_stop_does_not_drop() -> None:
    """By 8 cm it did before the first foot followed."""
    line = np.array([[0.0, 0.0], [0.0, 200.0]])
    parts = [
        PathPart(line, "walking", 130.0, stop=1.5),
        PathPart(np.array([[0.0, 500.0]]), "walking", 130.0),
    ]
    followed = follow_path(load_bundled_model(), make_path(parts), SynthesisOptions(seed=3))
    heights = followed.motion.root_positions[:, 1]
    way = np.linalg.norm(np.diff(followed.motion.root_positions[:, [0, 2]], axis=0), axis=1) * 60.0
    stands = np.flatnonzero(way < 15.0)
    before, after = heights[: stands[0]], heights[stands[-1] : stands[-1] + 120]
    assert after.min() > before.min() - 3.0


def test_a_live_body_that_begins_to_walk_does_not_drop() -> None:
    model = load_bundled_model()
    driver = Driver(model, "idle")
    stream = CharacterStream(model, seed=5)
    stream.reset(0, type="idle")
    heights = []
    for frame in range(300):
        driver.set_wish(Wish((0.0, 130.0 if frame >= 90 else 0.0)))
        heights.append(float(stream.step(driver(frame, stream.ground)).positions[0, HIPS, 1]))
    assert min(heights[90:200]) > min(heights[200:]) - 3.0


def test_the_foot_that_bears_the_body_stays_down() -> None:
    """A recording entered in the middle of a step lifted it by up to 7 cm in a quarter of the starts."""
    model, speeds, choices = load_bundled_model(), (80.0, 120.0, 160.0), (0, 1, 2, 5)
    wishes = [(choice, speed) for choice in choices for speed in speeds]
    stream, drivers = CharacterStream(model, len(wishes), seed=40), []
    for choice, speed in wishes:
        drivers.append(Driver(model, choice=choice))
        drivers[-1].set_wish(Wish((0.0, speed)))
    toes, touching = [], []
    for frame in range(90):
        ground = stream.ground
        shown = stream.step(together([d(frame, ground[i : i + 1]) for i, d in enumerate(drivers)]))
        toes.append(shown.positions[:, list(TOES), 1])
        touching.append(shown.contacts[:, 1::2] > 0.9)
    above = np.array(toes) - np.quantile(toes, 0.05, axis=(0, 2))[:, None]
    lifts = np.where(touching, above, 0.0).max(axis=(0, 2))
    assert lifts.max() < 4.0, lifts.round(1).tolist()
