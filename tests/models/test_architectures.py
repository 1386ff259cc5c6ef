"""Another architecture is one file: a small one here is trained, saved, loaded and rolled out."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from motionkit.control.script import parse_types
from motionkit.control.synthesize import SynthesisOptions, synthesize
from motionkit.errors import ModelError
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.inference.noise import Noise
from motionkit.models.architectures import ARCHITECTURES, config_from_dict
from motionkit.models.batch import Batch, FeatureSpace
from motionkit.models.checkpoint import load_model, read_header
from motionkit.models.predictor import NextFrame, Predictor
from motionkit.training.trainer import train


@dataclass(frozen=True)
class EchoConfig:
    hidden: int = 8
    layout: str = "sixd-root-1"
    architecture: str = "echo"
    controls: str = "extended"

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> EchoConfig:
        return cls(**values)


class Echo(Predictor):
    """The last frame, plus a linear map of it and of a latent number."""

    config_class = EchoConfig
    latent_size = 1

    def __init__(self, config: EchoConfig, control_size: int) -> None:
        super().__init__(config, control_size)
        self.map = nn.Linear(FEATURE_COUNT + control_size + 1, FEATURE_COUNT)

    def next(self, x: Tensor, controls: Tensor, latent: Tensor) -> Tensor:
        return 0.9 * x + 0.1 * self.map(torch.cat([x, controls, latent], dim=-1))

    def losses(self, batch: Batch, space: FeatureSpace, progress: float) -> dict[str, Tensor]:
        assert 0.0 <= progress <= 1.0
        latent = torch.zeros_like(batch.inputs[..., :1])
        return {"l2": (self.next(batch.inputs, batch.controls, latent) - batch.targets).square().mean()}

    def stream(self, batch: int) -> EchoStream:
        return EchoStream(self)


class EchoStream:
    def __init__(self, network: Echo) -> None:
        self.network = network

    def reset(self, given: int = 0) -> None:
        pass

    def step(self, x: Tensor, contacts: Tensor, controls: Tensor, latent: Tensor | None = None) -> NextFrame:
        latent = torch.zeros(len(x), 1) if latent is None else latent
        mean = self.network.next(x, controls, latent)
        return NextFrame(mean, torch.full_like(mean, -9.0), torch.zeros(len(x), CONTACT_COUNT), None)


@pytest.fixture
def echo(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ARCHITECTURES, "echo", f"{__name__}:Echo")


def test_another_architecture_is_trained_saved_and_rolled_out(
    echo: None, dataset_folder: Path, tmp_path: Path, tiny_options
) -> None:
    path = tmp_path / "echo.safetensors"
    made = train(dataset_folder, path, tiny_options("echo", steps=6), device="cpu")
    assert made.finished and set(made.losses) == {"l2", "total", "gradient"}
    assert read_header(path)["config"]["architecture"] == "echo"
    model = load_model(path)
    assert model.config == EchoConfig()

    def positions(seed: int) -> np.ndarray:
        options = SynthesisOptions(count=2, seed=seed, noise=Noise("mean"), ik=False)
        done = synthesize(model, parse_types(f"{model.type_names[0]}:0.5"), options)
        return np.stack([one.motion.root_positions for one in done.motions])

    same, other = positions(1), positions(5)
    assert np.array_equal(same, positions(1))  # the latent numbers come from the seed
    assert not np.array_equal(same, other) and not np.array_equal(same[0], same[1])


def test_a_run_of_another_architecture_resumes(
    echo: None, dataset_folder: Path, tmp_path: Path, tiny_options
) -> None:
    whole, parts = tmp_path / "whole.safetensors", tmp_path / "parts.safetensors"
    options = {"rate": 1e-3, "final_rate": 1.0}
    train(dataset_folder, whole, tiny_options("echo", steps=4, **options), device="cpu")
    train(dataset_folder, parts, tiny_options("echo", steps=2, **options), device="cpu")
    train(dataset_folder, parts, tiny_options("echo", steps=4, **options), resume=True, device="cpu")
    one, two = (load_model(path).network.arrays for path in (whole, parts))
    assert all(np.array_equal(one[name], two[name]) for name in one)


def test_the_tensors_of_another_architecture_are_checked(
    echo: None, dataset_folder: Path, tmp_path: Path, tiny_options, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "echo.safetensors"
    train(dataset_folder, path, tiny_options("echo", steps=2), device="cpu")

    class Wider(Echo):
        def __init__(self, config: EchoConfig, control_size: int) -> None:
            super().__init__(config, control_size + 1)

    monkeypatch.setitem(globals(), "Echo", Wider)
    with pytest.raises(ModelError, match="has shape"):
        load_model(path)


def test_an_unknown_architecture_is_refused() -> None:
    with pytest.raises(ModelError, match="architecture 'abacus' is unknown"):
        config_from_dict({"architecture": "abacus"})
