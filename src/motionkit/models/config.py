"""The configuration of a network."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from functools import cache
from typing import Any, Protocol

from motionkit.errors import ModelError
from motionkit.features.control import CONTROL_KINDS
from motionkit.features.layout import DEFAULT_LAYOUT, LAYOUTS
from motionkit.models.parts import PARTITIONS

# Backbones that keep a state from frame to frame in place of a window, and their layers in torch.nn.
RECURRENT = {"lstm": "LSTM"}
# Allowed names and ranges of numbers in a config. Model files may come from untrusted sources, and sizes determine
# memory and time. A window has at most 17 frames, because attention.py works in blocks of 16.
CHOICES: dict[str, tuple[str, ...]] = {
    "partition": tuple(PARTITIONS),
    "layout": tuple(LAYOUTS),
    "controls": CONTROL_KINDS,
    "position": ("bias", "sinusoidal"),
    "norm": ("pre", "post"),
    "fusion": ("linear", "none", "cross-attention"),
    "backbone": ("attention", "non-local", *RECURRENT),
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
    "velocity_momentum": (-1.0, 1.0),
    "log_sigma_min": (-100.0, 100.0),
    "log_sigma_max": (-100.0, 100.0),
    "contact_hidden": (1, 4096),
    "consistency_hidden": (1, 4096),
}


# For the non-local backbone: frames of the causal convolution in a residual block, and blocks per non-local operation.
RESIDUAL_KERNEL, NON_LOCAL_EVERY = 3, 2


class PredictorConfig(Protocol):
    """Sizes and choices of a network, as plain values in a model file."""

    @property
    def architecture(self) -> str:
        """A name in ARCHITECTURES (architectures.py)."""
        ...

    @property
    def layout(self) -> str:
        """The version of the 276 columns."""
        ...

    @property
    def controls(self) -> str:
        """Which control signals the network takes, one of CONTROL_KINDS."""
        ...

    def to_dict(self) -> dict[str, Any]:
        """Plain values, with "architecture" for all networks but the part transformer."""
        ...


@dataclass(frozen=True)
class Embedding:
    """How the motion and the controls enter the attention layers."""

    control_width: int = 32  # channels of the stream for the embedded controls; the motion has the others
    control_embedding: int = 32  # channels of the embedded controls; layer_controls gives all to every layer
    shared_channels: int = 24  # first channels of the motion, which see only the shared joints
    layer_controls: bool = True  # whether the embedded controls also enter every layer


@dataclass(frozen=True)
class Dropout:
    """Dropout in training."""

    input_dropout: float = 0.4  # on the input motion (paper: 0.5)
    deep_dropout: float = 0.1  # on the input of the deep modules (paper: 0.5)
    spatial_dropout: float = 0.1  # of whole channels, before the attention layers (paper: 0.1)


@dataclass(frozen=True)
class Variant:
    """Choice of the network: that of the paper, its ablations, or ours."""

    partition: str = "two"  # body parts (models/parts.py)
    position: str = "bias"  # "bias": learned per head and offset, can stream; "sinusoidal": the paper's
    norm: str = "pre"  # "pre" or "post" (Vaswani et al. 2017)
    fusion: str = "linear"  # "linear" (paper), "none", or "cross-attention" (the paper's ablation)
    backbone: str = "attention"  # or "non-local" or one of RECURRENT (models/backbones.py)

    @property
    def recurrent(self) -> bool:
        """Whether the backbone keeps a state."""
        return self.backbone in RECURRENT


@dataclass(frozen=True)
class Head:
    """Outputs from the deep features: the Gaussian of the next frame, contacts, consistency."""

    head_leak: float = 0.8  # mean = head_leak x input pose + output; 0 is the paper's absolute head
    head_momentum: bool = False  # whether the mean adds a learned share, per column, of the last velocity
    velocity_momentum: float = 0.8  # where that share begins in velocities; 0 if recordings tremble
    trajectory_skip: bool = False  # trajectory mean = the trajectory in the controls + output
    log_sigma_min: float = -5.0  # in normalised units (paper: sigma > 1e-4)
    log_sigma_max: float = 2.0
    contact_hidden: int = 64  # hidden channels of the Foot-MLP
    consistency: bool = True  # whether training uses consistency modules
    consistency_hidden: int = 64  # hidden channels of the consistency modules


@dataclass(frozen=True)
class ModelConfig:
    """Sizes and choices of the network. The paper gives its sizes in a supplement that is not public.

    Model files have the fields of all groups side by side, by the names they have here.
    """

    layout: str = DEFAULT_LAYOUT  # version of the 276 columns
    controls: str = "extended"  # control signals; "paper" feeds the predicted trajectory back
    width: int = 128  # channels of each part
    heads: int = 8  # attention heads
    ffn: int = 256  # hidden channels of each feed-forward layer
    layers: int = 6  # attention layers in each auto-regressive module (paper: 6)
    window: int = 8  # frames a layer sees, including the current one (paper: lm = 8)
    kernel: int = 3  # causal convolution of the shallow modules (paper: 3; deep: 1)
    variant: Variant = Variant()
    embedding: Embedding = Embedding()
    dropout: Dropout = Dropout()
    head: Head = Head()

    def __post_init__(self) -> None:
        defaults = _defaults()
        for name, value in self.to_dict().items():
            _check(name, value, defaults[name])
        embedding, variant = self.embedding, self.variant
        motion_width = self.width - embedding.control_width
        if self.width % self.heads or motion_width <= embedding.shared_channels:
            raise ModelError("model width must be a multiple of heads and exceed control and shared channels")
        if embedding.control_embedding < embedding.control_width:
            raise ModelError("control_embedding must be at least control_width")
        if variant.backbone != "attention" and (embedding.layer_controls or variant.norm != "post"):
            raise ModelError(f"backbone {variant.backbone} needs norm 'post' and no layer_controls")
        if self.head.log_sigma_min > self.head.log_sigma_max:
            raise ModelError("log_sigma_min must be at most log_sigma_max")
        if variant.position == "sinusoidal" and motion_width % 2:
            raise ModelError("sinusoidal positions need an even number of channels beside the controls")

    @property
    def architecture(self) -> str:
        """The name of the network (models/architectures.py)."""
        return "part-transformer"

    @property
    def receptive_field(self) -> int:
        """Number of frames that influence a prediction: the paper's TRL, 87 by default.

        All earlier frames influence a recurrent network; it gets the number of attention.
        """
        reach = self.window - 1
        steps = 2 * self.layers * reach
        if self.variant.backbone == "non-local":
            steps = 2 * self.layers * (RESIDUAL_KERNEL - 1) + 2 * (self.layers // NON_LOCAL_EVERY) * reach
        fused = reach if self.variant.fusion == "cross-attention" else 0
        return (self.kernel - 1) + 1 + steps + fused

    def to_dict(self) -> dict[str, Any]:
        """Return the plain values of all groups in one dict, for a model file."""
        values: dict[str, Any] = {}
        for name, value in asdict(self).items():
            values |= value if name in GROUPS else {name: value}
        return values

    def changed(self, **changes: Any) -> ModelConfig:
        """Return the config with some fields of any group changed: changed(layers=4, norm="post").

        Raises:
            ModelError: for an unknown field, or a value out of range.
        """
        return ModelConfig.from_dict(self.to_dict() | changes)

    @classmethod
    def from_dict(cls, values: Any) -> ModelConfig:
        """Return the config of a model file. Raises ModelError for unknown fields or bad values."""
        if not isinstance(values, dict):
            raise ModelError(f"config is {values!r:.60}, expected an object")
        unknown = set(values) - set(_defaults())
        if unknown:
            names = ", ".join(name if name.isidentifier() else ascii(name) for name in sorted(unknown))
            raise ModelError(f"the model was made by another release: unknown settings {names:.200}")
        groups = {
            group: kind(**{f.name: values[f.name] for f in fields(kind) if f.name in values})
            for group, kind in GROUPS.items()
        }
        flat = {f.name: values[f.name] for f in fields(cls) if f.name in values}
        return cls(**flat, **groups)


GROUPS: dict[str, Any] = {"variant": Variant, "embedding": Embedding, "dropout": Dropout, "head": Head}


@cache
def _defaults() -> dict[str, Any]:
    """Return the default of every field of the config and its groups."""
    kinds = (ModelConfig, *GROUPS.values())
    return {f.name: f.default for kind in kinds for f in fields(kind) if f.name not in GROUPS}


def _check(name: str, value: Any, default: Any) -> None:
    """Raise ModelError if a field has another type than its default or is out of range."""
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
