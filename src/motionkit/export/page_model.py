"""A model as the one file that a page in a browser runs (web/src/demo): the memory of the C kernels, and what is
around them.

The file is a header in JSON, its length as 4 bytes before it, and arrays, deflated one by one. Before that their bytes
are sorted: the lowest ones of all numbers, then the next ones. Poses and places of reference clips are columns, and
differences from frame to frame of floats whose bits are taken for whole numbers. Both make them smaller.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections import Counter
from typing import Any

import numpy as np

from motionkit.arrays import Array, spans
from motionkit.control.motion_index import MotionIndex
from motionkit.control.recording_choice import Entries, RecordingChoice, few_clips
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.inference.character import model_first_type
from motionkit.inference.kernel_image import BASE, KernelImage, kernel_image
from motionkit.inference.noise import Noise
from motionkit.inference.start import type_start
from motionkit.inference.step_weights import pack
from motionkit.models.config import ModelConfig
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind, MotionType, ReferenceClip
from motionkit.motion.skeleton import Skeleton

FORMAT = "motionkit-page-2"


def page_model(model: MotionModel) -> bytes:
    """The file of a model, for characters with its default body.

    Raises:
        ModelError: for a network that the C kernels cannot run.
    """
    image = kernel_image(model, Noise())
    arrays: dict[str, dict[str, Any]] = {}
    body = bytearray()
    clips = _shown_clips(model)
    floats = {
        **_frame_arrays(model),
        "phases": _joined([clip.phases for clip in clips if _phased(clip)], 1),
    }
    stored: dict[str, tuple[str, bytes]] = {
        "shared": ("u1", _sorted_bytes(image.shared)),
        "own": ("u1", _sorted_bytes(image.own)),
        "poses": ("d2", _differences(_joined([clip.poses for clip in clips], 24), 2)),
        "ground": ("d4", _differences(_joined([clip.ground for clip in clips], 3), 4)),
        **{name: ("f4", _sorted_bytes(array.astype("<f4").tobytes())) for name, array in floats.items()},
    }
    for name, (kind, data) in stored.items():
        packed = zlib.compress(data, 9)
        arrays[name] = {"type": kind, "bytes": len(data), "from": len(body), "to": len(body) + len(packed)}
        body += packed
    header = json.dumps({**_header(model, image), "arrays": arrays}, separators=(",", ":")).encode()
    return struct.pack("<I", len(header)) + header + bytes(body)


def _frame_arrays(model: MotionModel) -> dict[str, Array]:
    """What a page needs around the kernels of a frame."""
    start = type_start(model, model_first_type(model))
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
        "start": model.scaling.normalize(start.features[0]),
        "start_contacts": start.contacts[0],
    }


def _header(model: MotionModel, image: KernelImage) -> dict[str, Any]:
    layout, kind, config = model.controls, model_first_type(model), model.config
    assert isinstance(config, ModelConfig)  # the kernels run no other
    return {
        "format": FORMAT,
        "fps": model.fps,
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
        "start": {"type": kind, "phase_frames": model.phase_seconds(kind) * model.fps},
        "types": _types(model),
        "skeleton": _skeleton(model.character("default")),
    }


def _skeleton(skeleton: Skeleton) -> dict[str, Any]:
    return {
        "joints": list(skeleton.names),
        "parents": list(skeleton.parents),
        "offsets": skeleton.offsets.tolist(),
        "ends": {str(joint): list(end) for joint, end in skeleton.end_sites.items()},
    }


def _types(model: MotionModel) -> list[dict[str, Any]]:
    """Every type with its reference clips, which count on through the arrays in the same order."""
    recordings, rows = RecordingChoice(model), Counter[str]()
    out = []
    for name, known in model.types.items():
        gait, clips = known.gait, _clips(known, model.fps)
        shown = _clip_entries(clips, recordings.entry_frames(name, clips), rows) if clips else []
        out.append(
            {
                "name": name,
                "gait": None if gait is None else {"speed": gait.speed, "facing": gait.facing},
                "seconds": model.phase_seconds(name),
                "steered": known.kind.steered,
                "speeds": model.speed_range(name),
                "performed": known.kind is MotionKind.PERFORMANCE,
                "phased": known.kind.phased,
                "gain": known.preset.reference_gain if model.uses_references else 0.0,
                "clips": [] if known.kind.steered else shown,
                "first": shown if known.kind.steered else [],
            }
        )
    return out


def _clip_entries(
    clips: tuple[ReferenceClip, ...], may_enter: Entries, rows: Counter[str]
) -> list[dict[str, Any]]:
    """The clips of a type: where their rows begin in the arrays, and which frames may be entered.

    rows counts those of the clips before in each array, and is moved on.
    """
    entries = {id(clip): frames for clip, frames in may_enter}
    index = MotionIndex(clips)
    out = []
    for clip, first in zip(clips, index.first, strict=True):
        entered = np.zeros(len(clip), bool)
        entered[entries.get(id(clip), [])] = True
        out.append(
            {
                "frames": len(clip),
                "rows": len(clip.poses),
                "poses": rows["poses"],
                "phases": rows["phases"] if _phased(clip) else None,
                "ground": rows["ground"],
                "performed": clip.performed,
                "entries": spans(entered),
                "pace": clip.pace,
                "moves": spans(index.moves[first : first + len(clip)]),
            }
        )
        rows.update(poses=len(clip.poses), phases=len(clip) * _phased(clip), ground=len(clip))
    return out


def _clips(known: MotionType, fps: float) -> tuple[ReferenceClip, ...]:
    """The reference clips of a type that a page shows: gaits are steered without, but for their first steps."""
    if known.kind.steered:
        return few_clips(known.reference_clips, fps) if known.kind is MotionKind.GAIT else ()
    return known.reference_clips


def _shown_clips(model: MotionModel) -> list[ReferenceClip]:
    return [clip for kind in model.types.values() for clip in _clips(kind, model.fps)]


def _phased(clip: ReferenceClip) -> bool:
    return bool((clip.phases >= 0.0).any())


def _joined(arrays: list[Array], columns: int) -> Array:
    return np.concatenate(arrays) if arrays else np.zeros((0, columns), np.float32)


def _differences(values: Array, width: int) -> bytes:
    """Rows as floats of 2 or 4 bytes, column by column: the difference of their bits from those before, sorted."""
    bits = np.ascontiguousarray(values.astype(f"<f{width}").T).view(f"<u{width}").astype(np.int64)
    steps = np.diff(bits, axis=1, prepend=0) & ((1 << 8 * width) - 1)
    return _sorted_bytes(steps.astype(f"<u{width}").tobytes(), width)


def _sorted_bytes(data: bytes, width: int = 2) -> bytes:
    """The first bytes of all numbers of so many bytes, then the second ones, and so on."""
    rows = np.frombuffer(data + bytes(-len(data) % width), np.uint8).reshape(-1, width)
    return rows.T.tobytes()
