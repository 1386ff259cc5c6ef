"""Frames to start from: the model's own seeds, or the beginning of a user's clip."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from motionkit.errors import ControlError
from motionkit.features.encode import encode_motion
from motionkit.models.checkpoint import MotionModel
from motionkit.motion.motion import resample

INIT_FRAMES = 87  # the receptive field; the paper's number for its comparisons


def seed_start(model: MotionModel, kind: str, count: int) -> tuple[Tensor, Tensor]:
    """The seeds of a type for count characters in turn: features (B, T, 276), contacts (B, T, 4)."""
    seeds = model.seeds.get(kind)
    if not seeds:
        raise ControlError(f"the model has no frames to start {kind!r} from")
    chosen = [seeds[i % len(seeds)] for i in range(count)]
    frames = min(len(seed.features) for seed in chosen)
    return (
        torch.stack([seed.features[:frames] for seed in chosen]),
        torch.stack([seed.contacts[:frames] for seed in chosen]),
    )


def clip_start(model: MotionModel, path: str | Path, count: int) -> tuple[Tensor, Tensor]:
    """The first frames of a BVH file, any rig, for count characters; raises MotionkitError if it cannot be used."""
    from motionkit.motion.retarget import retarget_file

    motion, _ = retarget_file(path)
    motion = resample(motion, model.fps)
    if len(motion) < 2:
        raise ControlError(f"{path}: expected at least 2 frames to start from, found {len(motion)}")
    motion = motion.cut(0, INIT_FRAMES)
    encoded = encode_motion(motion, model.references, model.config.layout)
    return encoded.features.expand(count, -1, -1), encoded.contacts.expand(count, -1, -1)
