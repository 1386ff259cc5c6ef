"""Networks of an experiment that train in the same steps give the results of runs."""

from __future__ import annotations

import weakref
from dataclasses import replace

import pytest
from torch import Tensor

from lab.paper.test_runs import plan
from motionkit.lab.paper import together
from motionkit.lab.paper.runs import Plan, model_file, options_of, read_result, result_file, run_one
from motionkit.lab.paper.variants import variant
from motionkit.models.batch import Batch
from motionkit.models.checkpoint import load_model
from motionkit.training.progress import Progress

pytestmark = pytest.mark.thorough

__all__ = ["plan"]


@pytest.fixture
def small(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> Plan:
    from motionkit.lab.paper import runs

    monkeypatch.setattr(together, "options_of", runs.options_of)
    return plan


def test_all_networks_are_trained_and_tested(small: Plan) -> None:
    names, said = ("TPTN", "w/o-OS", "TP-LSTM4LR"), []
    tasks = [(variant(name), seed) for name in names for seed in (0, 1)]
    shares: list[float] = []
    made = together.train_all(small, tasks, said.append, shares.append)
    assert made == small and shares[-1] == 1.0 and shares == sorted(shares)
    assert said == ["3 networks with 2 seeds each, together"]
    for each, seed in tasks:
        assert load_model(model_file(small, each, seed)).config.architecture == "part-transformer"
        file = run_one(small, each, seed, said.append, lambda _: None, trained=True)
        result = read_result(file)
        assert file == result_file(small, each, seed) and result["budget"]["steps"] == 20
        assert result["curve"][-1][0] == 20 and result["held-out"]["nll"] is not None
    curves = {(each.name, seed): read_result(result_file(small, each, seed))["curve"] for each, seed in tasks}
    assert len({str(curve) for curve in curves.values()}) == len(tasks), "no two runs are the same"


def test_a_network_learns_about_as_much_as_alone(small: Plan) -> None:
    """Dropout differs, windows and first weights do not."""
    each = variant("TPTN")
    together.train_all(small, [(each, 0), (each, 1)], lambda _: None, lambda _: None)
    with_others = read_result(run_one(small, each, 0, lambda _: None, lambda _: None, trained=True))
    apart = replace(small, results=small.results / "apart", checkpoints=small.checkpoints / "apart")
    alone = read_result(run_one(apart, each, 0, lambda _: None, lambda _: None))
    assert with_others["curve"][0][1] == pytest.approx(alone["curve"][0][1], rel=0.2)
    assert with_others["held-out"]["nll"] == pytest.approx(alone["held-out"]["nll"], rel=0.1)


def test_minutes_end_all_at_one_step(small: Plan) -> None:
    tasks = [(variant(name), 0) for name in ("TPTN", "w/o-OS")]
    made = together.train_all(small, tasks, lambda _: None, lambda _: None, minutes=0.01)
    assert made.steps and made.folder.endswith(f"-{made.steps}")
    for each, seed in tasks:
        assert model_file(made, each, seed).exists()


def test_batches_stay_until_all_streams_have_read_them(small: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    """A GPU puts the next batch where an earlier one was freed, while other streams still copy it."""
    read: list[weakref.ref[Tensor]] = []
    step = together.Stack.step

    def reading(stack: together.Stack, batch: Batch, at: Progress, logs: bool) -> None:
        read.append(weakref.ref(batch.inputs))
        step(stack, batch, at, logs)

    monkeypatch.setattr(together.Stack, "step", reading)
    tasks = [(variant(name), 0) for name in ("TPTN", "w/o-OS")]
    alive: list[bool] = []
    together.train_all(
        small, tasks, lambda _: None, lambda _: alive.extend(x() is not None for x in read[-2:])
    )
    assert len(read) > 2 and alive and all(alive)


def test_floors_and_other_networks_come_after(small: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    order = []
    monkeypatch.setattr(
        together, "train_all", lambda plan, tasks, *_: order.append([v.name for v, _ in tasks])
    )
    monkeypatch.setattr(
        together, "side_by_side", lambda works, *_: order.append([name for name, _ in works]) or []
    )
    monkeypatch.setattr(
        together, "run_all", lambda plan, tasks, *_: order.append([v.name for v, _ in tasks]) or []
    )
    tasks = [(variant(name), 0) for name in ("last frame", "MVAE", "TPTN")]
    assert not list(together.run_together(small, tasks, 1, lambda _: None, lambda _: None))
    assert order == [["TPTN"], ["TPTN, seed 0"], ["last frame", "MVAE"]]
    assert options_of(small, variant("TPTN"), 0).steps == 20
