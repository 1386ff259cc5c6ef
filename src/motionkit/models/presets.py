"""Named configurations: the shipped model, the paper's, and its ablations."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from motionkit.errors import ModelError
from motionkit.models.architectures import ARCHITECTURES, network_class
from motionkit.models.config import ModelConfig


def tptn() -> ModelConfig:
    """Two parts, a leaky head with momentum, which learns fast, and relative positions, which allow streaming."""
    return ModelConfig(
        control_embedding=80,
        input_dropout=0.1,
        deep_dropout=0.0,
        spatial_dropout=0.0,
        head_leak=0.9,
        head_momentum=True,
    )


def tptn_paper() -> ModelConfig:
    """The paper's network: absolute head, sinusoidal positions, post-norm, its dropout, features and controls."""
    return ModelConfig(
        layout="expmap-root-1",
        controls="paper",
        input_dropout=0.5,
        deep_dropout=0.5,
        position="sinusoidal",
        norm="post",
        layer_controls=False,
        head_leak=0.0,
        log_sigma_min=-9.2,
    )


def ebtn() -> ModelConfig:
    """One stream for the entire body (paper table 6)."""
    return replace(tptn(), partition="one", width=176, ffn=352, control_width=32)


def fptn_r() -> ModelConfig:
    """Four parts that share the root."""
    return replace(tptn(), partition="four-root", width=88, ffn=176, control_width=24, shared_channels=16)


def fptn_s() -> ModelConfig:
    """Four parts that share the spine."""
    return replace(tptn(), partition="four-spine", width=88, ffn=176, control_width=24, shared_channels=40)


def five_ptn() -> ModelConfig:
    """Five parts: two arms, two legs, the spine."""
    return replace(
        tptn(),
        partition="five",
        width=80,
        ffn=160,
        control_width=24,
        control_embedding=64,
        shared_channels=16,
    )


def tiny() -> ModelConfig:
    """A small network for tests and first tries; it learns little."""
    return replace(
        tptn(),
        width=48,
        heads=4,
        ffn=96,
        layers=2,
        control_width=16,
        control_embedding=24,
        shared_channels=12,
    )


PRESETS = {
    "tptn": tptn,
    "tptn-paper": tptn_paper,
    "ebtn": ebtn,
    "fptn-r": fptn_r,
    "fptn-s": fptn_s,
    "5ptn": five_ptn,
    "tiny": tiny,
}


def preset(name: str) -> Any:
    """Return the config of a preset, or of an architecture by its name. Raises ModelError if it is unknown."""
    if name in PRESETS:
        return PRESETS[name]()
    if name in ARCHITECTURES:
        return network_class(name).config_class()
    raise ModelError(f"preset {name!r} is unknown, expected one of {', '.join(PRESETS)}")
