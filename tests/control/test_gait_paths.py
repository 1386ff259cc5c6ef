"""Stays in gaits: one speed, a way that the body is led back to, and the step that a performance begins with."""

from __future__ import annotations

import numpy as np
import pytest

from motionkit.control.momentum import at_speed
from motionkit.control.plan import plan_types
from motionkit.control.planned_controls import FAR, GaitPaths, integrated_path
from motionkit.control.recording_choice import GAIT, LEADING, RecordingChoice
from motionkit.control.script import TypePart
from motionkit.control.synthesize import SynthesisOptions, synthesize
from motionkit.features.control import TRAJECTORY_OFFSETS, Controls, straight_trajectory
from motionkit.models.bundled import load_bundled_model
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import ReferenceClip

LAST = slice(2 * len(TRAJECTORY_OFFSETS) - 2, 2 * len(TRAJECTORY_OFFSETS))


@pytest.fixture(scope="module")
def model() -> MotionModel:
    return load_bundled_model()


def straight(speed: float, frames: int = 60) -> Controls:
    """Controls that ask one character to walk straight on at a speed in cm/s."""
    asked = Controls.of_types(np.ones((frames, 1, 1), np.float32))
    asked.trajectory[:] = straight_trajectory((0.0, speed), 60.0)
    return asked.with_mask(1.0)


def test_the_way_is_what_trajectories_add_up_to() -> None:
    path = integrated_path(straight(120.0).trajectory[:, 0])
    assert np.allclose(path[:, 1], 2.0 * np.arange(60), atol=1e-4) and not path[:, [0, 2]].any()


@pytest.mark.parametrize(("behind", "made_up"), [(0.0, 0.0), (5.0, 5.0), (300.0, FAR)])
def test_a_body_that_falls_behind_is_led_back(tiny_model: MotionModel, behind: float, made_up: float) -> None:
    """As far as FAR; it never runs after a way that it lost."""
    plan = plan_types(tiny_model, [TypePart("walking", 1.0)])
    planned = straight(120.0)
    paths = GaitPaths(tiny_model, [plan], planned)
    place = np.array([[30.0, 40.0, 0.5]])
    first = paths.corrected(planned.at(0), 0, place)
    assert np.allclose(first.trajectory, planned.trajectory[0], atol=1e-4)
    gone = 20.0 - behind
    here = place + np.array([[gone * np.sin(0.5), gone * np.cos(0.5), 0.0]])
    ahead = paths.corrected(planned.at(10), 10, here).trajectory[0, LAST] - planned.trajectory[10, 0, LAST]
    assert ahead == pytest.approx([0.0, made_up], abs=1e-3)


def test_trajectories_get_the_speed_of_the_stay_within_limits() -> None:
    asked = straight(120.0).at((slice(None), 0))
    where = np.arange(60) >= 30
    found = at_speed(asked, 126.0, 60.0, where).trajectory[:, LAST][:, 1]
    assert found[:30] == pytest.approx(120.0) and found[30:] == pytest.approx(126.0)
    assert at_speed(asked, 300.0, 60.0, where).trajectory[-1, LAST][1] == pytest.approx(138.0)


@pytest.mark.parametrize("kind", ["walking", "running"])
def test_a_stay_in_a_gait_keeps_its_speed(model: MotionModel, kind: str) -> None:
    """Seeds differ in speed; one seed does not."""
    made = synthesize(model, [TypePart(kind, 6.0)], SynthesisOptions(count=8, seed=50))
    paths = [each.motion.root_positions[:, [0, 2]] for each in made.motions]
    speeds = [np.linalg.norm(path[60:] - path[:-60], axis=1) for path in paths]
    assert np.mean([each.std() / each.mean() for each in speeds]) < 0.08
    assert np.std([each.mean() for each in speeds]) > 10.0


def test_recordings_of_a_stay_have_its_speed(model: MotionModel) -> None:
    for choice in range(10):
        recordings = RecordingChoice(model, choice)
        found = recordings.entry("walking", None)
        assert found is not None
        near = found[0].poses[np.maximum(found[1] - np.arange(4), 0)]
        clip, at = recordings.entry("walking", near, within=True) or found
        end = recordings.leaves("walking", clip, at)
        gone = np.linalg.norm(clip.ground[end - 1, :2] - clip.ground[at, :2]) / (end - 1 - at) * model.fps
        assert gone == pytest.approx(recordings.pace, rel=GAIT.pace[1])


def test_a_run_ends_in_the_step_that_the_performance_begins_with(model: MotionModel) -> None:
    """Feet are nearer to those of the performance than at the end of most stretches, and it is that performance."""
    recordings = RecordingChoice(model)
    first = recordings.entry("running", None)
    assert first is not None
    found = recordings.leading("running", first[0].poses[np.zeros(4, int)], "handspring", 45)
    assert found is not None
    performed, _ = recordings.entry("handspring", first[0].poses[np.zeros(4, int)]) or (None, 0)
    assert performed is not None and performed.performed
    ahead = np.array(LEADING.ahead)

    def gap(clip: ReferenceClip, at: int) -> float:
        return float(np.square(clip.poses[at + 45 + ahead] - performed.poses[ahead]).sum())

    others = [gap(clip, 0) for clip in model.types["running"].reference_clips if len(clip) > 45 + ahead[-1]]
    assert gap(*found) < np.median(others)
