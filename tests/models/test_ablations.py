"""The backbones and fusions of the paper's ablations: what they see, and that streams predict what windows do."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from motionkit.errors import ModelError
from motionkit.models.config import ModelConfig
from motionkit.models.network import PartTransformer
from motionkit.models.presets import preset

CONTROL_SIZE = 30
SMALL = {"width": 48, "ffn": 96, "control_width": 16, "control_embedding": 16, "shared_channels": 12}


def network(seed: int = 0, **changes: Any) -> PartTransformer:
    torch.manual_seed(seed)
    made = PartTransformer(preset("tptn-paper", **{**SMALL, **changes}), CONTROL_SIZE).eval()
    with torch.no_grad():
        made.aggregate.weight.mul_(10.0)  # far frames have little influence on random weights
    return made


def inputs(frames: int, batch: int = 1) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    sizes = (276, 4, CONTROL_SIZE)
    return tuple(torch.randn(batch, frames, size, generator=generator) for size in sizes)  # type: ignore[return-value]


def first_frame_seen(made: PartTransformer, frames: int) -> int:
    """The first of `frames` frames on which the last prediction depends, by its gradient."""
    x, contacts, controls = inputs(frames)
    x.requires_grad_(True)
    made.double()
    made(x.double(), contacts.double(), controls.double()).mean[0, -1].square().sum().backward()
    assert x.grad is not None
    return int((x.grad[0].abs().sum(-1) > 0).nonzero()[0])


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({}, 87),
        ({"window": 4}, 39),
        ({"window": 12}, 135),
        ({"kernel": 1}, 85),
        ({"fusion": "none"}, 87),
        ({"fusion": "cross-attention"}, 94),
        ({"backbone": "non-local"}, 69),
        ({"partition": "one"}, 87),
        ({"partition": "four-root"}, 87),
        ({"partition": "five"}, 87),
    ],
)
def test_receptive_fields(changes: dict[str, Any], field: int) -> None:
    made = network(**changes)
    assert made.config.receptive_field == field
    assert first_frame_seen(made, 140) == 140 - field


def test_an_lstm_sees_all_frames() -> None:
    assert first_frame_seen(network(backbone="lstm"), 140) == 0


@pytest.mark.parametrize(
    "changes",
    [{"fusion": "cross-attention"}, {"backbone": "non-local"}, {"backbone": "lstm"}, {"fusion": "none"}],
)
def test_a_stream_predicts_what_the_window_does(changes: dict[str, Any]) -> None:
    made = network(layers=2, **changes)
    x, contacts, controls = inputs(12, batch=2)
    with torch.no_grad():
        whole = made(x, contacts, controls)
    stream = made.stream(2)
    for t in range(12):
        one = stream.step(x[:, t], contacts[:, t], controls[:, t])
        assert torch.allclose(one.mean, whole.mean[:, t], atol=1e-4)
        assert torch.allclose(one.contact_logits, whole.contact_logits[:, t], atol=1e-4)


@pytest.mark.parametrize(
    "changes", [{"backbone": "non-local"}, {"backbone": "lstm"}, {"fusion": "cross-attention"}]
)
def test_no_frame_sees_a_later_one(changes: dict[str, Any]) -> None:
    made = network(layers=2, **changes)
    x, contacts, controls = inputs(20)
    other = x.clone()
    other[:, 12:] += 1.0
    with torch.no_grad():
        before, after = made(x, contacts, controls).mean, made(other, contacts, controls).mean
    assert torch.equal(before[:, :12], after[:, :12]) and not torch.equal(before[:, 12:], after[:, 12:])


def test_cross_attention_asks_with_the_other_part() -> None:
    """Each part's keys and values are its own; the other part only says where to look (paper, section 5.5)."""
    made = network(fusion="cross-attention", layers=1)
    shallow = torch.randn(2, 1, 9, 48, generator=torch.Generator().manual_seed(2))
    with torch.no_grad():
        steady = shallow.clone()
        steady[0] = shallow[0, :, :1]  # part 0 has one and the same value at all frames
        turned = steady.clone()
        turned[1] *= -3.0
        assert torch.allclose(made.fuse(steady)[0], made.fuse(turned)[0], atol=1e-5)
        assert not torch.allclose(made.fuse(shallow)[0], made.fuse(torch.stack([shallow[0], -shallow[1]]))[0])


def test_attention_without_positions_is_the_same_by_the_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    made = network(layers=1)
    x, contacts, controls = inputs(40)
    with torch.no_grad():
        fast = made(x, contacts, controls).mean
        monkeypatch.setattr("motionkit.models.attention.can_attend", lambda *_: False)
        assert torch.allclose(made(x, contacts, controls).mean, fast, atol=1e-4)


def test_other_backbones_need_the_papers_norm() -> None:
    with pytest.raises(ModelError, match="backbone lstm needs norm 'post'"):
        ModelConfig().changed(backbone="lstm")
