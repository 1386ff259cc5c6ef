"""Roll-outs of the scoreboard are those of the commands."""

from __future__ import annotations

import numpy as np
import pytest

from motionkit.control.drive import Driver, Wish
from motionkit.control.follow import follow_path
from motionkit.control.path import shape_path
from motionkit.control.script import TypePart
from motionkit.control.synthesize import SynthesisOptions, synthesize
from motionkit.data.workers import worker_processes
from motionkit.errors import ControlError
from motionkit.lab.scoreboard.settings import EvaluationSettings
from motionkit.models.model import MotionModel
from motionkit.training.verdict.rolling import Driven, Plan, roll_live, roll_paths, roll_plans


def test_plans_are_rolled_out_as_synthesize_does(tiny_model: MotionModel) -> None:
    parts = (TypePart("idle", 0.2), TypePart("walking", 0.4))
    plans = [Plan(parts, 1000), Plan(parts, 1001), Plan((TypePart("cartwheel", 0.3),), 1000)]
    found = roll_plans(tiny_model, plans)
    for plan, take in zip(plans, found, strict=True):
        alone = synthesize(tiny_model, plan.parts, SynthesisOptions(1, plan.seed)).motion
        raw = synthesize(tiny_model, plan.parts, SynthesisOptions(1, plan.seed, ik=False)).motion
        assert np.array_equal(take.default.rotations, alone.local_rotations)
        assert np.array_equal(take.raw.rotations, raw.local_rotations)
        assert np.array_equal(take.raw.positions[:, 0], raw.root_positions)


def test_processes_change_nothing(tiny_model: MotionModel) -> None:
    plans = [Plan((TypePart(kind, 0.2),), seed) for kind in ("idle", "walking") for seed in (0, 1)]
    here = roll_plans(tiny_model, plans)
    with worker_processes(2) as each:
        there = roll_plans(tiny_model, plans, each=each)
    for a, b in zip(here, there, strict=True):
        assert np.array_equal(a.default.positions, b.default.positions)


def test_paths_are_followed_as_follow_path_does(
    tiny_model: MotionModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("motionkit.control.follow.PATIENCE", -0.3)  # leaves less than 3 s
    path = shape_path("line", 1.0, ["walking"], None)
    (walk,) = roll_paths(tiny_model, [(path, 1003)])
    alone = follow_path(tiny_model, path, SynthesisOptions(seed=1003))
    assert np.array_equal(walk.take.default.rotations, alone.motion.local_rotations)
    assert walk.finished == alone.finished and walk.part_frames == alone.part_frames


def test_live_characters_get_their_own_wishes(tiny_model: MotionModel) -> None:
    heard = []

    def steer(frame: int, driver: Driver) -> None:
        heard.append(frame)
        driver.set_wish(Wish((0.0, 100.0)))

    takes = roll_live(tiny_model, [Driven("walking", steer), Driven("idle", lambda frame, driver: None)], 12)
    assert heard == [*range(12), *range(12)], "once with feet locked, once without"
    assert [len(take.default) for take in takes] == [12, 12]
    assert not np.allclose(takes[0].default.positions[-1], takes[1].default.positions[-1])


def test_seeds_belong_to_one_split() -> None:
    assert EvaluationSettings().first_seed == 1000
    assert EvaluationSettings(split="validation").first_seed == 0
    assert EvaluationSettings(split="validation", seed=400).as_dict()["seed"] == 400
    for split, seed in (("test", 999), ("validation", 1000), ("validation", 501), ("validation", -1)):
        with pytest.raises(ControlError, match=f"does not belong to the {split} split"):
            EvaluationSettings(split=split, seed=seed)
    with pytest.raises(ControlError, match="does not belong"):
        EvaluationSettings(split="validation", seeds=501)
    with pytest.raises(ControlError, match="unknown split 'train'"):
        EvaluationSettings(split="train")
