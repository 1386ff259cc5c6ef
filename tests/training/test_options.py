"""Stages of a run, and options by name."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import fields

import pytest

from motionkit.training.options import GROUP_OF, GROUPS, Stage, TrainOptions, flat_options, with_changes
from motionkit.training.presets import STAGES, fine_tune_options, train_options
from motionkit.training.progress import Progress

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


def test_later_cycles_begin_at_the_peak_rate_in_the_last_stage() -> None:
    options = train_options("tptn", steps=400, cycles=2, warmup=0)
    at = Progress(options)
    rates = []
    for at.step in range(400):
        rates.append(at.rate)
    once = Progress(train_options("tptn", steps=200, warmup=0))
    for once.step in range(200):
        assert rates[once.step] == once.rate, "the first half is that of a run of one cycle"
        assert rates[200 + once.step] == pytest.approx(once.rate)
    assert options.at(0.2).losses.step_weight == 10.0, "stages are shares of the first cycle"
    assert options.at(0.5).sampler.controls.reference_dropout == 0.5


def test_what_is_asked_for_holds_in_all_stages() -> None:
    options = train_options("tptn", steps=1, share=0.1, step_weight=0.0)
    for x in (0.0, 0.5, 1.0):
        assert options.at(x).scheduled_sampling.share == 0.1 and options.at(x).losses.step_weight == 0.0
    assert options.at(1.0).sampler.balance == 0.9 > options.at(0.0).sampler.balance


def test_references_are_rare_until_late_in_a_run() -> None:
    options = train_options("tptn", steps=1)
    dropouts = [options.at(x).sampler.controls.reference_dropout for x in (0.0, 0.5, 0.79, 0.8, 1.0)]
    assert dropouts == [0.8, 0.8, 0.8, 0.5, 0.5]
    tuned = fine_tune_options("tptn", steps=1)
    assert tuned.at(0.0).sampler.controls.reference_dropout == 0.5
    asked = train_options("tptn", steps=1, reference_dropout=0.3)
    assert {asked.at(x).sampler.controls.reference_dropout for x in (0.0, 1.0)} == {0.3}


def test_the_papers_preset_trains_as_the_paper_does_from_a_model_too() -> None:
    alone = fine_tune_options("tptn-paper", steps=1)
    assert alone.optimizer == train_options("tptn-paper", steps=1).optimizer and alone.sampler.splices == 0
    with_budget = fine_tune_options("tptn-paper", steps=1, budget="medium")
    assert with_budget.optimizer == train_options("tptn-paper", steps=1, budget="medium").optimizer


def test_the_paper_has_no_stages() -> None:
    assert train_options("tptn-paper", steps=1).stages == ()


def test_stages_are_plain_values_in_a_checkpoint() -> None:
    options = train_options("tptn", steps=1)
    assert flat_options(options.to_dict())["stages"] == options.to_dict()["stages"]
    assert json.loads(json.dumps(options.to_dict()))["stages"][1]["changes"] == STAGES[1].changes


def test_an_unknown_option_of_a_stage() -> None:
    with pytest.raises(TypeError, match="speed"):
        TrainOptions(steps=1, stages=(Stage(0.0, {"speed": 1.0}),)).at(0.0)


@pytest.mark.parametrize(
    ("make", "changes", "splices"),
    [
        (train_options, {"steps": 9}, 2000),
        (train_options, {"steps": 9, "minutes": 0.1}, 2000),
        (train_options, {"minutes": 60.0}, 2000),
        (train_options, {"minutes": 3.0}, 200),
        (train_options, {"minutes": 3.0, "splices": 7}, 7),
        (fine_tune_options, {"minutes": 5.0}, 400),
        (fine_tune_options, {"minutes": 0.2}, 16),
        (fine_tune_options, {"minutes": 0.2, "splices": 7}, 7),
    ],
)
def test_short_runs_make_fewer_splices(
    make: Callable[..., TrainOptions], changes: dict, splices: int
) -> None:
    assert make("tptn", **changes).sampler.splices == splices


def test_every_option_has_one_name() -> None:
    names = Counter(option.name for kind in (TrainOptions, *GROUPS.values()) for option in fields(kind))
    assert not [name for name, count in names.items() if count > 1]
    assert {*GROUP_OF.values()} == {*GROUPS}


def test_changes_reach_groups_within_groups() -> None:
    before = TrainOptions(steps=3)
    after = with_changes(before, {"lead_share": 0.1, "window": 8, "batch": 2, "steps": None, "minutes": 1.0})
    assert after.sampler.controls.lead_share == 0.1 and after.sampler.window == 8
    assert (after.optimizer.batch, after.steps, after.minutes) == (2, None, 1.0)
    assert after.losses == before.losses
    assert after.sampler.controls.reference_dropout == before.sampler.controls.reference_dropout
    whole = with_changes(before, {"optimizer": after.optimizer, "sampler": after.sampler})
    assert (whole.optimizer, whole.sampler) == (after.optimizer, after.sampler)


def test_options_of_earlier_releases_get_the_names_of_today() -> None:
    now = flat_options(TrainOptions(steps=3).to_dict())
    assert {f"{group}.{name}" for name, group in GROUP_OF.items()} < {*now}
    grouped = {  # as in release 0.2
        "steps": 3, "batch": 16, "optimizer": {"rate": 1e-3},
        "sampler": {"window": 96, "trajectory_dropout": 0.5, "reference_dropout": 0.5, "reference_gaps": 0.25},
    }  # fmt: skip
    single = {"steps": 3, "batch": 16, "rate": 1e-3, "window": 96, "guide_dropout": 0.5, "lead_frames": 30}
    for earlier in (grouped, single):
        found = flat_options(earlier)
        assert len(found) > 5 and found.items() <= now.items()
