"""Maps names in model files of the first releases (motionkit-model-3) to the present ones."""

from __future__ import annotations

from typing import Any

FORMER_FORMAT = "motionkit-model-3"
HEADER_KEYS = {
    "seeds": "start_poses",
    "outlines": "reference_clips",
    "guides": "uses_references",
    "guidance": "reference_gain",
    "noise": "noise_scale",
    "inertia": "velocity_blend",
    "grip": "slip_correction",
}
TENSOR_PREFIXES = {
    "outline.matrix": "pose_embedding.matrix",
    "outline.offset": "pose_embedding.offset",
    "outline.": "reference_clip.",
    "seed.": "start_pose.",
    "references": "reference_rotations",
}


def renamed_header(header: dict[str, Any]) -> dict[str, Any]:
    """Return the header of a former file with the present keys, in the same order."""
    return {HEADER_KEYS.get(key, key): value for key, value in header.items()}


def renamed_tensor(name: str) -> str:
    """Return the present name of a tensor in a former file."""
    for former, present in TENSOR_PREFIXES.items():
        if name.startswith(former):
            return present + name.removeprefix(former)
    return name
