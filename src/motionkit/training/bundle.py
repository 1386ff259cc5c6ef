"""Puts a trained network together with all it needs to run: scaling, bodies, and frames to start from."""

from __future__ import annotations

from typing import Any

import torch

from motionkit.data.dataset import Dataset
from motionkit.models.checkpoint import MotionModel, Seed
from motionkit.models.network import PartTransformer
from motionkit.motion.skeleton import canonical_skeleton

SEED_FRAMES = 30  # the paper's number of initial frames for synthesis
SEEDS_PER_TYPE = 3


def bundle_model(network: PartTransformer, dataset: Dataset, card: dict[str, Any]) -> MotionModel:
    """The model file's content for a network trained on a dataset."""
    characters = {"default": canonical_skeleton().offsets}
    for i, body in enumerate(dataset.bodies):
        if not torch.allclose(body, characters["default"]):
            characters[f"body-{i + 1}"] = body
    return MotionModel(
        network,
        dataset.types,
        dataset.fps,
        dataset.scaling,
        dataset.trajectory_scaling,
        dataset.references,
        characters,
        {kind: seed_frames(dataset, kind) for kind in dataset.types},
        card,
    )


def seed_frames(dataset: Dataset, kind: str) -> list[Seed]:
    """A few starts of a type: the first frames of its longest stretches in different training clips.

    A type without a training clip, which a model cannot know, takes any clip's frames.
    """
    wanted = dataset.types.index(kind)
    stretches = []
    for clip in dataset.select("train"):
        frames = torch.nonzero(dataset.clip_types(clip) == wanted).flatten()
        if len(frames):
            stretches.append((len(frames), int(frames[0]), clip))
    stretches.sort(key=lambda s: (-s[0], s[2].name))
    if not stretches:
        stretches = [(clip.frames, 0, clip) for clip in dataset.select("train")[:1]]
    seeds = []
    for length, first, clip in stretches[:SEEDS_PER_TYPE]:
        data = dataset.read(clip, first, first + min(length, SEED_FRAMES))
        seeds.append(Seed(data.features, data.contacts, data.ground))
    return seeds
