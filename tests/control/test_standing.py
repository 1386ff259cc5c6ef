"""Bodies that come to a stand: braking, no recordings meanwhile, then those about the stance that was found."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from model_changes import with_clips
from motionkit.arrays import Array
from motionkit.control.character_start import StartState
from motionkit.control.motion_index import STATE_FRAMES
from motionkit.control.plan import plan_types
from motionkit.control.planned_controls import CrowdController
from motionkit.control.script import TypePart
from motionkit.control.standing import BRAKING, STOPPING_FRAMES
from motionkit.features.control import Controls
from motionkit.features.reference import EMBEDDING_COUNT
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import ReferenceClip
from planned import controls_of

NEAR = np.zeros((len(STATE_FRAMES), EMBEDDING_COUNT), np.float32)


def standing_clip(mean: float, seed: int) -> ReferenceClip:
    """Somebody who stands and sways a little about a mean pose."""
    sway = 0.1 * np.random.default_rng(seed).standard_normal((330, EMBEDDING_COUNT))
    return ReferenceClip(
        (mean + sway).astype(np.float32), np.zeros((300, 3), np.float32), np.full(300, -1.0, np.float32)
    )


def going_clip(speed: float) -> ReferenceClip:
    """Somebody who goes straight on at a speed in cm/s."""
    ground = np.zeros((300, 3), np.float32)
    ground[:, 1] = np.arange(300) * speed / 60.0
    return ReferenceClip(np.zeros((330, EMBEDDING_COUNT), np.float32), ground, np.full(300, -1.0, np.float32))


def going_model(model: MotionModel, speed: float) -> MotionModel:
    clips = {"idle": [standing_clip(m, i) for i, m in enumerate((-1.0, 1.0))], "walking": [going_clip(speed)]}
    return with_clips(model, clips)


def embedding_of(model: MotionModel, features: Array) -> Array:
    return model.pose_embedding.of(features)


@dataclass
class Body:
    """A character whose last frame is always the same."""

    features: Array


def rolled(model: MotionModel, parts: list[TypePart], present: Array | None) -> list[Controls]:
    """The controls of every frame of one character whose last frame is always the same (276,)."""
    bodies = None if present is None else Body(present[None])
    controller = CrowdController(model, [plan_types(model, parts, StartState(NEAR))], bodies=bodies)
    frames = sum(round(part.seconds * 60) for part in parts)
    return [controller(frame, np.zeros((1, 3))) for frame in range(frames)]


def test_controls_stay_as_they_were_read(tiny_model: MotionModel) -> None:
    """A frame that is read twice is the same, and later stances change nothing that was read before."""
    model = going_model(tiny_model, 130.0)
    body = Body(model.types["idle"].start_poses[0].features[-1:])
    plan = plan_types(model, [TypePart("walking", 1.0), TypePart("idle", 4.0)], StartState(NEAR))
    controller = CrowdController(model, [plan], bodies=body)
    made = controller.controls.reference.copy()
    shown = [controller(frame, np.zeros((1, 3))).reference.copy() for frame in range(300)]
    again = [controller(frame, np.zeros((1, 3))).reference for frame in range(300)]
    assert np.array_equal(shown, again) and np.array_equal(controller.controls.reference, made)


@pytest.mark.parametrize(("speed", "brakes"), [(130.0, False), (300.0, True)])
def test_a_run_is_braked_and_a_walk_stops_by_itself(
    tiny_model: MotionModel, speed: float, brakes: bool
) -> None:
    model = going_model(tiny_model, speed)
    asked = controls_of(model, [TypePart("walking", 1.0), TypePart("idle", 4.0)], NEAR)
    assert (
        not asked.reference_gain[60 : 60 + STOPPING_FRAMES].any()
        and not asked.reference[60 : 60 + STOPPING_FRAMES].any()
    )
    assert asked.reference_gain[60 + STOPPING_FRAMES :].all()
    braked = float(asked.trajectory_mask[60:].sum()) / 60.0
    assert braked == pytest.approx(speed / BRAKING if brakes else 0.0, abs=0.1)


def test_recordings_are_shown_about_the_stance_that_was_found(tiny_model: MotionModel) -> None:
    model = going_model(tiny_model, 130.0)
    features = model.types["idle"].start_poses[0].features[-1]
    stance = embedding_of(model, features)
    near = [standing_clip(0.0, i) for i in range(2)]
    spread = float(np.linalg.norm(stance)) + 1.0
    wide = replace(near[1], poses=near[1].poses + np.float32(spread))
    model = with_clips(
        tiny_model,
        {"idle": [near[0], wide, replace(wide, poses=-wide.poses)], "walking": [going_clip(130.0)]},
    )
    parts = [TypePart("walking", 1.0), TypePart("idle", 2.0), TypePart("idle", 8.0), TypePart("walking", 1.0)]
    asked = rolled(model, parts, features)
    settled = [each.reference[0] for each in asked[60 + STOPPING_FRAMES : 660]]
    means = np.stack(settled).reshape(len(settled), -1, EMBEDDING_COUNT).mean(axis=(0, 1))
    assert np.abs(means - stance).max() < 0.1
    assert not any(each.reference_gain.any() for each in asked[60 : 60 + STOPPING_FRAMES])
    # The walk after it has its own poses.
    assert np.abs(asked[-1].reference).max() < 1e-6


def test_no_recordings_in_a_stance_unlike_all_that_are_recorded(tiny_model: MotionModel) -> None:
    model = going_model(tiny_model, 130.0)
    parts = [TypePart("walking", 1.0), TypePart("idle", 4.0)]
    far = model.types["idle"].start_poses[0].features[-1] + 50.0
    for present in (far, None):
        asked = rolled(model, parts, present)
        assert not any(each.reference_gain.any() or each.reference.any() for each in asked[60:])


def test_who_stands_from_the_beginning_is_shown_recordings_at_once(tiny_model: MotionModel) -> None:
    model = going_model(tiny_model, 130.0)
    asked = controls_of(model, [TypePart("idle", 1.0), TypePart("idle", 1.0)], NEAR)
    assert asked.reference_gain.all()
    bare = controls_of(model.with_reference("none"), [TypePart("walking", 1.0), TypePart("idle", 1.0)], NEAR)
    assert not bare.reference_gain.any()
