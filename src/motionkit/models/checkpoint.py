"""A trained model as one safetensors file that needs nothing else to run. No pickle anywhere.

Tensors: the network's weights under "network.", scaling, reference_rotations, bodies, seed frames and reference_clips. The
header's metadata holds one JSON document with config, types, rate, characters and the data card.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import save

from motionkit import __version__
from motionkit.arrays import Array
from motionkit.errors import ControlError, ModelError
from motionkit.features.control import ControlLayout
from motionkit.features.normalize import Scaling
from motionkit.features.reference import PoseEmbedding, ReferenceMap, reference_map
from motionkit.files import atomic_write
from motionkit.models.config import ModelConfig
from motionkit.models.file_check import check_header, check_tensors, check_values
from motionkit.models.tensor_file import TensorFile, open_tensors
from motionkit.models.weights import NetworkWeights
from motionkit.motion.skeleton import Skeleton, canonical_skeleton

FORMAT = "motionkit-model-3"
MOST_BYTES = 256 * 2**20  # of a model file; the bundled one has 13 MB
MOVEMENT_FRAMES = 120


@dataclass(frozen=True, eq=False)
class StartPose:
    """Real frames to start from: features (T, 276) unnormalised, contacts (T, 4), ground (T, 3)."""

    features: Array
    contacts: Array
    ground: Array


@dataclass(frozen=True)
class Gait:
    """How a type goes: speed over the ground in cm/s, the angle from where it faces to where it goes, and
    the seconds a performance takes for a type with a phase, zero for others."""

    speed: float
    facing: float
    seconds: float = 0.0


@dataclass(frozen=True, eq=False)
class ReferenceClip:
    """Recorded motion of one type in reference_clip, from which references are played (features/reference.py).

    Attributes:
        poses: (L + 30, 24) reference_clips of its frames and of those that follow, which references look ahead at.
        ground: (L, 3) root x, z (cm) and heading (radians).
        phases: (L,) progress through a performance, negative outside.
    """

    poses: Array
    ground: Array
    phases: Array

    def __len__(self) -> int:
        return len(self.ground)

    @property
    def performed(self) -> bool:
        """Whether it is one performance from beginning to end."""
        return bool((self.phases >= 0.0).all()) and bool((np.diff(self.phases) > 0.0).all())

    @cached_property
    def movement(self) -> Array:
        """How much the pose changes in a frame (L,), the mean over the coming MOVEMENT_FRAMES, fewer at the end."""
        steps = np.linalg.norm(self.poses[1 : len(self) + 1] - self.poses[: len(self)], axis=1)
        sums = np.pad(steps.cumsum(), (1, 0))
        frames = np.arange(len(self))
        ends = np.minimum(frames + MOVEMENT_FRAMES, len(self))
        return (sums[ends] - sums[frames]) / (ends - frames)


@dataclass(frozen=True, eq=False)
class MotionModel:
    """A network with everything needed to run it.

    Attributes:
        seeds: for each type name a few starts, real frames of the training data.
        characters: name to rest-pose offsets (23, 3) in cm; "default" is always there.
        outline: what makes reference_clips of poses.
        reference_clips: for each type name recordings in reference_clip, the longest first where they are performances.
        gaits: how each type moves over the ground, for paths that do not say how fast.
        uses_references: whether the network was trained with reference poses.
        reference_gain: for type names how many times larger than it is a reference is shown, 1 by default (docs/synthesis.md).
        noise: for type names the share they take of the temperature, 1 by default.
        velocity_blend: for type names how much of the last frame's movement goes on whatever is drawn, 0 by default.
        slip_correction: for type names how much of the sliding of standing feet is taken out of the root's way, 0 by default.
        card: where it comes from: data, settings, time, scores; shown, never needed.
    """

    network: NetworkWeights
    types: tuple[str, ...]
    fps: float
    scaling: Scaling
    trajectory_scaling: Scaling
    reference_rotations: Array
    pose_embedding: PoseEmbedding
    characters: dict[str, Array]
    start_poses: dict[str, list[StartPose]]
    gaits: dict[str, Gait] = field(default_factory=dict)
    reference_clips: dict[str, list[ReferenceClip]] = field(default_factory=dict)
    uses_references: bool = False
    reference_gain: dict[str, float] = field(default_factory=dict)
    noise: dict[str, float] = field(default_factory=dict)
    velocity_blend: dict[str, float] = field(default_factory=dict)
    slip_correction: dict[str, float] = field(default_factory=dict)
    card: dict[str, Any] = field(default_factory=dict)

    @property
    def config(self) -> ModelConfig:
        """The network's configuration."""
        return self.network.config

    @property
    def controls(self) -> ControlLayout:
        """Where each signal stands in a control vector."""
        return ControlLayout(self.types)

    @property
    def reference_map(self) -> ReferenceMap:
        """What turns references into what the network is shown of them."""
        return reference_map(self.pose_embedding, self.scaling)

    def type_id(self, name: str) -> int:
        """The index of a motion type; raises ControlError that lists the known ones and the nearest."""
        if name in self.types:
            return self.types.index(name)
        raise ControlError(unknown_name("motion type", name, self.types))

    def phase_seconds(self, kind: str) -> float:
        """How long a performance of a type takes, the first recorded one if there is one; zero without a phase."""
        if self.performed(kind):
            return len(self.reference_clips[kind][0]) / self.fps
        gait = self.gaits.get(kind)
        return 0.0 if gait is None else gait.seconds

    def performed(self, kind: str) -> bool:
        """Whether a type is one performance from beginning to end, as a cartwheel is."""
        reference_clips = self.reference_clips.get(kind, [])
        return any(reference_clip.performed for reference_clip in reference_clips[:1])

    def character(self, name: str) -> Skeleton:
        """A character's skeleton; raises ControlError for an unknown name."""
        if name not in self.characters:
            raise ControlError(unknown_name("character", name, tuple(self.characters)))
        return canonical_skeleton(self.characters[name])


def unknown_name(what: str, name: str, known: tuple[str, ...]) -> str:
    """The line for a name nobody knows, with the nearest one."""
    import difflib

    near = difflib.get_close_matches(name.lower(), known, n=1, cutoff=0.4)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"unknown {what} {name!r}{hint} (known: {', '.join(known)})"


def model_arrays(model: MotionModel, half: bool) -> dict[str, Array]:
    """All arrays of a model by the names they have in its file."""
    weight = np.float16 if half else np.float32
    tensors: dict[str, Array] = {f"network.{n}": a.astype(weight) for n, a in model.network.arrays.items()}
    tensors["scaling.mean"], tensors["scaling.std"] = model.scaling.mean, model.scaling.std
    tensors["trajectory.mean"], tensors["trajectory.std"] = (
        model.trajectory_scaling.mean,
        model.trajectory_scaling.std,
    )
    tensors["references"] = model.reference_rotations
    for name, offsets in model.characters.items():
        tensors[f"character.{name}"] = offsets
    for kind, seeds in model.start_poses.items():
        for i, seed in enumerate(seeds):
            key = f"seed.{i}.{kind}"
            tensors[f"{key}:features"] = seed.features.astype(weight)
            tensors[f"{key}:contacts"] = seed.contacts.astype(np.uint8)
            tensors[f"{key}:ground"] = seed.ground
    tensors["outline.matrix"], tensors["outline.offset"] = (
        model.pose_embedding.matrix,
        model.pose_embedding.offset,
    )
    for kind, reference_clips in model.reference_clips.items():
        for i, each in enumerate(reference_clips):
            key = f"outline.{i}.{kind}"
            tensors[f"{key}:poses"] = each.poses.astype(
                np.float16
            )  # of unit size, and played to the network only
            tensors[f"{key}:ground"], tensors[f"{key}:phases"] = each.ground, each.phases
    return {name: np.ascontiguousarray(array) for name, array in tensors.items()}


def save_model(path: str | Path, model: MotionModel, half: bool = False) -> None:
    """Write a model file, whole or not at all; half stores the weights in 16 bits."""
    header = {
        "format": FORMAT,
        "motionkit": __version__,
        "config": model.config.to_dict(),
        "types": list(model.types),
        "fps": model.fps,
        "characters": list(model.characters),
        "seeds": {kind: len(seeds) for kind, seeds in model.start_poses.items()},
        "gaits": {kind: [gait.speed, gait.facing, gait.seconds] for kind, gait in model.gaits.items()},
        "guides": model.uses_references,
        "guidance": model.reference_gain,
        "noise": model.noise,
        "inertia": model.velocity_blend,
        "grip": model.slip_correction,
        "outlines": {kind: len(reference_clips) for kind, reference_clips in model.reference_clips.items()},
        "card": _plain(model.card),
    }
    data = save(model_arrays(model, half), metadata={"motionkit": json.dumps(header)})
    with atomic_write(path, "wb") as file:
        file.write(data)


def _plain(value: Any) -> Any:
    """A value of a card as JSON knows it: NaN and infinite numbers, such as a loss that went astray, become null."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    return [_plain(each) for each in value] if isinstance(value, (list, tuple)) else value


def read_header(path: str | Path) -> dict[str, Any]:
    """A model file's metadata without its weights; raises ModelError if it is not one."""
    with _open_model(path) as file:
        return file.metadata


@contextmanager
def _open_model(path: str | Path) -> Iterator[TensorFile]:
    """A model file of this release, its header and tensors checked; faults name the file."""
    with open_tensors(path, "motionkit", "a motionkit model", MOST_BYTES) as file:
        header = file.metadata
        if not isinstance(header, dict) or header.get("format") != FORMAT:
            found = (
                f"format {header['format']!r:.60}" if isinstance(header, dict) and "format" in header else ""
            )
            raise ModelError(
                f"{path}: {found}, expected {FORMAT!r}"
                if found
                else f"{path}: a safetensors file, but not a motionkit model"
            )
        try:
            check_header(header)
            check_tensors(header, ModelConfig.from_dict(header.get("config")), file.found)
            yield file
        except ModelError as error:
            raise ModelError(f"{path}: {error}") from None


def load_model(path: str | Path) -> MotionModel:
    """Read a model file, ready to synthesize; raises ModelError if it is not one or is damaged."""
    with _open_model(path) as file:
        header, tensors = file.metadata, file.read_all()
        check_values(tensors.items())
    types = tuple(header["types"])
    arrays = {
        name: array if array.dtype == np.uint8 else array.astype(np.float32)
        for name, array in tensors.items()
    }
    weights = {n.removeprefix("network."): a for n, a in arrays.items() if n.startswith("network.")}
    return MotionModel(
        NetworkWeights(ModelConfig.from_dict(header["config"]), ControlLayout(types).size, weights),
        types,
        float(header["fps"]),
        Scaling(arrays["scaling.mean"], arrays["scaling.std"]),
        Scaling(arrays["trajectory.mean"], arrays["trajectory.std"]),
        arrays["references"],
        PoseEmbedding(arrays["outline.matrix"], arrays["outline.offset"]),
        {name: arrays[f"character.{name}"] for name in header["characters"]},
        {
            kind: [_read_start_pose(arrays, f"seed.{i}.{kind}") for i in range(count)]
            for kind, count in header["seeds"].items()
        },
        {kind: Gait(*values) for kind, values in header.get("gaits", {}).items()},
        {
            kind: [_read_reference(arrays, f"outline.{i}.{kind}") for i in range(count)]
            for kind, count in header["outlines"].items()
        },
        header["guides"],
        reference_gain=_numbers(header, "guidance"),
        noise=_numbers(header, "noise"),
        velocity_blend=_numbers(header, "inertia"),
        slip_correction=_numbers(header, "grip"),
        card=header.get("card", {}),
    )


def _numbers(header: dict[str, Any], key: str) -> dict[str, float]:
    return {kind: float(value) for kind, value in header.get(key, {}).items()}


def _read_start_pose(arrays: dict[str, Array], key: str) -> StartPose:
    return StartPose(
        arrays[f"{key}:features"],
        arrays[f"{key}:contacts"].astype(np.float32),
        arrays[f"{key}:ground"],
    )


def _read_reference(arrays: dict[str, Array], key: str) -> ReferenceClip:
    return ReferenceClip(*(arrays[f"{key}:{name}"] for name in ("poses", "ground", "phases")))
