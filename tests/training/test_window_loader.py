"""Windows that other processes make are those that the sampler makes."""

from __future__ import annotations

from dataclasses import replace

import torch

from motionkit.data.dataset import Dataset
from motionkit.models.batch import Batch
from motionkit.training.presets import train_options
from motionkit.training.sampler import WindowSampler
from motionkit.training.window_loader import StepLoader


def same(a: Batch, b: Batch) -> bool:
    return all(torch.equal(x, y) for x, y in zip(vars(a).values(), vars(b).values(), strict=True))


def test_batches_are_those_of_the_sampler(dataset: Dataset) -> None:
    sampler = WindowSampler(dataset, train_options("tiny", steps=1, window=40, splices=2).sampler)
    sampler.make_splices()
    loader = StepLoader(lambda step: sampler.batch(step, 6, 2, 3))
    for step in (3, 4, 5, 6, 20, 21):
        assert same(loader.next(step), sampler.batch(step, 6, 2, 3)), step


def test_other_settings_hold_once_the_loader_was_closed(dataset: Dataset) -> None:
    sampler = WindowSampler(dataset, train_options("tiny", steps=1, window=40, splices=0).sampler)
    loader = StepLoader(lambda step: sampler.batch(step, 2))
    before = loader.next(0)
    sampler.use(replace(sampler.options, noise=0.5))
    loader.close()
    after = loader.next(1)
    assert same(after, sampler.batch(1, 2))
    assert float((after.inputs[:, 1:] - after.targets[:, :-1]).std()) > 0.4
    assert float((before.inputs[:, 1:] - before.targets[:, :-1]).std()) < 0.1


def test_the_random_state_of_the_run_stays(dataset: Dataset) -> None:
    sampler = WindowSampler(dataset, train_options("tiny", steps=1, window=40, splices=0).sampler)
    state = torch.get_rng_state()
    StepLoader(lambda step: sampler.batch(step, 2)).next(0)
    assert torch.equal(state, torch.get_rng_state())
