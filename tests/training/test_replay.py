"""CUDA graphs of a training step, rehearsed without a GPU: the graph here runs its work on the static inputs."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from motionkit.training import replay
from motionkit.training.options import Stage
from motionkit.training.replay import Replayed
from motionkit.training.trainer import train
from training.test_trainer import losses_of, same_weights


class FakeGraph:
    """Writes the results of its owner's work over those of the capture, as a replay does."""

    played = 0

    def __init__(self) -> None:
        self.owner: Any = sys._getframe(1).f_locals["self"]

    def replay(self) -> None:
        FakeGraph.played += 1
        for static, value in zip(self.owner._outputs, self.owner.work(*self.owner._inputs), strict=True):
            static.copy_(value)


captured_on: list[object] = []
numbers = itertools.count()


def new_stream(device: object = None) -> SimpleNamespace:
    return SimpleNamespace(wait_stream=lambda _: None, number=next(numbers))


@contextmanager
def capture(graph: FakeGraph, stream: object, capture_error_mode: str) -> Iterator[None]:
    """A capture that does the work, and takes back what it changed, because a GPU's does not do it."""
    captured_on.append(stream)
    before = [x.detach().clone() for x in graph.owner.state()]
    yield
    with torch.no_grad():
        for x, value in zip(graph.owner.state(), before, strict=True):
            x.copy_(value)


def fake_cuda() -> SimpleNamespace:
    streams = [new_stream()]  # the default one
    captured_on.clear()

    @contextmanager
    def entered(stream: object) -> Iterator[None]:
        streams.append(stream)
        yield
        streams.pop()

    return SimpleNamespace(
        CUDAGraph=FakeGraph,
        graph=capture,
        stream=entered,
        Stream=new_stream,
        default_stream=lambda _: streams[0],
        current_stream=lambda _: streams[-1],
        get_rng_state=lambda _: torch.get_rng_state(),
        set_rng_state=lambda state, _: torch.set_rng_state(state),
    )


@pytest.fixture
def graphs(monkeypatch: pytest.MonkeyPatch) -> None:
    FakeGraph.played = 0
    monkeypatch.setattr(replay, "cuda", fake_cuda())
    monkeypatch.setattr(replay, "_has_graphs", lambda _: True)


def test_a_replay_takes_new_inputs_and_overwrites_its_results(graphs: None) -> None:
    double = Replayed(lambda x: (2.0 * x,))
    first = double(torch.ones(3))[0]
    assert first.tolist() == [2.0] * 3
    second = double(torch.full((3,), 5.0))[0]
    assert second is first and first.tolist() == [10.0] * 3
    assert double(torch.ones(2))[0].tolist() == [2.0] * 2, "other shapes are another graph"


def test_calls_before_the_capture_do_not_count(graphs: None) -> None:
    total, made = torch.zeros(1), []

    def work(x: torch.Tensor) -> tuple[torch.Tensor, ...]:
        if not made:
            made.append(torch.zeros(1))
        total.add_(x)
        made[0].add_(x)
        return (total.clone(),)

    add = Replayed(work, lambda: [total, *made])
    for count in range(1, 4):
        assert float(add(torch.ones(1))[0]) == float(total) == float(made[0]) == count


def test_without_a_gpu_the_work_is_done() -> None:
    double = Replayed(lambda x: (2.0 * x,))
    assert double(torch.ones(3))[0] is not double(torch.ones(3))[0]


def test_a_run_by_graphs_is_the_same_run(
    dataset_folder: Path, tmp_path: Path, tiny_options, graphs: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Windows on predictions and steps are graphs of their own, and so are the steps of another stage."""
    stages = (Stage(0.0, {"share": 0.5}), Stage(0.5, {"step_weight": 20.0}))
    # A capture without a GPU does the work, and would draw dropout.
    config = {"input_dropout": 0.0, "deep_dropout": 0.0, "spatial_dropout": 0.0}
    options = tiny_options(steps=6, period=2, stages=stages, config=config)
    train(dataset_folder, tmp_path / "graphs.safetensors", options, device="cpu")
    assert FakeGraph.played == 6 + 3
    monkeypatch.setattr(replay, "_has_graphs", lambda _: False)
    train(dataset_folder, tmp_path / "plain.safetensors", options, device="cpu")
    assert losses_of(tmp_path / "graphs.safetensors") == losses_of(tmp_path / "plain.safetensors")
    assert same_weights(tmp_path / "graphs.safetensors", tmp_path / "plain.safetensors")


def test_graphs_that_run_together_share_no_stream(graphs: None) -> None:
    x, own = torch.ones(2), [new_stream(), new_stream()]
    for stream in own:
        with replay.cuda.stream(stream):
            Replayed(lambda x: (2.0 * x,))(x)
    assert captured_on == own
    Replayed(lambda x: (2.0 * x,))(x)
    Replayed(lambda x: (2.0 * x,))(x)
    *_, third, fourth = captured_on
    assert third != fourth and replay.cuda.default_stream(None) not in captured_on
