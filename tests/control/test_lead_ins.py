"""Performances are shown whole, from a stand or a run-up to a stand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motionkit.control.character_start import StartState
from motionkit.control.lead_ins import IDLE_BEFORE, LEAST_REST, RUN_UP, natural_seconds, with_lead_ins
from motionkit.control.plan import plan_types
from motionkit.control.script import TypePart
from motionkit.control.synthesize import synthesize
from motionkit.models.bundled import load_bundled_model
from motionkit.models.model import MotionModel
from motionkit.motion.kinematics import motion_kinematics


@pytest.fixture(scope="module")
def model() -> MotionModel:
    return load_bundled_model()


@pytest.mark.parametrize(
    ("asked", "kinds"),
    [
        (("backflip",), ("idle", "backflip", "idle")),
        (("handspring",), ("running", "handspring", "idle")),
        (("running", "handspring"), ("running", "handspring", "idle")),
        (("idle", "handspring", "walking"), ("idle", "running", "handspring", "walking")),
        (("kicking",), ("idle", "kicking")),
        (("walking", "idle"), ("walking", "idle")),
    ],
)
def test_what_leads_to_performances(
    model: MotionModel, asked: tuple[str, ...], kinds: tuple[str, ...]
) -> None:
    parts = [
        TypePart(kind, seconds or 2.0)
        for kind, seconds in zip(asked, natural_seconds(model, asked), strict=True)
    ]
    found = with_lead_ins(model, parts)
    assert tuple(part.type for part in found) == kinds
    assert sum(part.seconds for part in found) == pytest.approx(sum(part.seconds for part in parts), abs=0.02)
    for part in found:
        if part.type in ("backflip", "handspring"):
            assert part.seconds == pytest.approx(model.phase_seconds(part.type)), (
                "it is shown once, and whole"
            )


@pytest.mark.parametrize("seconds", np.arange(0.5, 12.0, 0.7).tolist())
def test_only_whole_performances_are_begun(model: MotionModel, seconds: float) -> None:
    found = with_lead_ins(model, [TypePart("handspring", seconds)])
    assert sum(part.seconds for part in found) == pytest.approx(seconds, abs=0.02)
    length = model.phase_seconds("handspring")
    if seconds < RUN_UP + length:
        assert found == [TypePart("handspring", pytest.approx(seconds, abs=0.02))]
        return
    assert all(p.seconds == pytest.approx(length) for p in found if p.type == "handspring")
    if seconds > RUN_UP + length + LEAST_REST:
        assert found[-1].type == "idle" and found[-1].seconds >= LEAST_REST - 1e-6
        assert found[-1].seconds < RUN_UP + length + LEAST_REST, "or there is time for another"


def test_a_clip_leads_to_a_performance_itself(model: MotionModel) -> None:
    part = [TypePart("handspring", 3.0)]
    runs = with_lead_ins(model, part, StartState(np.zeros((4, 24), np.float32), 0, 350.0))
    begun = with_lead_ins(model, part, StartState(np.zeros((4, 24), np.float32), 20, 0.0))
    assert [part.type for part in runs] == [part.type for part in begun] == ["handspring", "idle"]
    stands = with_lead_ins(model, part, StartState(np.zeros((4, 24), np.float32), 0, 0.0))
    assert stands[0] == TypePart("running", RUN_UP)


def test_models_that_cannot_stand_show_the_parts_as_they_are(model: MotionModel) -> None:
    parts = [TypePart("backflip", 4.0)]
    restless = replace(model, types={name: kind for name, kind in model.types.items() if name != "idle"})
    assert with_lead_ins(restless, parts) == with_lead_ins(model.with_reference("none"), parts) == parts


@pytest.mark.parametrize("kind", ["backflip", "handspring", "jumping-b"])
def test_motions_begin_and_end_upright(model: MotionModel, kind: str) -> None:
    (seconds,) = natural_seconds(model, [kind])
    assert seconds > IDLE_BEFORE + model.phase_seconds(kind) + LEAST_REST
    positions = motion_kinematics(synthesize(model, [TypePart(kind, seconds)]).motion)[1]
    for half in (positions[:30], positions[-30:]):
        trunk = half[:, 12] - half[:, 0]
        assert (trunk[:, 1] > 0.7 * np.linalg.norm(trunk, axis=1)).all() and (half[:, 0, 1] > 60.0).all()


@pytest.mark.parametrize("kind", ["cartwheel", "w-kicking", "side-somersault"])
def test_as_many_performances_as_fit_are_planned(model: MotionModel, kind: str) -> None:
    """Sums of seconds that are rounded down lose none of them."""
    for seconds in np.linspace(3.0, 30.0, 55):
        parts = with_lead_ins(model, [TypePart(kind, float(seconds))])
        meant, planned = (
            sum(part.seconds for part in each if part.type == kind)
            for each in (parts, plan_types(model, parts).parts)
        )
        assert planned > meant - 0.1
