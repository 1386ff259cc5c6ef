"""What a network is made of; a variant changes a field or two."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any

from motionkit.errors import ModelError
from motionkit.features.layout import DEFAULT_LAYOUT, LAYOUTS
from motionkit.models.parts import PARTITIONS

# What a config may hold: names among these, numbers from and to. A model file may come from anyone, and sizes
# decide how much memory and time it takes. attention.py works in blocks of 16 frames, so it sees no more than 17.
CHOICES: dict[str, tuple[str, ...]] = {
    "partition": tuple(PARTITIONS),
    "layout": tuple(LAYOUTS),
    "position": ("bias", "sinusoidal"),
    "norm": ("pre", "post"),
    "fusion": ("linear", "none"),
}
RANGES: dict[str, tuple[float, float]] = {
    "width": (2, 2048),
    "heads": (1, 64),
    "ffn": (1, 8192),
    "layers": (1, 48),
    "window": (1, 17),
    "kernel": (1, 32),
    "control_width": (1, 1024),
    "control_embedding": (1, 2048),
    "shared_channels": (0, 1024),
    "input_dropout": (0.0, 0.99),
    "deep_dropout": (0.0, 0.99),
    "spatial_dropout": (0.0, 0.99),
    "head_leak": (0.0, 1.0),
    "log_sigma_min": (-100.0, 100.0),
    "log_sigma_max": (-100.0, 100.0),
    "contact_hidden": (1, 4096),
    "consistency_hidden": (1, 4096),
}


@dataclass(frozen=True)
class ModelConfig:
    """Sizes and choices of the network. The paper's supplement, which has its sizes, is not public."""

    partition: str = "two"  # which body parts: see models/parts.py
    layout: str = DEFAULT_LAYOUT  # version of the 276 columns
    width: int = 128  # channels of each part
    heads: int = 8  # attention heads
    ffn: int = 256  # hidden channels of each feed-forward layer
    layers: int = 6  # attention layers in each auto-regressive module (paper: 6)
    window: int = 8  # frames a layer sees, its own included (paper: lm = 8)
    kernel: int = 3  # causal convolution of the shallow modules (paper: 3; deep: 1)
    control_width: int = (
        32  # the first channels of the embedded controls, which stand beside the motion in width
    )
    control_embedding: int = 32  # channels the controls are embedded in: all enter every layer
    shared_channels: int = 24  # first channels of the embedding, fed by the shared joints alone
    input_dropout: float = 0.4  # on the motion that goes in (paper: 0.5)
    deep_dropout: float = 0.1  # on the features that enter the deep modules (paper: 0.5)
    spatial_dropout: float = 0.1  # whole channels, before the attention layers (paper: 0.1)
    position: str = "bias"  # "bias": learned per head and offset, streams; "sinusoidal": the paper's
    norm: str = "pre"  # "pre" or "post" (Vaswani et al. 2017)
    fusion: str = "linear"  # "linear" (paper) or "none"
    layer_controls: bool = True  # add the embedded controls to the input of every layer as well
    consistency: bool = True  # consistency modules in training
    head_leak: float = 0.8  # mean = head_leak x input pose + output; 0 is the paper's absolute head
    head_momentum: bool = False  # adds a learned share, per column, of the step the input has just taken
    log_sigma_min: float = -5.0  # in normalised units (paper: sigma > 1e-4)
    log_sigma_max: float = 2.0
    contact_hidden: int = 64  # Foot-MLP
    consistency_hidden: int = 64  # consistency modules

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            _check(name, value, getattr(type(self), name))
        motion_width = self.width - self.control_width
        if self.width % self.heads or motion_width <= self.shared_channels:
            raise ModelError("model width must be a multiple of heads and exceed control and shared channels")
        if self.control_embedding < self.control_width:
            raise ModelError("control_embedding must be at least control_width")
        if self.log_sigma_min > self.log_sigma_max:
            raise ModelError("log_sigma_min must be at most log_sigma_max")
        if self.position == "sinusoidal" and motion_width % 2:
            raise ModelError("sinusoidal positions need an even number of channels beside the controls")

    @property
    def receptive_field(self) -> int:
        """Frames that can influence a prediction: TRL of the paper, 87 by default."""
        return (self.kernel - 1) + self.window + (2 * self.layers - 1) * (self.window - 1)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for a model file."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Any) -> ModelConfig:
        """The config a model file holds; raises ModelError for fields this release does not know."""
        if not isinstance(values, dict):
            raise ModelError(f"config is {values!r:.60}, expected an object")
        unknown = set(values) - {f.name for f in fields(cls)}
        if unknown:
            names = ", ".join(name if name.isidentifier() else ascii(name) for name in sorted(unknown))
            raise ModelError(f"the model was made by another release: unknown settings {names:.200}")
        return cls(**values)


def _check(name: str, value: Any, default: Any) -> None:
    """Raises ModelError for a field of another type than its default, or out of range."""
    if name in CHOICES:
        if not isinstance(value, str) or value not in CHOICES[name]:
            raise ModelError(f"{name} is {value!r:.80}, expected one of {', '.join(CHOICES[name])}")
    elif isinstance(default, bool):
        if not isinstance(value, bool):
            raise ModelError(f"{name} is {value!r:.80}, expected true or false")
    else:
        low, high = RANGES[name]
        kinds = int if isinstance(default, int) else (int, float)
        if isinstance(value, bool) or not isinstance(value, kinds) or not low <= value <= high:
            kind = "a whole number" if kinds is int else "a number"
            raise ModelError(f"{name} is {value!r:.80}, expected {kind} from {low:g} to {high:g}")
