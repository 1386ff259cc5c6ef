"""Stages of a run, and options by name."""

from __future__ import annotations

import json

import pytest

from motionkit.training.options import Stage, TrainOptions, flat_options
from motionkit.training.presets import STAGES, train_options

TWO = (Stage(0.0, {"share": 0.0}), Stage(0.5, {"share": 0.3, "step_weight": 7.0}))


def test_a_stage_holds_from_where_it_begins() -> None:
    options = TrainOptions(steps=10, stages=TWO)
    assert [options.at(x).scheduled_sampling.share for x in (0.0, 0.49, 0.5, 1.0)] == [0.0, 0.0, 0.3, 0.3]
    assert [options.at(x).losses.step_weight for x in (0.0, 0.5)] == [0.0, 7.0]
    assert options.at(0.7).sampler == options.sampler


def test_a_run_from_a_model_is_in_the_last_stage() -> None:
    options = TrainOptions(steps=10, stages=TWO, init="bundled")
    assert options.at(0.0) == options.at(1.0)
    assert options.at(0.0).losses.step_weight == 7.0


def test_what_is_asked_for_holds_in_all_stages() -> None:
    options = train_options("tptn", steps=1, share=0.1, step_weight=0.0)
    for x in (0.0, 0.5, 1.0):
        assert options.at(x).scheduled_sampling.share == 0.1 and options.at(x).losses.step_weight == 0.0
    assert options.at(1.0).sampler.balance == STAGES[-1].changes["balance"]


def test_the_paper_has_no_stages() -> None:
    assert train_options("tptn-paper", steps=1).stages == ()


def test_stages_are_plain_values_in_a_checkpoint() -> None:
    options = train_options("tptn", steps=1)
    assert flat_options(options.to_dict())["stages"] == options.to_dict()["stages"]
    assert json.loads(json.dumps(options.to_dict()))["stages"][1]["changes"] == STAGES[1].changes


def test_an_unknown_option_of_a_stage() -> None:
    with pytest.raises(TypeError, match="speed"):
        TrainOptions(steps=1, stages=(Stage(0.0, {"speed": 1.0}),)).at(0.0)
