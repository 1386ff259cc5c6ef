"""Named configurations: the shipped model, the paper's, and its ablations."""

from __future__ import annotations

from typing import Any

from motionkit.errors import ModelError
from motionkit.models.architectures import entry_point, network_class
from motionkit.models.config import ModelConfig


def tptn() -> ModelConfig:
    """Two parts, a leaky head with momentum for fast learning, and relative positions for streaming."""
    return ModelConfig().changed(
        control_embedding=80,
        input_dropout=0.1,
        deep_dropout=0.0,
        spatial_dropout=0.0,
        head_leak=0.9,
        head_momentum=True,
    )


def tptn_paper() -> ModelConfig:
    """The paper's network: absolute head, sinusoidal positions, post-norm, and its dropout, features and controls."""
    return ModelConfig().changed(
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
    return tptn().changed(partition="one", width=176, ffn=352, control_width=32)


def fptn_r() -> ModelConfig:
    """Four parts that share the root."""
    return tptn().changed(partition="four-root", width=88, ffn=176, control_width=24, shared_channels=16)


def fptn_s() -> ModelConfig:
    """Four parts that share the spine."""
    return tptn().changed(partition="four-spine", width=88, ffn=176, control_width=24, shared_channels=40)


def five_ptn() -> ModelConfig:
    """Five parts: two arms, two legs, the spine."""
    return tptn().changed(
        partition="five",
        width=80,
        ffn=160,
        control_width=24,
        control_embedding=64,
        shared_channels=16,
    )


def tiny() -> ModelConfig:
    """A small network for tests and first trials; it learns little."""
    return tptn().changed(
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


def preset(name: str, **changes: Any) -> Any:
    """Return the config of a preset, or of an architecture by its name, with some of its fields changed.

    Raises:
        ModelError: if the preset or a field is unknown, or a value is out of range.
    """
    if name in PRESETS:
        return PRESETS[name]().changed(**changes)
    if entry_point(name):
        config = network_class(name).config_class
        return config.from_dict(config().to_dict() | changes)
    raise ModelError(f"preset {name!r} is unknown, expected one of {', '.join(PRESETS)}")
