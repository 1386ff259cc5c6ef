"""Held-out sequences continued by a network side by side, on any device: one step of the network moves all of them.

The frames are those of continued (lab/held_out.py) for a network with the paper's controls, but for their random
numbers: there each character is a stream of its own, in numpy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from motionkit.arrays import Array, Floats
from motionkit.data.dataset import Clip, ClipData, Dataset
from motionkit.features.control import ControlLayout, control_vector, future_trajectory, skeleton_signal
from motionkit.features.layout import FEATURE_COUNT
from motionkit.features.reference import reference_map
from motionkit.inference.start import INIT_FRAMES
from motionkit.lab.held_out import HeldOut
from motionkit.lab.paper.protocol import recorded_controls
from motionkit.models.batch import FeatureSpace
from motionkit.models.predictor import Predictor
from motionkit.motion.contacts import CONTACT_HEIGHTS, CONTACT_SPEED
from motionkit.motion.skeleton import FOOT_JOINTS


@dataclass(frozen=True, eq=False)
class Recorded:
    """What a network is given of a recording, normalised.

    Attributes:
        x: (T, 276) features.
        controls: (T, C), with the recording's own types and trajectory, and without reference poses.
        trajectory: (T, 24) of every frame.
    """

    x: Floats
    contacts: Floats
    controls: Floats
    trajectory: Floats


def recorded(dataset: Dataset, clip: Clip, data: ClipData, kind: str) -> Recorded:
    """Return what a network with control signals of a kind is given of a clip."""
    layout, scaling = ControlLayout(dataset.types, kind), dataset.trajectory_scaling
    x = dataset.scaling.normalize(data.features)
    controls = control_vector(
        layout,
        skeleton_signal(dataset.skeleton(clip)),
        recorded_controls(data, np.arange(len(dataset.types))),
        x,
        scaling,
        reference_map(dataset.pose_embedding, dataset.scaling),
    )
    trajectory = scaling.normalize(future_trajectory(data.ground, np.arange(len(x))))
    arrays = (x, data.contacts, controls, trajectory)
    return Recorded(*(np.ascontiguousarray(each, np.float32) for each in arrays))


def roll_out(
    network: Predictor,
    dataset: Dataset,
    sequences: Sequence[HeldOut],
    draws: Sequence[int | None],
    device: torch.device | str,
    labelled: bool = False,
) -> list[Floats]:
    """Return unnormalised features (T, 276) that a network makes after the initial frames of each sequence.

    Args:
        network: on the device, in evaluation mode.
        sequences: with at most INIT_FRAMES initial frames shown, and the controls of the recording.
        draws: for each sequence the seed of its random numbers, which are the same on all devices; None for the mean.
        labelled: feed contacts back that are labelled by height and speed of the feet, not the network's, for one
            that was not trained to predict them.
    """
    counts = [min(each.initial, INIT_FRAMES) for each in sequences]
    out: dict[int, Floats] = {}
    for initial in sorted(set(counts)):
        rows = [i for i, count in enumerate(counts) if count == initial]
        batch = _Batch(network, dataset, [sequences[i] for i in rows], [draws[i] for i in rows], device)
        made = dataset.scaling.denormalize(batch.run(initial, labelled).cpu().numpy())
        out |= {i: made[n, : sequences[i].frames] for n, i in enumerate(rows)}
    return [out[i] for i in range(len(sequences))]


class _Batch:
    """Sequences with as many shown frames, as tensors on a device."""

    def __init__(
        self,
        network: Predictor,
        dataset: Dataset,
        sequences: Sequence[HeldOut],
        draws: Sequence[int | None],
        device: torch.device | str,
    ) -> None:
        self.network = network
        self.space = FeatureSpace.of(dataset).to(torch.device(device))
        self.frames = max(each.frames for each in sequences)
        rows = [_rows(dataset, each, network.config.controls, self.frames) for each in sequences]
        self.x, self.contacts, self.controls = (
            torch.from_numpy(np.stack(arrays)).to(device) for arrays in zip(*rows, strict=True)
        )
        noise = np.stack([_noise(seed, self.frames, FEATURE_COUNT + network.latent_size) for seed in draws])
        self.noise = torch.from_numpy(noise).to(device)
        columns = dataset.layout
        self.heights = torch.tensor(columns.indices("joint_positions", FOOT_JOINTS, (1,)), device=device)
        self.speeds = torch.tensor(columns.indices("joint_velocities", FOOT_JOINTS), device=device)

    @torch.inference_mode()
    def run(self, initial: int, labelled: bool) -> Tensor:
        """Return normalised frames (B, T, 276) after the given ones."""
        stream = self.network.stream(len(self.x))
        stream.reset(initial - 1)
        for t in range(initial - 1):
            stream.step(self.x[:, t], self.contacts[:, t], self.controls[:, t])
        frame, contacts, made = self.x[:, initial - 1], self.contacts[:, initial - 1], []
        for t in range(self.frames):
            drawn, latent = self.noise[:, t, :FEATURE_COUNT], self.noise[:, t, FEATURE_COUNT:]
            controls = self.controls[:, initial - 1 + t]
            predicted = stream.step(frame, contacts, controls, latent if self.network.latent_size else None)
            frame = predicted.mean + drawn * torch.exp(predicted.log_sigma)
            contacts = self._labels(frame) if labelled else torch.sigmoid(predicted.contact_logits)
            made.append(frame)
        return torch.stack(made, dim=1)

    def _labels(self, frame: Tensor) -> Tensor:
        """Contacts (B, 4) of normalised frames, by the limits of the recordings' own labels."""
        features = self.space.denormalize(frame)
        limits = frame.new_tensor(CONTACT_HEIGHTS)
        speeds = torch.linalg.vector_norm(features[:, self.speeds], dim=-1)
        return ((features[:, self.heights[:, 0]] < limits) & (speeds < CONTACT_SPEED)).float()


def _rows(dataset: Dataset, sequence: HeldOut, kind: str, frames: int) -> tuple[Array, Array, Array]:
    """Initial frames, their contacts, and the controls of these and of the frames to make, the last one repeated."""
    whole = recorded(dataset, sequence.clip, sequence.data, kind)
    first = sequence.initial - min(sequence.initial, INIT_FRAMES)
    seen = slice(first, sequence.initial)
    rows = np.minimum(np.arange(first, sequence.initial + frames), len(whole.x) - 1)
    return whole.x[seen], whole.contacts[seen], whole.controls[rows]


def _noise(seed: int | None, frames: int, size: int) -> Floats:
    """Normal numbers (T, N); zeros without a seed."""
    if seed is None:
        return np.zeros((frames, size), np.float32)
    return np.random.default_rng(seed).standard_normal((frames, size), np.float32)
