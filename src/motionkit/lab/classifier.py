"""An action classifier of a dataset's types, and what papers measure with one (Guo et al. 2020, Action2Motion).

A window of a second is described by the first cosine coefficients over time of joint positions in the heading frame and
of the velocity over the ground. A network with one hidden layer predicts the type; the hidden values are the features.
Values compare models that were measured against the same recordings.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F

from motionkit.arrays import Array, Floats
from motionkit.data.dataset import Dataset
from motionkit.errors import DatasetError
from motionkit.metrics.body import Body, body_of
from motionkit.metrics.distribution import frechet_distance, multimodality
from motionkit.metrics.value import MetricValue, measured
from motionkit.training.verdict.real import mirrored_poses

SECONDS, STRIDE = 1.0, 10  # of a window; frames between two windows
EVERY, COEFFICIENTS = 2, 8  # frames between samples, and cosine coefficients of each value
WIDTH, STEPS, BATCH, RATE, NOISE = 64, 400, 256, 3e-3, 0.3  # of the network and its training
UNITS = {"class-accuracy": "", "fid-class": "", "multimodality": ""}


@dataclass(frozen=True, eq=False)
class Classifier:
    """A trained classifier.

    Attributes:
        mean, std: of the descriptions of the windows that it was trained on.
        layers: weights and biases of the hidden and of the last layer.
    """

    types: tuple[str, ...]
    mean: Array
    std: Array
    layers: tuple[Array, Array, Array, Array]

    def features(self, windows: Array) -> Array:
        """Return the hidden outputs (W, WIDTH) of descriptions (W, D)."""
        weight, bias = self.layers[:2]
        return np.tanh((windows - self.mean) / self.std @ weight + bias)

    def share(self, features: Array, kind: str) -> float:
        """Return the share of windows, given by their features, that are taken for a type."""
        weight, bias = self.layers[2:]
        return float(((features @ weight + bias).argmax(axis=1) == self.types.index(kind)).mean())


def described(body: Body, mirrored: bool = False) -> Floats:
    """Return the descriptions (W, D) of a body's windows, or of its mirror image's; none if it is too short."""
    poses, velocity = body.poses(EVERY), body.velocity[::EVERY]
    if mirrored:
        poses, velocity = mirrored_poses(poses), velocity * np.array([-1.0, 1.0], np.float32)
    rows = np.concatenate([poses, 100.0 * velocity], axis=1)
    size = round(SECONDS * body.fps / EVERY)
    at = np.arange(0, len(rows) - size + 1, STRIDE // EVERY)
    waves = np.cos(np.pi / size * (np.arange(size) + 0.5) * np.arange(COEFFICIENTS)[:, None]) / size
    windows = rows[at[:, None] + np.arange(size)]  # (W, size, 71)
    return (
        np.einsum("ct,wtv->wcv", waves, windows)
        .reshape(len(at), COEFFICIENTS * rows.shape[1])
        .astype(np.float32)
    )


def recorded_windows(dataset: Dataset, split: str, mirrored: bool = False) -> dict[str, Floats]:
    """Return the descriptions of the recordings of each type in a split, with their mirror images if mirrored.

    A mirror image whose recording is in another split stands for it then, and has no mirror image: that is the
    recording.
    """
    found: dict[str, list[Floats]] = {}
    elsewhere = {clip.start for clip in dataset.clips if clip.split != split}
    recordings = {clip.start for clip in dataset.select(split) if not clip.mirrored}
    for clip, start, end, kind in dataset.stretches(split):
        if not clip.mirrored or (mirrored and clip.start not in recordings):
            body = body_of(dataset.motion(clip, dataset.read(clip, start, end)))
            found.setdefault(kind, []).append(described(body))
            if mirrored and clip.start not in elsewhere:
                other = dataset.types[dataset.mirrored_type_ids[dataset.types.index(kind)]]
                found.setdefault(other, []).append(described(body, True))
    return {kind: np.concatenate(parts) for kind, parts in found.items() if sum(map(len, parts))}


def train_classifier(dataset: Dataset, seed: int = 0) -> Classifier:
    """Train a classifier on the training clips of a dataset and their mirror images; types are drawn equally often.

    Raises:
        DatasetError: fewer than two types have a window.
    """
    windows = recorded_windows(dataset, "train", mirrored=True)
    if len(windows) < 2:
        raise DatasetError(f"{dataset.folder}: a classifier needs two types with clips of {SECONDS:g} s")
    whole = np.concatenate(list(windows.values()))
    mean, std = whole.mean(axis=0), whole.std(axis=0)
    std = np.maximum(std, 0.1 * std.mean())
    random = torch.Generator().manual_seed(seed)
    rows_of_all = torch.from_numpy((whole - mean) / std)
    counts = torch.tensor([len(rows) for rows in windows.values()])
    starts = counts.cumsum(0) - counts
    inputs, outputs = len(mean), len(windows)
    first = torch.randn(inputs, WIDTH, generator=random) / inputs**0.5
    second = torch.randn(WIDTH, outputs, generator=random) / WIDTH**0.5
    layers = [first, torch.zeros(WIDTH), second, torch.zeros(outputs)]
    optimizer = torch.optim.AdamW([layer.requires_grad_() for layer in layers], RATE, weight_decay=0.1)
    for _ in range(STEPS):
        kinds = torch.randint(outputs, (BATCH,), generator=random)
        places = (torch.rand(BATCH, generator=random) * counts[kinds]).long()
        rows = rows_of_all[starts[kinds] + places]
        rows = rows + NOISE * torch.randn(rows.shape, generator=random)
        hidden = torch.tanh(rows @ layers[0] + layers[1])
        loss = F.cross_entropy(hidden @ layers[2] + layers[3], kinds)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    arrays = [layer.detach().numpy() for layer in layers]
    return Classifier(tuple(windows), mean, std, (arrays[0], arrays[1], arrays[2], arrays[3]))


def classified(
    classifier: Classifier, made: Mapping[str, Sequence[Array]], real: Iterable[Array]
) -> dict[str, MetricValue]:
    """Return "class-accuracy", "fid-class" and "multimodality" of the descriptions of motions by their type.

    The Frechet distance is that to the descriptions of recordings.
    """
    features = {
        kind: [classifier.features(rows) for rows in rows_of if len(rows)] for kind, rows_of in made.items()
    }
    features = {kind: each for kind, each in features.items() if each}
    together = [rows for each in features.values() for rows in each]
    right = [(classifier.share(np.concatenate(each), kind), sum(map(len, each))) for kind, each in features.items()
             if kind in classifier.types]  # fmt: skip
    count = sum(number for _, number in right)
    accuracy = sum(share * number for share, number in right) / count if count else None
    recorded = [classifier.features(rows) for rows in real if len(rows)]
    empty = np.zeros((0, WIDTH), np.float32)

    def distance() -> MetricValue:
        mine, theirs = (np.concatenate(each or [empty]) for each in (together, recorded))
        return frechet_distance(mine, theirs, "fid-class")

    values = [
        MetricValue(
            "class-accuracy", accuracy, "", reason=None if count else "no window is as long as a second"
        ),
        *measured(distance, {"fid-class": ""}),
        *measured(lambda: multimodality(list(features.values())), {"multimodality": ""}),
    ]
    return {value.id: value for value in values}
