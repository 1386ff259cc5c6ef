"""Packs a model into one file for a web page (web/src/demo): memory of the C kernels, types and tracks.

The file has 4 bytes for the length of a JSON header, the header, and deflated arrays. Two steps make the arrays
smaller. Poses and ground tracks are stored by column, as differences between frames in units of STEP. The low bytes of
all 16-bit words come before the high bytes.
"""

from __future__ import annotations

import json
import struct
import zlib
from typing import Any

import numpy as np

from motionkit.arrays import Array
from motionkit.control.path_place import path_words
from motionkit.control.speeds import lateral_limit
from motionkit.control.steering import STANDS_BELOW, Steering
from motionkit.export.page_tracks import Track, type_tracks
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.features.reference import EMBEDDING_COUNT
from motionkit.inference.character import model_first_type
from motionkit.inference.kernel_image import BASE, KernelImage, kernel_image
from motionkit.inference.noise import Noise
from motionkit.inference.step_weights import pack
from motionkit.models.config import ModelConfig
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind
from motionkit.motion.bvh import bvh_hierarchy

FORMAT = "motionkit-page-4"
COLUMNS = {"poses": EMBEDDING_COUNT, "ground": 3}
STEP = 2.0**-10  # quantization step of poses (normalized), cm and radians


def page_model(model: MotionModel) -> bytes:
    """The file of a model, as bytes; characters have the model's default body.

    Raises:
        ModelError: the C kernels cannot run the network.
    """
    image = kernel_image(model, Noise(), Steering(model), path_words(model))
    arrays: dict[str, dict[str, Any]] = {}
    body = bytearray()
    tracks = {name: type_tracks(model, name) for name in model.types}
    every = [track for some in tracks.values() for track in some]
    floats = {**_frame_arrays(model), "phases": np.concatenate([np.zeros(0), *(t.phases for t in every)])}
    stored: dict[str, tuple[str, bytes]] = {
        "shared": ("u1", _sorted_bytes(image.shared)),
        "own": ("u1", _sorted_bytes(image.character)),
        "poses": ("steps", _differences([track.poses for track in every], COLUMNS["poses"])),
        "ground": ("steps", _differences(_end_to_end([track.ground for track in every]), COLUMNS["ground"])),
        **{name: ("f4", _sorted_bytes(array.astype("<f4").tobytes())) for name, array in floats.items()},
    }
    for name, (kind, data) in stored.items():
        packed = zlib.compress(data, 9)
        places = {"from": len(body), "to": len(body) + len(packed)}
        arrays[name] = {"type": kind, "columns": COLUMNS.get(name, 1), **places}
        body += packed
    header = json.dumps(
        {**_header(model, image), "types": _types(model, tracks), "arrays": arrays}, separators=(",", ":")
    ).encode()
    return struct.pack("<I", len(header)) + header + bytes(body)


def _frame_arrays(model: MotionModel) -> dict[str, Array]:
    """Arrays that a page needs besides the kernels' memory."""
    references = model.reference_map
    momentum = pack(model.network).momentum
    presets = [model.presets(name) for name in ("noise_scale", "velocity_blend", "slip_correction")]
    scaling = model.trajectory_scaling
    return {
        "presets": np.stack(presets, axis=1),
        "momentum": np.zeros(FEATURE_COUNT, np.float32) if momentum is None else momentum,
        "trajectory": np.stack([scaling.mean, scaling.std]),
        "reference_gains": references.gains,
        "reference_matrix": references.matrix,
        "reference_constant": references.constant,
    }


def _header(model: MotionModel, image: KernelImage) -> dict[str, Any]:
    layout, config = model.controls, model.config
    assert isinstance(config, ModelConfig)  # other configs cannot run in the kernels
    return {
        "format": FORMAT,
        "fps": model.fps,
        "step": STEP,
        "features": FEATURE_COUNT,
        "contacts": CONTACT_COUNT,
        "window": config.window,
        "kernel": config.kernel,
        "base": BASE,
        "moved": image.moved,
        "addresses": image.addresses,
        "fields": image.fields,
        "controls": {
            "size": layout.size,
            "types": layout.type.start,
            "trajectory": layout.trajectory.start,
            "mask": layout.flag,
            "phase": layout.phase.start,
            "reference": layout.reference.start,
            "gain": layout.reference_gain,
        },
        "stands_below": STANDS_BELOW,
        "start": model_first_type(model),
        "slot": image.slot,
        "bvh": dict(zip(("hierarchy", "order"), bvh_hierarchy(model.character("default")), strict=True)),
    }


def _types(model: MotionModel, tracks: dict[str, list[Track]]) -> list[dict[str, Any]]:
    """Every type with its tracks; `from` counts through the arrays in the same order."""
    out, at = [], 0
    for name, kind in model.types.items():
        gait, entries = kind.gait, []
        for track in tracks[name]:
            entries.append(
                {
                    "from": at,
                    "frames": len(track),
                    "performance": track.performance,
                    "speed": round(track.speed, 1),
                }
            )
            at += len(track)
        out.append(
            {
                "name": name,
                "gait": None if gait is None else {"speed": gait.speed, "facing": gait.facing},
                "seconds": model.phase_seconds(name),
                "steered": kind.kind.steered,
                "stands": kind.kind is MotionKind.STANCE,
                "lateral": round(lateral_limit(model, name), 1),
                "performed": kind.kind is MotionKind.PERFORMANCE,
                "gain": kind.preset.reference_gain if model.uses_references else 0.0,
                "tracks": entries,
            }
        )
    return out


def _end_to_end(tracks: list[Array]) -> list[Array]:
    """Tracks (L, 3), each moved to the end of the previous one; only steps within a track matter."""
    out: list[Array] = []
    for track in tracks:
        out.append(track + np.append(out[-1][-1, :2], 0.0) if out else track)
    return out


def _differences(tracks: list[Array], columns: int) -> bytes:
    """Rows (L, columns) of tracks, by column, as differences from the previous row in units of STEP."""
    rows = np.concatenate([np.zeros((0, columns)), *tracks])
    steps = np.diff(np.rint(rows.T / STEP), axis=1, prepend=0.0)
    assert steps.size == 0 or np.abs(steps).max() < 2**15
    return _sorted_bytes(steps.astype("<i2").tobytes())


def _sorted_bytes(data: bytes) -> bytes:
    """The low bytes of all 16-bit words, then the high bytes."""
    rows = np.frombuffer(data + bytes(len(data) % 2), np.uint8).reshape(-1, 2)
    return rows.T.tobytes()
