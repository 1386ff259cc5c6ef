"""Networks that are trained as one learn what each learns alone."""

from __future__ import annotations

import copy

import pytest
import torch

from motionkit.data.dataset import Dataset
from motionkit.features.control import ControlLayout
from motionkit.models.architectures import build
from motionkit.models.batch import Batch
from motionkit.models.presets import preset
from motionkit.training.learner import Learner, StackedLearner
from motionkit.training.objective import TrainingModule
from motionkit.training.presets import train_options
from motionkit.training.processes import Processes
from motionkit.training.progress import Progress
from motionkit.training.sampler import WindowSampler

SEEDS = 2
CPU = Processes(torch.device("cpu"))


@pytest.mark.parametrize(
    "config",
    [
        {},
        {"partition": "four-spine", "trajectory_skip": True},
        {"fusion": "cross-attention"},
        {"partition": "one", "position": "sinusoidal"},
        {"backbone": "non-local", "norm": "post", "layer_controls": False},
    ],
    ids=lambda config: "-".join(map(str, config.values())) or "tiny",
)
def test_each_seed_learns_as_it_does_alone(dataset: Dataset, config: dict) -> None:
    still = {"input_dropout": 0.0, "deep_dropout": 0.0, "spatial_dropout": 0.0}
    options = train_options(
        "tiny",
        steps=4,
        batch=2,
        window=20,
        splices=0,
        precision="float32",
        config=config | still,
        clip_norm=0.05,
    )
    settings = preset(options.preset, **options.config)
    layout = ControlLayout(dataset.types, settings.controls)
    modules, batches = [], []
    for seed in range(SEEDS):
        torch.manual_seed(seed)
        modules.append(TrainingModule(build(settings, layout.size), dataset, options.losses))
        sampler = WindowSampler(dataset, options.sampler, seed, (), layout.kind)
        batches.append([sampler.batch(step, 2) for step in range(3)])
    alone = []
    for module in copy.deepcopy(modules):
        learner = Learner(module.network, dataset, options, CPU)
        learner.module.load_state_dict(module.state_dict())
        alone.append(learner)
    stacked = StackedLearner(modules, options, CPU)
    at = Progress(options)
    for step in range(3):
        together = Batch(
            **{
                name: torch.stack([vars(each[step])[name] for each in batches])
                for name in vars(batches[0][0])
            }
        )
        found = stacked.step(together, options, at)
        for seed, learner in enumerate(alone):
            for name, value in learner.step(batches[seed][step], options, at).items():
                assert float(found[name][seed]) == pytest.approx(float(value), rel=2e-3, abs=1e-3), name
        at.step += 1
    for seed, average in enumerate(stacked.averages()):
        apart = torch.cat([(average[n] - alone[seed].average[n]).flatten() for n in average])
        # Parameters without influence, such as the keys' bias, follow the rounding of their gradient.
        assert float(apart.abs().quantile(0.99)) < 2e-5


def test_a_gradient_that_is_not_finite_leaves_the_other_seeds(dataset: Dataset) -> None:
    options = train_options("tiny", steps=4, batch=2, window=20, splices=0, precision="float32", warmup=1)
    layout = ControlLayout(dataset.types, "extended")
    modules = [
        TrainingModule(build(preset("tiny"), layout.size), dataset, options.losses) for _ in range(SEEDS)
    ]
    stacked = StackedLearner(modules, options, CPU)
    batch = WindowSampler(dataset, options.sampler, 0).batch(0, 2)
    both = Batch(**{name: torch.stack([value, value]) for name, value in vars(batch).items()})
    both.targets[0, 0, 0, 0] = torch.nan
    before = stacked.averages()
    found = stacked.step(both, options, Progress(options))
    assert not found["gradient"][0].isfinite() and found["gradient"][1].isfinite()
    moved = [
        max(float((a[n] - b[n]).abs().max()) for n in a)
        for a, b in zip(before, stacked.averages(), strict=True)
    ]
    assert moved[0] < 1e-4 < moved[1]  # the first only by the decay of its weights
