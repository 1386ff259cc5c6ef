"""Muon for the matrices within layers, AdamW for all else."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn

from motionkit.models.architectures import build
from motionkit.models.presets import preset
from motionkit.training.optimizer import (
    AS_ADAMW,
    MOMENTUM,
    POLYNOMIAL,
    REPETITIONS,
    Muon,
    make_optimizers,
    orthogonalized,
)
from motionkit.training.options import OptimizerOptions
from motionkit.training.presets import fine_tune_options, train_options


def _one(x: Tensor) -> Tensor:
    """The odd polynomial on the singular values of one matrix, which is what its repeated products come to."""
    u, s, vh = torch.linalg.svd(x.double(), full_matrices=False)
    s = s / (s.square().sum().sqrt() + 1e-7)
    for _ in range(REPETITIONS):
        s = sum(c * s**n for c, n in zip(POLYNOMIAL, (1, 3, 5), strict=True))
    return (u * s) @ vh


@pytest.mark.parametrize("shape", [(3, 8, 8), (2, 6, 20), (2, 20, 6)])
def test_matrices_keep_their_singular_vectors(shape: tuple[int, ...]) -> None:
    x = torch.randn(shape, generator=torch.Generator().manual_seed(1))
    found = orthogonalized(x)
    assert found.shape == x.shape and found.dtype == x.dtype
    for one, expected in zip(found, x, strict=True):
        torch.testing.assert_close(one.double(), _one(expected), atol=1e-4, rtol=1e-3)
    assert 0.5 < float(torch.linalg.svdvals(found)[:, :4].min())
    assert float(torch.linalg.svdvals(found).max()) < 1.3


def test_sixteen_bits_are_close() -> None:
    x = torch.randn((4, 32, 64), generator=torch.Generator().manual_seed(2))
    difference = (orthogonalized(x, bfloat16=True) - orthogonalized(x)).norm() / orthogonalized(x).norm()
    assert 0.0 < float(difference) < 0.05


def test_a_gradient_of_nothing_stays_nothing() -> None:
    assert torch.equal(orthogonalized(torch.zeros(1, 4, 4)), torch.zeros(1, 4, 4))


def test_a_step_is_that_of_each_matrix_alone() -> None:
    draw = torch.Generator().manual_seed(3)
    weights = {
        "qkv": ((2, 8, 24), 3),
        "wide": ((2, 8, 16), 1),
        "high": ((2, 16, 8), 1),
        "still": ((1, 4, 4), 1),
    }
    parameters = {
        name: nn.Parameter(torch.randn(shape, generator=draw)) for name, (shape, _) in weights.items()
    }
    expected = {name: p.detach().clone() for name, p in parameters.items()}
    momenta = {name: torch.zeros_like(p) for name, p in expected.items()}
    muon = Muon([(parameters[n], count) for n, (_, count) in weights.items()], 0.1, 0.01, bfloat16=False)
    for rate in (0.1, 0.05):
        muon.param_groups[0]["lr"] = rate
        for name, p in parameters.items():
            if name == "still":
                continue
            p.grad = torch.randn(p.shape, generator=draw)
            momenta[name] = MOMENTUM * momenta[name] + (1 - MOMENTUM) * p.grad
            ahead = (1 - MOMENTUM) * p.grad + MOMENTUM * momenta[name]
            for part in range(len(p)):
                for i, one in enumerate(ahead[part].chunk(weights[name][1], dim=-1)):
                    columns = slice(i * one.shape[1], (i + 1) * one.shape[1])
                    goal = expected[name][part][:, columns]
                    goal.mul_(1 - rate * 0.01).sub_(
                        rate * AS_ADAMW * max(one.shape) ** 0.5 * _one(one).float()
                    )
        muon.step()
    for name, p in parameters.items():
        torch.testing.assert_close(p.detach(), expected[name], atol=1e-4, rtol=1e-3)


@pytest.mark.parametrize("name", ["tptn", "tiny"])
def test_every_parameter_has_one_optimizer(name: str) -> None:
    network = build(preset(name), 30)
    adamw, muon = make_optimizers(
        dict(network.named_parameters()), network.layer_matrices(), OptimizerOptions(), False
    )
    found = [id(p) for each in (adamw, muon) for group in each.param_groups for p in group["params"]]
    assert sorted(found) == sorted(id(p) for p in network.parameters())
    names = {id(p): n for n, p in network.named_parameters()}
    matrices = {
        names[id(p)]: count for p, count in zip(muon.param_groups[0]["params"], muon.counts, strict=True)
    }
    assert matrices["shallow.layers.0.attention.qkv.weight"] == 3 and matrices["fusion.weight"] == 1
    assert not any(word in n for n in matrices for word in ("bias", "embed", "aggregate", "contact"))


def test_adamw_alone() -> None:
    network = build(preset("tiny"), 30)
    (adamw,) = make_optimizers(dict(network.named_parameters()), {}, OptimizerOptions(method="adamw"), False)
    assert len(adamw.param_groups[0]["params"]) == len(list(network.parameters()))


def test_networks_without_layers_of_parts() -> None:
    network = build(preset("pfnn"), 30)
    assert (
        len(
            make_optimizers(
                dict(network.named_parameters()), network.layer_matrices(), OptimizerOptions(), False
            )
        )
        == 1
    )


def test_which_runs_use_muon() -> None:
    assert train_options("tptn", steps=1).optimizer.method == "muon"
    assert train_options("tptn", steps=1, method="adamw").optimizer.method == "adamw"
    assert train_options("tptn-paper", steps=1).optimizer.method == "adamw"
    assert fine_tune_options("tptn", steps=1).optimizer.method == "adamw"
