from __future__ import annotations

import pytest
import torch

from motionkit.models.network import NetworkStream
from motionkit.models.presets import PRESETS, preset

pytestmark = pytest.mark.thorough

FIELDS = ("mean", "log_sigma", "trajectory_mean", "trajectory_log_sigma", "contact_logits")
STREAMED = [name for name in PRESETS if preset(name).variant.position == "bias"]


def largest_difference(network, inputs) -> float:
    """Between one frame at a time and all at once, over all outputs."""
    with torch.no_grad():
        whole = network(*inputs)
    stream = NetworkStream(network, inputs[0].shape[0])
    worst = 0.0
    for t in range(inputs[0].shape[1]):
        one = stream.step(*(v[:, t] for v in inputs))
        for field in FIELDS:
            worst = max(worst, float((getattr(one, field) - getattr(whole, field)[:, t]).abs().max()))
    return worst


@pytest.mark.parametrize("name", STREAMED)
def test_streaming_equals_the_batch_forward(make_network, make_inputs, name: str) -> None:
    frames = 1000 if name == "tiny" else 200
    assert largest_difference(make_network(preset(name)), make_inputs(2, frames)) < 1e-5


@pytest.mark.parametrize(
    "change",
    [
        {"norm": "post"},
        {"layer_controls": False},
        {"fusion": "none"},
        {"kernel": 1},
        {"kernel": 5},
        {"window": 4},
        {"window": 12},
        {"head_leak": 0.0},
        {"trajectory_skip": True},
    ],
)
def test_streaming_equals_the_batch_forward_for_variants(make_network, make_inputs, change: dict) -> None:
    network = make_network(preset("tiny", **change))
    assert largest_difference(network, make_inputs(1, 60)) < 1e-5


def test_sinusoidal_streaming_is_the_forward_over_the_last_receptive_field(make_network, make_inputs) -> None:
    """Absolute positions count from the start of what is seen: the paper's window of 87 frames."""
    network = make_network(preset("tptn-paper"))
    x, contacts, controls = make_inputs(1, 200)
    stream = NetworkStream(network, 1)
    field = network.config.receptive_field
    assert field == 87
    checked = {0, 1, 50, 86, 87, 120, 199}
    for t in range(200):
        one = stream.step(x[:, t], contacts[:, t], controls[:, t])
        if t in checked:
            seen = slice(max(0, t + 1 - field), t + 1)
            with torch.no_grad():
                whole = network(x[:, seen], contacts[:, seen], controls[:, seen])
            for name in FIELDS:
                difference = getattr(one, name) - getattr(whole, name)[:, -1]
                assert difference.abs().max() < 1e-5, (t, name)


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"fusion": "cross-attention"},
        {"backbone": "non-local", "norm": "post", "layer_controls": False},
        {"backbone": "lstm", "norm": "post", "layer_controls": False},
        {"window": 4},
        {"kernel": 1},
        {"head_momentum": True},
        {"trajectory_skip": True},
    ],
)
@pytest.mark.parametrize("frames", [1, 2, 30])
def test_the_last_prediction_alone_is_that_of_the_forward(
    make_network, make_inputs, change: dict, frames: int
) -> None:
    network = make_network(preset("tiny", position="sinusoidal", **change))
    inputs = make_inputs(2, frames)
    with torch.no_grad():
        whole, last = network(*inputs), network.predict_last(*inputs)
    for name in (*FIELDS, "shallow", "deep"):
        torch.testing.assert_close(getattr(last, name), getattr(whole, name)[..., -1, :], rtol=0, atol=1e-5)


@pytest.mark.parametrize("name", ["tiny", "tptn-paper"])
def test_reset_forgets_everything(make_network, make_inputs, name: str) -> None:
    network = make_network(preset(name))
    first, other = make_inputs(1, 12), make_inputs(1, 12, seed=5)
    fresh, used = NetworkStream(network, 1), NetworkStream(network, 1)
    for t in range(12):
        used.step(*(v[:, t] for v in other))
    used.reset()
    for t in range(12):
        a, b = (s.step(*(v[:, t] for v in first)) for s in (fresh, used))
        assert torch.equal(a.mean, b.mean)
