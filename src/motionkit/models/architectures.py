"""The one table of network architectures: how a model file's config becomes a network.

A new architecture is one file with a config and a Predictor (models/predictor.py), and one line here. The part
transformer has no "architecture" in its config, because it was the only one.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from motionkit.errors import ModelError
from motionkit.models.config import ModelConfig, PredictorConfig

if TYPE_CHECKING:
    from motionkit.models.predictor import Predictor

PART_TRANSFORMER = "part-transformer"
# Architecture to the module and the class of its Predictor.
ARCHITECTURES: dict[str, tuple[str, str]] = {
    PART_TRANSFORMER: ("motionkit.models.network", "PartTransformer"),
    "pfnn": ("motionkit.models.pfnn", "PhaseFunctionedNetwork"),
    "mvae": ("motionkit.models.mvae", "MotionVae"),
    "htss": ("motionkit.models.htss", "TwoStream"),
    "neural-layering": ("motionkit.models.neural_layering", "NeuralLayering"),
    "learned-motion-matching": ("motionkit.models.learned_motion_matching", "LearnedMotionMatching"),
}


def network_class(architecture: str) -> type[Predictor]:
    """Return the class of an architecture. Raises ModelError if it is unknown, or torch is not installed."""
    if architecture not in ARCHITECTURES:
        known = ", ".join(ARCHITECTURES)
        raise ModelError(f"architecture {architecture!r:.60} is unknown, expected one of {known}")
    module, name = ARCHITECTURES[architecture]
    try:
        found: type[Predictor] = getattr(importlib.import_module(module), name)
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise ModelError(f"{architecture} models run in torch only: pip install 'motionkit[train]'") from None
    return found


def config_from_dict(values: Any) -> PredictorConfig:
    """Return the config of a model file. Raises ModelError for unknown fields or bad values."""
    if not isinstance(values, dict) or "architecture" not in values:
        return ModelConfig.from_dict(values)
    return network_class(str(values["architecture"])).config_class.from_dict(values)


def build(config: PredictorConfig, control_size: int) -> Predictor:
    """Return a network with random weights."""
    return network_class(config.architecture)(config, control_size)


def built_shapes(config: PredictorConfig, control_size: int) -> dict[str, tuple[int, ...]]:
    """Return the shapes of a network's weights by name; builds it without memory for them."""
    import torch

    with torch.device("meta"):
        network = build(config, control_size)
    return {name: tuple(value.shape) for name, value in network.state_dict().items()}
