"""Checks a model file before any weight is read: every value of its header, and every tensor's shape and type.

Models may come from untrusted sources. A file that passes can be built and run. Any other raises a one-line error.
Shape legend: P parts, L layers, D width, C controls, H heads, W window.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from motionkit.errors import ModelError
from motionkit.features.control import MOST_TYPES, TRAJECTORY_COUNT, ControlLayout
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.features.reference import EMBEDDING_COUNT, REFERENCE_OFFSETS
from motionkit.files import is_number
from motionkit.models.architectures import built_shapes
from motionkit.models.config import ModelConfig, PredictorConfig
from motionkit.models.parts import partition
from motionkit.models.weights import part_columns
from motionkit.motion.skeleton import JOINT_COUNT
from motionkit.names import nfc

MOST_CHARACTERS, LONGEST_NAME = 10_000, 200
MOST_RECORDINGS = 10_000  # start poses or reference clips per type
MOST_FRAMES = 1_000_000  # per recording
FASTEST, LONGEST_PHASE = 1e4, 3600.0  # largest speed (cm/s) and cycle (s) of a gait
RATES = (1.0, 480.0)  # frames per second
REFERENCE_GAINS = (0.0, 100.0)  # also the range of noise factors
LONGEST_BONE = 1e4  # cm
LARGEST = 1e12  # number in a tensor; sums of products stay finite
FLOATS = ("F32", "F16")

Shape = tuple[int, ...]


@dataclass(frozen=True)
class TensorFacts:
    """Type (as safetensors names it) and shape of a tensor in a file."""

    dtype: str
    shape: Shape


# ---- the header ----


def check_header(header: dict[str, Any]) -> None:
    """Raise ModelError for a value that is missing, of the wrong type or out of range; config is not checked."""
    types: Any = header.get("types")
    check_names(types, header.get("characters"))
    check_number("fps", header.get("fps"), *RATES)
    switches = {
        "uses_references": header.get("uses_references"),
        "own_bodies": header.get("own_bodies", False),
    }
    for key, value in switches.items():
        if not isinstance(value, bool):
            raise ModelError(f"{key} is {_value_text(value)}, expected true or false")
    if not isinstance(header.get("card", {}), dict):
        raise ModelError(f"card is {_value_text(header['card'])}, expected an object")
    for key in ("start_poses", "reference_clips"):
        for kind, count in _by_type(header, key, types):
            if not is_number(count, 0, MOST_RECORDINGS, whole=True):
                raise ModelError(
                    f"{key} of {kind!r} are {_value_text(count)}, expected a number up to {MOST_RECORDINGS}"
                )
    for key, low, high in (
        ("reference_gain", *REFERENCE_GAINS),
        ("noise_scale", *REFERENCE_GAINS),
        ("noise_alone", *REFERENCE_GAINS),
        ("velocity_blend", 0.0, 1.0),
        ("slip_correction", 0.0, 1.0),
    ):
        for kind, value in _by_type(header, key, types, needed=key in ("reference_gain", "noise_scale")):
            check_number(f"{key} of {kind!r}", value, low, high)
    for kind, values in _by_type(header, "gaits", types, needed=False):
        if not isinstance(values, list) or len(values) not in (2, 3):
            raise ModelError(
                f"the gait of {kind!r} is {_value_text(values)}, expected speed, angle and seconds"
            )
        limits = ((0.0, FASTEST), (-2.0 * math.pi, 2.0 * math.pi), (0.0, LONGEST_PHASE))
        for value, (low, high) in zip(values, limits, strict=False):
            check_number(f"the gait of {kind!r}", value, low, high)
    steered = header.get("steered", [])
    if not isinstance(steered, list) or any(kind not in types for kind in steered):
        raise ModelError(f"steered is {_value_text(steered)}, expected a list of types")


def check_names(types: Any, characters: Any) -> None:
    """Raise ModelError unless types and characters are lists of allowed names."""
    for what, names, most in (("types", types, MOST_TYPES), ("characters", characters, MOST_CHARACTERS)):
        if not isinstance(names, list) or not 0 < len(names) <= most:
            raise ModelError(f"{what} are {_value_text(names)}, expected a list of 1 to {most} names")
        for name in names:
            if not isinstance(name, str) or not 0 < len(name) <= LONGEST_NAME or not name.isprintable():
                raise ModelError(
                    f"{what} have {_value_text(name)}, expected a printable name of up to {LONGEST_NAME} characters"
                )
        if len({nfc(name) for name in names}) < len(names):
            raise ModelError(f"{what} have a name twice")
    if "default" not in characters:
        raise ModelError("characters lack 'default'")


def _by_type(
    header: dict[str, Any], key: str, types: list[str], needed: bool = True
) -> Iterable[tuple[str, Any]]:
    """Return the entries of an object whose keys are types."""
    entries = header.get(key, None if needed else {})
    if not isinstance(entries, dict):
        raise ModelError(f"{key} is {_value_text(entries)}, expected an object with a value per type")
    unknown = set(entries) - set(types)
    if unknown:
        raise ModelError(f"{key} names the type {_value_text(min(unknown))}, which the model does not have")
    return entries.items()


def check_number(what: str, value: Any, low: float, high: float, whole: bool = False) -> None:
    """Raise ModelError unless a value is a number in a range."""
    if not is_number(value, low, high, whole):
        raise ModelError(f"{what} is {_value_text(value)}, expected a number from {low:g} to {high:g}")


def _value_text(value: Any) -> str:
    """Format a value for a message, in one short line."""
    text = ascii(value)
    return text if len(text) <= 60 else text[:57] + "..."


# ---- the tensors ----


def weight_shapes(config: ModelConfig, control_size: int) -> dict[str, Shape]:
    """Return the shapes of all weights of PartTransformer(config, control_size) by name, without building it.

    This does not cover the backbones and the fusion of the paper's ablations, which run in torch only.
    """
    body = partition(config.variant.partition)
    P, D, Dc = len(body.parts), config.width, config.embedding.control_embedding
    motion, feet = D - config.embedding.control_width, sum(bool(part.contacts) for part in body.parts)
    inputs = config.kernel * part_columns(config)[0].shape[1]
    shapes: dict[str, Shape] = {}

    def linear(name: str, parts: int, ins: int, outs: int, bias: bool = True) -> None:
        shapes[f"{name}.weight"] = (parts, ins, outs)
        if bias:
            shapes[f"{name}.bias"] = (parts, 1, outs)

    for module, ins in (("shallow", inputs), ("deep", D)):
        linear(f"{module}.embed", P, ins, motion)
        linear(f"{module}.embed_controls", P, control_size, Dc)
        for i in range(config.layers):
            layer = f"{module}.layers.{i}"
            linear(f"{layer}.attention.qkv", P, D, 3 * D)
            linear(f"{layer}.attention.out", P, D, D, bias=False)
            linear(f"{layer}.ffn.inner", P, D, config.ffn)
            linear(f"{layer}.ffn.outer", P, config.ffn, D, bias=False)
            if config.variant.position == "bias":
                shapes[f"{layer}.attention.offset_bias"] = (P, config.heads, config.window)
            if config.embedding.layer_controls:
                linear(f"{layer}.control", P, Dc, D, bias=False)
            if config.variant.norm == "post":
                for norm in ("attention_norm", "ffn_norm"):
                    shapes[f"{layer}.{norm}.scale"] = shapes[f"{layer}.{norm}.shift"] = (P, 1, 1, D)
    if P > 1 and config.variant.fusion == "linear":
        linear("fusion", P, (P - 1) * D, D)
    outputs = 2 * FEATURE_COUNT + 2 * TRAJECTORY_COUNT
    shapes["aggregate.weight"], shapes["aggregate.bias"] = (outputs, P * D), (outputs,)
    if config.head.head_momentum:
        shapes["momentum"] = (FEATURE_COUNT,)
    linear("contact_mlp.inner", 1, 2 * D * feet, config.head.contact_hidden)
    linear("contact_mlp.outer", 1, config.head.contact_hidden, CONTACT_COUNT)
    return shapes


def check_tensors(header: dict[str, Any], config: PredictorConfig, found: Mapping[str, TensorFacts]) -> None:
    """Raise ModelError unless a file has exactly the tensors of its checked header, with their shapes and types."""
    expected: dict[str, Shape] = {
        "scaling.mean": (FEATURE_COUNT,),
        "scaling.std": (FEATURE_COUNT,),
        "trajectory.mean": (TRAJECTORY_COUNT,),
        "trajectory.std": (TRAJECTORY_COUNT,),
        "reference_rotations": (JOINT_COUNT, 4),
        "pose_embedding.matrix": (FEATURE_COUNT, EMBEDDING_COUNT),
        "pose_embedding.offset": (EMBEDDING_COUNT,),
    }
    expected |= {f"character.{name}": (JOINT_COUNT, 3) for name in header["characters"]}
    size = ControlLayout(tuple(header["types"]), config.controls).size
    if (
        isinstance(config, ModelConfig)
        and config.variant.backbone == "attention"
        and config.variant.fusion != "cross-attention"
    ):
        shapes = weight_shapes(config, size)
    else:
        shapes = built_shapes(config, size)
    expected |= {f"network.{name}": shape for name, shape in shapes.items()}
    for kind, count in header["start_poses"].items():
        for i in range(count):
            frames = _frames(found, f"start_pose.{i}.{kind}:features")
            expected[f"start_pose.{i}.{kind}:features"] = (frames, FEATURE_COUNT)
            expected[f"start_pose.{i}.{kind}:contacts"] = (frames, CONTACT_COUNT)
            expected[f"start_pose.{i}.{kind}:ground"] = (frames, 3)
    for kind, count in header["reference_clips"].items():
        for i in range(count):
            frames = _frames(found, f"reference_clip.{i}.{kind}:phases")
            expected[f"reference_clip.{i}.{kind}:poses"] = (frames + REFERENCE_OFFSETS[-1], EMBEDDING_COUNT)
            expected[f"reference_clip.{i}.{kind}:ground"] = (frames, 3)
            expected[f"reference_clip.{i}.{kind}:phases"] = (frames,)
    check_shapes(found, expected)
    for name, facts in found.items():
        allowed = ("U8",) if name.startswith("start_pose.") and name.endswith(":contacts") else FLOATS
        if facts.dtype not in allowed:
            raise ModelError(
                f"the tensor {_value_text(name)} is of type {facts.dtype}, expected {' or '.join(allowed)}"
            )


def check_shapes(found: Mapping[str, TensorFacts], expected: Mapping[str, Shape]) -> None:
    """Raise ModelError unless exactly the expected tensors are there, with their shapes."""
    for name, shape in expected.items():
        if name not in found:
            raise ModelError(f"the tensor {_value_text(name)} is missing")
        if found[name].shape != shape:
            raise ModelError(
                f"the tensor {_value_text(name)} has shape {_value_text(found[name].shape)}, expected {shape}"
            )
    unknown = set(found) - set(expected)
    if unknown:
        raise ModelError(f"the tensor {_value_text(min(unknown))} is unknown")


def _frames(found: Mapping[str, TensorFacts], name: str) -> int:
    """Return the first dimension of a tensor, the length of a recording."""
    facts = found.get(name)
    if facts is None:
        raise ModelError(f"the tensor {_value_text(name)} is missing")
    if not facts.shape or not 1 <= facts.shape[0] <= MOST_FRAMES:
        raise ModelError(
            f"the tensor {_value_text(name)} has shape {_value_text(facts.shape)}, expected some frames"
        )
    return facts.shape[0]


def check_values(tensors: Iterable[tuple[str, np.ndarray]]) -> None:
    """Raise ModelError, with the tensor's name, for NaN, infinite or impossible numbers."""
    for name, values in tensors:
        if values.size and not float(np.abs(values).max()) <= LARGEST:  # NaN is refused, too
            raise ModelError(
                f"the tensor {_value_text(name)} has numbers that are NaN, infinite or above {LARGEST:g}"
            )
        if name in ("scaling.std", "trajectory.std") and values.min() <= 0.0:
            raise ModelError(
                f"the tensor {_value_text(name)} has {values.min():g}, expected positive deviations"
            )
        if name == "reference_rotations" and np.abs(np.linalg.norm(values, axis=-1) - 1.0).max() > 0.01:
            raise ModelError(f"the tensor {_value_text(name)} has rotations that are not unit quaternions")
        if name.startswith("character.") and np.abs(values).max() > LONGEST_BONE:
            raise ModelError(f"the tensor {_value_text(name)} has a bone longer than {LONGEST_BONE:g} cm")
