"""Plans say once what a character does: in time, along a path, and with keys."""

from __future__ import annotations

import numpy as np
import pytest

from motionkit.control.keys import Key
from motionkit.control.path import PathPart, make_path
from motionkit.control.plan import StandingSpan, plan_keys, plan_path, plan_types
from motionkit.control.script import TypePart
from motionkit.errors import ControlError
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind


def test_segments_cover_the_track(tiny_model: MotionModel) -> None:
    kinds = ("running", "cartwheel", "idle")
    plan = plan_types(tiny_model, [TypePart(kind, 3.0) for kind in kinds])
    assert plan.segments[0].first == 0 and len(plan.weights) == len(plan.track)
    for segment in plan.segments:
        rows = plan.track[segment.first : segment.first + segment.count]
        assert len(rows) == segment.count and (rows == tiny_model.type_id(segment.type)).all()
    assert sum(segment.count for segment in plan.segments) == len(plan.track)
    assert plan.seconds == pytest.approx(9.0) == len(plan.track) / tiny_model.fps
    wheel = plan.segments[1].seconds / tiny_model.phase_seconds("cartwheel")
    assert wheel == pytest.approx(1.0, abs=0.02), "a performance is shown whole"


def test_bodies_settle_where_they_stand_after_another_type(tiny_model: MotionModel) -> None:
    kinds = ("idle", "running", "idle", "idle", "walking", "idle")
    plan = plan_types(tiny_model, [TypePart(kind, 1.0) for kind in kinds])
    assert [segment.stops for segment in plan.segments] == [False, False, True, False, False, True]
    assert plan.standing_spans == [StandingSpan("idle", 120, 240), StandingSpan("idle", 300, None)]
    bare = plan_types(tiny_model.with_reference("none"), [TypePart("running", 1.0), TypePart("idle", 1.0)])
    assert bare.standing_spans == [], "without recordings nothing has to be moved to a stance"


def test_the_segments_of_a_path_lie_along_it(tiny_model: MotionModel) -> None:
    line = np.array([[0.0, 0.0], [0.0, 300.0]])
    path = make_path([PathPart(line, "walking", 100.0, stop=1.5), PathPart(line[1:] * 2.0, "running", 250.0)])
    plan = plan_path(tiny_model, path)
    assert plan.route is not None and len(plan.track) == len(path.points) == len(plan.route.speeds)
    for number, segment in enumerate(plan.segments):
        rows = path.part[segment.first : segment.first + segment.count]
        assert (rows == number).all() and segment.type == path.parts[number].type
    assert plan.seconds == pytest.approx(sum(segment.seconds for segment in plan.segments), rel=1e-4)


def test_keys_lie_within_the_plan(tiny_model: MotionModel) -> None:
    plan = plan_types(tiny_model, [TypePart("walking", 2.0)])
    keys = (Key(1.0, position=np.zeros(2)),)
    assert plan_keys(plan, keys).keys == keys and plan.keys == ()
    with pytest.raises(ControlError, match="the motion lasts 2 s"):
        plan_keys(plan, (Key(2.5, facing=0.0),))


def test_what_types_are(tiny_model: MotionModel) -> None:
    found = {name: tiny_model.kind(name) for name in ("walking", "idle", "cartwheel", "unknown")}
    kinds = (MotionKind.GAIT, MotionKind.STANCE, MotionKind.PERFORMANCE, MotionKind.FREE)
    assert tuple(found.values()) == kinds
    assert [kind.steered for kind in kinds] == [True, True, False, False]
    alone = tiny_model.with_reference("none")
    assert alone.kind("walking") is MotionKind.GAIT and alone.kind("idle") is MotionKind.STANCE
    assert alone.kind("cartwheel").phased, "its length is known without recordings"
