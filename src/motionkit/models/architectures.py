"""The table of network architectures: it turns the config of a model file into a network.

A new architecture is one file with a config and a Predictor (models/predictor.py). The part transformer is built in;
all others are entry points of the group GROUP, as plug-ins are. The config of the part transformer has no
"architecture", because it was once the only one.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any

from motionkit.errors import ModelError
from motionkit.models.config import ModelConfig, PredictorConfig

if TYPE_CHECKING:
    from motionkit.models.predictor import Predictor

PART_TRANSFORMER = "part-transformer"
GROUP = "motionkit.architectures"  # group of entry points
# Architecture to its Predictor, written as in an entry point. Packages are searched only for other names.
ARCHITECTURES: dict[str, str] = {PART_TRANSFORMER: "motionkit.models.network:PartTransformer"}


def entry_point(architecture: str) -> EntryPoint | None:
    """Return the entry point of an architecture's class; None for an unknown architecture."""
    if architecture in ARCHITECTURES:
        return EntryPoint(architecture, ARCHITECTURES[architecture], GROUP)
    return next(iter(entry_points(group=GROUP, name=architecture)), None)


def plugged_in() -> list[str]:
    """Return the names of all architectures that are entry points."""
    return sorted({each.name for each in entry_points(group=GROUP)})


def network_class(architecture: str) -> type[Predictor]:
    """Return the class of an architecture. Raises ModelError if it is unknown, or torch is not installed."""
    found = entry_point(architecture)
    if found is None:
        known = ", ".join([*ARCHITECTURES, *plugged_in()])
        raise ModelError(
            f"architecture {architecture!r:.60} is unknown, expected one of {known}; install the package that has it"
        )
    try:
        loaded: type[Predictor] = found.load()
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise ModelError(f"{architecture} models run in torch only: pip install 'motionkit[train]'") from None
    return loaded


def config_from_dict(values: Any) -> PredictorConfig:
    """Return the config of a model file. Raises ModelError for unknown fields or bad values."""
    if not isinstance(values, dict) or "architecture" not in values:
        return ModelConfig.from_dict(values)
    return network_class(str(values["architecture"])).config_class.from_dict(values)


def build(config: PredictorConfig, control_size: int) -> Predictor:
    """Return a network with random weights."""
    return network_class(config.architecture)(config, control_size)


def built_shapes(config: PredictorConfig, control_size: int) -> dict[str, tuple[int, ...]]:
    """Return the shapes of a network's weights by name; builds the network without memory for them."""
    import torch

    with torch.device("meta"):
        network = build(config, control_size)
    return {name: tuple(value.shape) for name, value in network.state_dict().items()}
