"""Frames to start from: the model's own seeds, or the beginning of a user's clip."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import ControlError
from motionkit.features.encode import encode_motion
from motionkit.models.model import MotionModel
from motionkit.motion.motion import resample

INIT_FRAMES = 87  # the receptive field; the paper's number for its comparisons


@dataclass(frozen=True, eq=False)
class Start:
    """Frames B characters start from: features (B, T, 276), contacts (B, T, 4), place of the last one (B, 3)."""

    features: Array
    contacts: Array
    ground: Array


def type_start(model: MotionModel, kind: str | list[str], count: int) -> Start:
    """Start poses of a type for count characters in turn, at the origin facing +Z.

    Of several types each character takes the next one, and of its type the next start pose.
    """
    kinds = [kind] if isinstance(kind, str) else kind
    chosen = []
    for i in range(count):
        name = kinds[i % len(kinds)]
        known = model.types.get(name)
        if known is None or not known.start_poses:
            raise ControlError(f"the model has no frames to start {name!r} from")
        chosen.append(known.start_poses[i // len(kinds) % len(known.start_poses)])
    frames = min(len(seed.features) for seed in chosen)
    return Start(
        np.stack([seed.features[:frames] for seed in chosen]),
        np.stack([seed.contacts[:frames] for seed in chosen]),
        np.zeros((count, 3), np.float32),
    )


def clip_start(model: MotionModel, path: str | Path, count: int) -> Start:
    """The first frames of a BVH file, any rig, for count characters that go on where the last of them is.

    Raises MotionkitError if the file cannot be used.
    """
    from motionkit.motion.retarget import retarget_file

    motion, _ = retarget_file(path)
    motion = resample(motion, model.fps)
    if len(motion) < 2:
        raise ControlError(f"{path}: expected at least 2 frames to start from, found {len(motion)}")
    motion = motion.cut(0, INIT_FRAMES)
    encoded = encode_motion(motion, model.reference_rotations, model.config.layout)
    return Start(
        encoded.features[None].repeat(count, axis=0),
        encoded.contacts[None].repeat(count, axis=0),
        encoded.ground[-1:].repeat(count, axis=0),
    )
