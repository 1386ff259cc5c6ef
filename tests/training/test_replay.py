"""CUDA graphs of a training step, rehearsed without a GPU: the graph here runs its work on the static inputs."""

from __future__ import annotations

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


@contextmanager
def nothing(_: object) -> Iterator[None]:
    yield


def fake_cuda() -> SimpleNamespace:
    stream = SimpleNamespace(wait_stream=lambda _: None)
    return SimpleNamespace(
        CUDAGraph=FakeGraph,
        graph=nothing,
        stream=nothing,
        Stream=lambda _: stream,
        current_stream=lambda _: stream,
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
