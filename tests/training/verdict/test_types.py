from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from motionkit.data.dataset import Dataset
from motionkit.metrics.body import Body
from motionkit.models.model import MotionModel
from motionkit.training.verdict.judge import Judge
from motionkit.training.verdict.real import RealMotion
from motionkit.training.verdict.types import (
    QUICK_TYPES,
    TypeVerdict,
    quick_verdicts,
    reasons_of,
    verdict_page,
    verdict_table,
)

pytestmark = pytest.mark.thorough


@pytest.fixture(autouse=True)
def short_paths(monkeypatch: pytest.MonkeyPatch) -> None:
    """A model that hardly moves takes long for a path."""
    monkeypatch.setattr("motionkit.training.verdict.types.WALK_RADIUS", 0.5)
    monkeypatch.setattr("motionkit.training.verdict.types.RUN_RADIUS", 1.0)


GOOD = TypeVerdict("walk", 9, 40.0, 8, 8, 1.0, 0.4, 1.0, 0.6)


def test_a_model_that_hardly_moves_is_told_so(tiny_model: MotionModel, dataset: Dataset) -> None:
    settings = replace(QUICK_TYPES, seeds=1, repeats=1, accuracy_seconds=2.0)
    verdicts = quick_verdicts(tiny_model, Judge(RealMotion(dataset)), settings)
    assert {v.type for v in verdicts} <= set(tiny_model.types) and len(verdicts) > 2
    bad = [v for v in verdicts if not v.works]
    assert bad and all(v.reasons and v.type in v.sentence() for v in bad)
    assert all(v.rollouts == 1 and v.clips >= 1 and v.seconds > 0.0 for v in verdicts)


def test_a_type_without_training_clips_is_not_passed_over(tiny_model: MotionModel, dataset: Dataset) -> None:
    real = RealMotion(dataset)
    real.stretches = [stretch for stretch in real.stretches if stretch.type != "cartwheel"]
    settings = replace(QUICK_TYPES, seeds=1, repeats=1, accuracy_seconds=2.0)
    found = {v.type: v for v in quick_verdicts(tiny_model, Judge(real), settings)}
    assert list(found) == [name for name in tiny_model.types if name in real.types]
    longest = real.longest["cartwheel"]
    assert longest > 1.0 and f"too short: at most {longest:.1f} s, and 0.4 s" in found["cartwheel"].sentence()
    del real.longest["cartwheel"]
    found = {v.type: v for v in quick_verdicts(tiny_model, Judge(real), settings)}
    assert found["cartwheel"].sentence() == "cartwheel does not work: there are no clips to learn from"


@pytest.mark.parametrize(("speed", "reason"), [(0.69, "0.69"), (0.7, ""), (1.4, ""), (1.41, "1.4")])
def test_a_type_must_move_as_much_in_the_mean_as_its_clips(
    tiny_model: MotionModel, dataset: Dataset, speed: float, reason: str
) -> None:
    """Even where every roll-out is as slow as the calmest clips are."""
    reasons = reasons_of(replace(GOOD, joint_speed=speed), Judge(RealMotion(dataset)), [])
    assert reasons == ((f"it moves {reason} times as much as the clips",) if reason else ())


@pytest.mark.parametrize(
    ("path", "reason"),
    [(0.9, ""), (1.2, "1.2 cm from its path, expected at most 1"), (math.inf, "to its end")],
)
def test_a_gait_follows_a_path_to_its_end(dataset: Dataset, path: float, reason: str) -> None:
    reasons = reasons_of(replace(GOOD, path=path), Judge(RealMotion(dataset)), [])
    assert len(reasons) == bool(reason) and all(reason in each for each in reasons)


@pytest.mark.parametrize(("shown", "works"), [(8, True), (7, True), (6, False)])
def test_one_roll_out_of_eight_may_miss(dataset: Dataset, shown: int, works: bool) -> None:
    judge = Judge(RealMotion(dataset))
    bodies = [judge.real.of_type("walking")[0].body]
    assert (reasons_of(replace(GOOD, type="walking", shown=shown), judge, bodies) == ()) == works


@pytest.mark.parametrize(("most", "reasons"), [(1.3, 1), (1.6, 0)])
def test_feet_may_slide_as_much_as_in_one_of_the_clips(dataset: Dataset, most: float, reasons: int) -> None:
    verdict = replace(GOOD, sliding=1.5, sliding_target=most)
    assert len(reasons_of(verdict, Judge(RealMotion(dataset)), [])) == reasons


def test_a_stand_before_a_performance_is_not_taken_for_it(dataset: Dataset) -> None:
    """Even where standing is within what the clips show."""
    judge = Judge(RealMotion(dataset), by_recordings=True)
    kind = next(k for k in judge.real.types if (p := judge.real.profile(k)) is not None and p.performance)
    body = judge.real.of_type(kind, "train")[0].body
    still = [np.repeat(x[:1], 90, axis=0) for x in (body.rotations, body.positions, body.heading)]
    parts = (body.rotations, body.positions, body.heading)
    both = Body(*(np.concatenate([x, y]) for x, y in zip(still, parts, strict=True)), body.fps)
    assert judge.nearest_part(kind, both).joint_speed() > 0.5 * body.joint_speed()


@pytest.mark.parametrize(
    ("changes", "works"), [({}, True), ({"reasons": ("shown in 3 of 8 roll-outs",)}, False)]
)
def test_a_verdict_is_plain(changes: dict, works: bool) -> None:
    verdict = replace(GOOD, **changes)
    assert verdict.works == works
    assert verdict.sentence() == (
        "walk works: shown in 8 of 8 roll-outs" if works else "walk does not work: shown in 3 of 8 roll-outs"
    )
    row = verdict_table([verdict]).rows[0]
    assert row[:3] == ("walk", "works" if works else "does not work", "8 of 8")
    page = verdict_page([verdict, GOOD], QUICK_TYPES)
    assert "\n# Which types work\n" in page and f"- {verdict.sentence()}\n" in page
    assert f"{1 + works} of 2 types work" in page and "8 roll-outs of 6 s" in page
    assert not any(word in page for word in ("Scoreboard", "split", "mixed_seconds", "Targets", "measured"))
