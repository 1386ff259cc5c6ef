"""The packed step, by numpy and by the compiled kernel, against the network itself."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from motionkit.errors import ModelError
from motionkit.inference.step import NetworkStep
from motionkit.inference.step_kernel import StepKernel
from motionkit.inference.step_weights import StepWeights, pack, why_not_packable
from motionkit.models.network import PartTransformer
from motionkit.models.presets import PRESETS, preset
from oracle.step import numpy_step

PACKED = [name for name in PRESETS if why_not_packable(preset(name)) is None]
WAYS = ["numpy", "kernel", "small"]
VARIANTS: list[dict] = [
    {"layer_controls": False},
    {"fusion": "none"},
    {"kernel": 1},
    {"kernel": 5},
    {"window": 4},
    {"window": 12},
    {"head_leak": 0.0},
    {"head_momentum": False},
    {"trajectory_skip": True},
    {"heads": 16, "width": 48},
]
# Weights in 16 bits are whole numbers up to 32767 times a scale.
TOLERANCE = {"numpy": 1e-5, "kernel": 1e-5, "small": 2e-4}


def stepper(weights: StepWeights, way: str, batch: int) -> NetworkStep:
    if way == "numpy":
        return numpy_step(weights, batch)
    return NetworkStep(StepKernel(weights, small=way == "small"), batch)


def largest_difference(network: PartTransformer, inputs: tuple, way: str) -> float:
    """Between one frame at a time and all at once, over all outputs."""
    with torch.no_grad():
        if network.momentum is not None:  # zero at the start
            network.momentum.normal_(generator=torch.Generator().manual_seed(4))
        whole = network(*inputs)
    step = stepper(pack(network.weights()), way, len(inputs[0]))
    worst = 0.0
    for t in range(inputs[0].shape[1]):
        step.step(*(v[:, t].numpy() for v in inputs))
        for ours, theirs in (
            (step.mean, whole.mean),
            (step.log_sigma, whole.log_sigma),
            (step.contact_logits, whole.contact_logits),
        ):
            worst = max(worst, float(np.abs(ours - theirs[:, t].numpy()).max()))
    return worst


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", PACKED)
def test_steps_equal_the_batch_forward(
    make_network: Callable, make_inputs: Callable, name: str, way: str
) -> None:
    frames = 1000 if name == "tiny" else 100
    assert largest_difference(make_network(preset(name)), make_inputs(1, frames), way) < TOLERANCE[way]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("change", VARIANTS, ids=lambda change: "-".join(map(str, change)))
def test_variants(make_network: Callable, make_inputs: Callable, change: dict, way: str) -> None:
    network = make_network(preset("tiny", **change))
    assert largest_difference(network, make_inputs(3, 40), way) < TOLERANCE[way]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("frames", [1, 3, 12])
def test_a_character_starts_anew_while_others_go_on(
    make_network: Callable, make_inputs: Callable, frames: int, way: str
) -> None:
    network = make_network(preset("tiny"))
    weights = pack(network.weights())
    inputs, own = make_inputs(3, 30), make_inputs(1, 30, seed=1)
    step = stepper(weights, way, 3)
    with torch.no_grad():
        whole, alone = network(*inputs).mean.numpy(), network(*own).mean.numpy()
    for t in range(30):
        if t == 11:
            fresh = step.alone()
            for u in range(frames):
                fresh.step(*(v[:, u].numpy() for v in own))
            step.adopt(1, fresh)
        frame = [v[:, t].numpy().copy() for v in inputs]
        age = t - 11 + frames  # of character 1 since it was started anew
        if 11 <= t and age < 30:
            for value, new in zip(frame, own, strict=True):
                value[1] = new[0, age]
        step.step(*frame)
        assert np.abs(step.mean[[0, 2]] - whole[[0, 2], t]).max() < TOLERANCE[way]
        if 11 <= t and age < 30:
            assert np.abs(step.mean[1] - alone[0, age]).max() < TOLERANCE[way]


@pytest.mark.parametrize("way", WAYS)
def test_reset_forgets_everything(make_network: Callable, make_inputs: Callable, way: str) -> None:
    weights = pack(make_network(preset("tiny")).weights())
    used, fresh = stepper(weights, way, 1), stepper(weights, way, 1)
    first, other = make_inputs(1, 12), make_inputs(1, 13, seed=5)
    for t in range(13):
        used.step(*(v[:, t].numpy() for v in other))
    used.reset()
    for t in range(12):
        for step in (used, fresh):
            step.step(*(v[:, t].numpy() for v in first))
        assert np.abs(used.mean - fresh.mean).max() < 1e-6


@pytest.mark.parametrize(
    ("change", "reason"),
    [({"position": "sinusoidal"}, "computed anew"), ({"norm": "post"}, "norm='post'")],
)
def test_what_cannot_be_packed_says_why(make_network: Callable, change: dict, reason: str) -> None:
    with pytest.raises(ModelError, match=reason):
        pack(make_network(preset("tiny", **change)).weights())


def test_memory_per_character_is_that_of_the_rings(make_network: Callable) -> None:
    step = NetworkStep(StepKernel(pack(make_network(preset("tptn")).weights())), 3)
    rings = 2 * 2 * 2 * 6 * 8 * 128  # keys and values, modules, parts, layers, window, width
    assert step.bytes_per_character == 4 * (rings + 3 * 281 + 276)
