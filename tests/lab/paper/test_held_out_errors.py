"""Errors and likelihood on held-out clips, against networks whose answers are known, and against other roll-outs."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from motionkit.data.dataset import Dataset
from motionkit.features.control import ControlLayout
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.inference.noise import Noise
from motionkit.lab import held_out as protocol
from motionkit.lab.held_out import continued, held_out
from motionkit.lab.networks.baseline import MemorylessStream
from motionkit.lab.paper.batched_rollouts import _Batch, roll_out
from motionkit.lab.paper.datasets import select
from motionkit.lab.paper.held_out_errors import (
    FEWEST,
    WINDOW,
    _predicted,
    held_out_errors,
    open_loop_starts,
)
from motionkit.lab.paper.protocol import means, sequence_controls
from motionkit.lab.statistics import rounded
from motionkit.models.architectures import network_class
from motionkit.models.checkpoint import load_model
from motionkit.models.config import ModelConfig
from motionkit.models.network import Prediction
from motionkit.models.predictor import Predictor
from motionkit.models.presets import preset
from motionkit.training.presets import train_options
from motionkit.training.trainer import train

SIZES = {
    "tptn-paper": {"width": 48, "heads": 4, "ffn": 96, "layers": 2, "control_width": 16, "control_embedding": 24,
                   "shared_channels": 12},
    "pfnn": {"hidden": 16},
    "htss": {"part": 4, "limb": 8, "body": 16, "decoder": 8},
}  # fmt: skip


@pytest.fixture(scope="module")
def dataset(paper_folder: Path) -> Dataset:
    return select(paper_folder, "all")


@pytest.mark.parametrize("name", ["learned-motion-matching", "pfnn"])
def test_every_given_frame_is_looked_at(name: str) -> None:
    """Also by networks that in roll-outs search now and then, or step by a phase of their own."""
    torch.manual_seed(0)
    size = ControlLayout(("walking", "running"), "paper").size
    network = network_class(name)(preset(name, hidden=16), size).eval()
    x, controls = torch.randn(1, WINDOW, FEATURE_COUNT), torch.randn(1, WINDOW, size)
    contacts = torch.rand(1, WINDOW, CONTACT_COUNT).round()
    first = _predicted(network, x, contacts, controls).mean
    x[:, 45], contacts[:, 40:80] = torch.randn(1, FEATURE_COUNT), 1.0 - contacts[:, 40:80]
    other = _predicted(network, x, contacts, controls).mean
    assert not torch.equal(first[:, 45], other[:, 45]) and torch.equal(first[:, :40], other[:, :40])


class Copying(Predictor):
    """Repeats the frame and the trajectory that it is given, with a sigma of two values."""

    config_class = ModelConfig

    def stream(self, batch: int) -> MemorylessStream:
        sigma = torch.tensor([math.log(0.5), math.log(2.0)] * (FEATURE_COUNT // 2))
        path = ControlLayout.trajectory_columns("paper", self.control_size)

        def predict(x: Tensor, contacts: Tensor, controls: Tensor, latent: Tensor | None) -> Prediction:
            given = controls[:, path]
            return Prediction(
                x,
                sigma.expand_as(x),
                torch.zeros(len(x), CONTACT_COUNT),
                given,
                torch.zeros_like(given),
                x,
                x,
            )

        return MemorylessStream(predict)  # type: ignore[arg-type]


def test_a_network_that_copies_has_the_error_of_copying(dataset: Dataset) -> None:
    size = ControlLayout(dataset.types, "paper").size
    found = held_out_errors(Copying(preset("tptn-paper"), size), dataset)
    assert found["error"] == found["copy"] != found["extrapolation"]
    assert (
        "nll" in found and "nll-trajectory" not in found
    )  # a sigma that is always the same is no prediction
    frames = [(clip.frames, dataset.read(clip)) for clip in dataset.select("test")]
    assert found["frames"] == sum(max(0, count - FEWEST) for count, _ in frames)
    steps = [np.diff(dataset.scaling.normalize(data.features)[FEWEST - 1 :], axis=0) for _, data in frames]
    off = np.concatenate(steps).astype(np.float64) / np.array([0.5, 2.0] * (FEATURE_COUNT // 2))
    likelihood = 0.5 * np.square(off).sum(-1).mean() + FEATURE_COUNT * 0.5 * math.log(2.0 * math.pi)
    assert found["nll"] == pytest.approx(likelihood, rel=1e-4)
    # It stands still, so its joints move by nothing, and after a while the body is elsewhere.
    assert found["bm"]["mean"] == pytest.approx(0.0, abs=30.0) and found["bm"]["recorded"] > 0.0
    way = found["open-loop"]["mean"]
    assert (
        found["starts"] == len(open_loop_starts(dataset)) > 0 and 0.0 < way["mpjpe-0.25"] < way["mpjpe-1"] * 3
    )


@pytest.mark.parametrize("name", SIZES)
def test_batched_roll_outs_are_those_of_one_character_at_a_time(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    options = train_options(
        name, steps=3, batch=2, window=24, precision="float32", score_seconds=0.0, config=SIZES[name]
    )
    train(dataset, tmp_path / "m.safetensors", options, device="cpu")
    model = load_model(tmp_path / "m.safetensors")
    network = network_class(model.config.architecture).from_weights(model.network)
    sequences = [replace(each, frames=each.frames - i) for i, each in enumerate(held_out(dataset, 40)[:3])]
    made = roll_out(network, dataset, sequences, [None] * len(sequences), "cpu")
    monkeypatch.setattr(protocol, "default_noise", lambda model: Noise("mean", 1.0))
    for each, features in zip(sequences, made, strict=True):
        asked, body = sequence_controls(dataset, each, model), dataset.skeleton(each.clip)
        alone = continued(model, each, body, asked, each.frames, 0)
        assert np.abs(dataset.scaling.normalize(features) - dataset.scaling.normalize(alone)).max() < 1e-3


def test_a_seed_draws_the_same_frames_beside_other_sequences(dataset: Dataset) -> None:
    torch.manual_seed(0)
    config = preset("tptn-paper", **SIZES["tptn-paper"])
    network = network_class(config.architecture)(config, ControlLayout(dataset.types, "paper").size).eval()
    one, two = held_out(dataset, 30)[:2]
    together = roll_out(network, dataset, [one, two, one], [5, 6, 7], "cpu")
    alone = roll_out(network, dataset, [one], [5], "cpu")
    np.testing.assert_allclose(together[0], alone[0], atol=1e-2)
    assert np.abs(together[0] - together[2]).max() > 1.0
    assert held_out_errors(network, dataset, seed=1) == held_out_errors(network, dataset, seed=1)


def test_contacts_are_labelled_as_recordings_are(dataset: Dataset) -> None:
    network = Copying(preset("tptn-paper"), ControlLayout(dataset.types, "paper").size)
    agreed, shares = [], []
    for each in held_out(dataset, 30):
        batch = _Batch(network, dataset, [each], [None], "cpu")
        recorded, labels = batch.contacts[0], batch._labels(batch.x[0])
        agreed.append((recorded == labels).float().mean())
        shares.append(recorded.mean())
    assert 0.1 < np.mean(shares) < 0.9 and np.mean(agreed) > 0.9


def test_rounding_is_the_laboratorys(dataset: Dataset) -> None:
    found = held_out_errors(
        Copying(preset("tptn-paper"), ControlLayout(dataset.types, "paper").size), dataset
    )
    assert all(value == rounded(value, 5) for value in found["error"].values())


def test_means_compare_the_same_sequences() -> None:
    """A body whose toes never touch the floor leaves the recorded mean, too; else floating would look better."""
    values = ([None, 0.3, None], [0.1, 0.1, 2.0], [0.2, None, 4.0])
    rows = [
        {"frames": 60, "values": {"skate": [made, real], "count": [more, None]}}
        for made, real, more in values
    ]
    assert means(rows) == {"skate": [0.1, 0.1], "count": [3.0, None]}
