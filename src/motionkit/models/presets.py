"""Named configurations: the shipped model, the paper's, and its ablations."""

from __future__ import annotations

from typing import Any

from motionkit.errors import ModelError
from motionkit.models.architectures import entry_point, network_class, plugged_in
from motionkit.models.config import ModelConfig

# Two parts, a leaky head with momentum for fast learning, and relative positions for streaming.
TPTN: dict[str, Any] = {
    "control_embedding": 80,
    "input_dropout": 0.1,
    "deep_dropout": 0.0,
    "spatial_dropout": 0.0,
    "head_leak": 0.9,
    "head_momentum": True,
}
# The paper's network: absolute head, sinusoidal positions, post-norm, and its dropout, features and controls.
PAPER: dict[str, Any] = {
    "layout": "expmap-root-1",
    "controls": "paper",
    "input_dropout": 0.5,
    "deep_dropout": 0.5,
    "position": "sinusoidal",
    "norm": "post",
    "layer_controls": False,
    "head_leak": 0.0,
    "log_sigma_min": -9.2,
}
# The paper's ablations of body parts (table 6), in sizes near that of tptn.
FOUR = TPTN | {"width": 88, "ffn": 176, "control_width": 24}
FIVE = TPTN | {"width": 80, "ffn": 160, "control_width": 24, "control_embedding": 64, "shared_channels": 16}
SMALL = {"width": 48, "heads": 4, "ffn": 96, "layers": 2, "control_width": 16, "control_embedding": 24}

PRESETS: dict[str, dict[str, Any]] = {  # fields of ModelConfig that differ from its defaults
    "tptn": TPTN,
    "tptn-paper": PAPER,
    "ebtn": TPTN | {"partition": "one", "width": 176, "ffn": 352},
    "fptn-r": FOUR | {"partition": "four-root", "shared_channels": 16},
    "fptn-s": FOUR | {"partition": "four-spine", "shared_channels": 40},
    "5ptn": FIVE | {"partition": "five"},
    "tiny": TPTN | SMALL | {"shared_channels": 12},  # for tests and first trials; it learns little
}


def preset(name: str, **changes: Any) -> Any:
    """Return the config of a preset, or of an architecture by its name, with some of its fields changed.

    Raises:
        ModelError: if the preset or a field is unknown, or a value is out of range.
    """
    if name in PRESETS:
        return ModelConfig().changed(**PRESETS[name] | changes)
    if entry_point(name):
        config = network_class(name).config_class
        return config.from_dict(config().to_dict() | changes)
    known = ", ".join([*PRESETS, *plugged_in()])
    raise ModelError(
        f"preset {name!r} is unknown, expected one of {known}; a new entry point needs pip install again"
    )
