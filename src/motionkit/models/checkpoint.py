"""Reads and writes a trained model as one safetensors file, without pickle; it needs nothing else to run.

The tensors are the network's weights under "network.", scaling, reference rotations, bodies, start poses and reference
clips. The metadata of the header holds a JSON document with config, types, rate, characters and the data card. Files of
the first releases use other names (former_names.py) and can still be read.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import save

from motionkit.arrays import Array
from motionkit.errors import ModelError
from motionkit.features.control import ControlLayout
from motionkit.features.normalize import Scaling
from motionkit.features.reference import PoseEmbedding
from motionkit.files import atomic_write, plain
from motionkit.models.architectures import config_from_dict
from motionkit.models.file_check import check_header, check_tensors, check_values
from motionkit.models.former_names import FORMER_FORMAT, renamed_header, renamed_tensor
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import (
    Gait,
    MotionType,
    ReferenceClip,
    SamplingPreset,
    StartPose,
    is_steered,
)
from motionkit.models.tensor_file import TensorFile, open_tensors
from motionkit.models.weights import NetworkWeights
from motionkit.names import nfc
from motionkit.version import __version__

FORMAT = "motionkit-model-4"
MOST_BYTES = 256 * 2**20  # largest model file; the bundled one has 13 MB
PRESET_FIELDS = tuple(field.name for field in fields(SamplingPreset))


def model_arrays(model: MotionModel, half: bool) -> dict[str, Array]:
    """All arrays of a model by their names in its file."""
    weight = np.float16 if half else np.float32
    arrays: dict[str, Array] = {f"network.{n}": a.astype(weight) for n, a in model.network.arrays.items()}
    arrays["scaling.mean"], arrays["scaling.std"] = model.scaling.mean, model.scaling.std
    trajectory, embedding = model.trajectory_scaling, model.pose_embedding
    arrays["trajectory.mean"], arrays["trajectory.std"] = trajectory.mean, trajectory.std
    arrays["pose_embedding.matrix"], arrays["pose_embedding.offset"] = embedding.matrix, embedding.offset
    arrays["reference_rotations"] = model.reference_rotations
    for name, offsets in model.characters.items():
        arrays[f"character.{name}"] = offsets
    for name, kind in model.types.items():
        for i, start in enumerate(kind.start_poses):
            key = f"start_pose.{i}.{name}"
            arrays[f"{key}:features"] = start.features.astype(weight)
            arrays[f"{key}:contacts"] = start.contacts.astype(np.uint8)
            arrays[f"{key}:ground"] = start.ground
        for i, clip in enumerate(kind.reference_clips):
            key = f"reference_clip.{i}.{name}"
            arrays[f"{key}:poses"] = clip.poses.astype(np.float16)  # 16 bits suffice for values of unit size
            arrays[f"{key}:ground"], arrays[f"{key}:phases"] = clip.ground, clip.phases
    return {name: np.ascontiguousarray(array) for name, array in arrays.items()}


def save_model(path: str | Path, model: MotionModel, half: bool = False) -> None:
    """Write a model file atomically; half stores the weights in 16 bits."""
    types = model.types
    gaits = {name: kind.gait for name, kind in types.items()}
    header = {
        "format": FORMAT,
        "motionkit": __version__,
        "config": model.config.to_dict(),
        "types": list(types),
        "fps": model.fps,
        "characters": list(model.characters),
        "start_poses": {name: len(kind.start_poses) for name, kind in types.items()},
        "reference_clips": {name: len(kind.reference_clips) for name, kind in types.items()},
        "gaits": {name: [g.speed, g.facing, g.cycle_seconds] for name, g in gaits.items() if g is not None},
        "steered": [name for name, kind in types.items() if kind.steered],
        "uses_references": model.uses_references,
        **({"own_bodies": True} if model.own_bodies else {}),
        **{field: _presets(types, field) for field in PRESET_FIELDS},
        "card": plain(model.card),
    }
    data = save(model_arrays(model, half), metadata={"motionkit": json.dumps(header)})
    with atomic_write(path, "wb") as file:
        file.write(data)


def _presets(types: Mapping[str, MotionType], field: str) -> dict[str, float]:
    """One field of the sampling presets, for the types that have it."""
    values = {name: getattr(kind.preset, field) for name, kind in types.items()}
    return {name: value for name, value in values.items() if value is not None}


def read_header(path: str | Path) -> dict[str, Any]:
    """Read a model file's metadata without its weights; raises ModelError if it is not a model file."""
    with _open_model(path) as file:
        return file.metadata


@contextmanager
def _open_model(path: str | Path) -> Iterator[TensorFile]:
    """Open a model file and check its header and tensors; errors name the file."""
    with open_tensors(path, "motionkit", "a motionkit model", MOST_BYTES) as file:
        header = file.metadata
        if not isinstance(header, dict) or header.get("format") not in (FORMAT, FORMER_FORMAT):
            found = (
                f"format {header['format']!r:.60}" if isinstance(header, dict) and "format" in header else ""
            )
            raise ModelError(
                f"{path}: {found}, expected {FORMAT!r}"
                if found
                else f"{path}: a safetensors file, but not a motionkit model"
            )
        try:
            if header["format"] == FORMER_FORMAT:
                header = file.metadata = renamed_header(header)
                file.rename(renamed_tensor)
            check_header(header)
            check_tensors(header, config_from_dict(header.get("config")), file.found)
            yield file
        except ModelError as error:
            raise ModelError(f"{path}: {error}") from None


def load_model(path: str | Path) -> MotionModel:
    """Read a model file; raises ModelError if it is not a model file or is damaged."""
    with _open_model(path) as file:
        header, tensors = file.metadata, file.read_all()
        check_values(tensors.items())
    arrays = {
        name: array if array.dtype == np.uint8 else array.astype(np.float32)
        for name, array in tensors.items()
    }
    weights = {n.removeprefix("network."): a for n, a in arrays.items() if n.startswith("network.")}
    config = config_from_dict(header["config"])
    size = ControlLayout(tuple(header["types"]), config.controls).size
    fps = float(header["fps"])
    embedding = PoseEmbedding(arrays["pose_embedding.matrix"], arrays["pose_embedding.offset"])
    return MotionModel(
        NetworkWeights(config, size, weights),
        {nfc(name): _read_type(header, arrays, name, embedding, fps) for name in header["types"]},
        fps,
        Scaling(arrays["scaling.mean"], arrays["scaling.std"]),
        Scaling(arrays["trajectory.mean"], arrays["trajectory.std"]),
        arrays["reference_rotations"],
        embedding,
        {nfc(name): arrays[f"character.{name}"] for name in header["characters"]},
        header["uses_references"],
        header.get("card", {}),
        header.get("own_bodies", False),
    )


def _read_type(
    header: dict[str, Any], arrays: dict[str, Array], name: str, embedding: PoseEmbedding, fps: float
) -> MotionType:
    starts = [f"start_pose.{i}.{name}" for i in range(header["start_poses"].get(name, 0))]
    clips = tuple(
        ReferenceClip(*(arrays[f"reference_clip.{i}.{name}:{key}"] for key in ("poses", "ground", "phases")))
        for i in range(header["reference_clips"].get(name, 0))
    )
    # Files of the first releases do not say which types are steered.
    steered = name in header["steered"] if "steered" in header else is_steered(clips, embedding, fps)
    gait = header.get("gaits", {}).get(name)
    known = {field: header.get(field, {}) for field in PRESET_FIELDS}
    preset = {field: float(known[field][name]) for field in PRESET_FIELDS if name in known[field]}
    return MotionType(
        tuple(
            StartPose(
                arrays[f"{key}:features"],
                arrays[f"{key}:contacts"].astype(np.float32),
                arrays[f"{key}:ground"],
            )
            for key in starts
        ),
        clips,
        None if gait is None else Gait(*gait),
        SamplingPreset(**preset),
        steered,
    )
