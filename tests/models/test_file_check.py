"""Model files from anyone: refused in one line, before a weight is read."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from motionkit.errors import ModelError
from motionkit.features.control import ControlLayout
from motionkit.models.checkpoint import load_model, save_model
from motionkit.models.file_check import weight_shapes
from motionkit.models.model import MotionModel
from motionkit.models.network import PartTransformer
from motionkit.models.presets import PRESETS, preset


@pytest.fixture
def changed(tiny_model_file: Path, tmp_path: Path) -> Callable[..., str]:
    """A function that writes a model with other header values or tensors and answers how it is refused."""

    def write(header: dict[str, Any] | None = None, tensors: dict[str, torch.Tensor] | None = None) -> str:
        with safe_open(str(tiny_model_file), framework="pt") as file:
            values = {name: file.get_tensor(name) for name in file.keys()} | (tensors or {})
            facts = json.loads(file.metadata()["motionkit"])
        facts |= header or {}
        path = tmp_path / "m.safetensors"
        save_file(values, path, metadata={"motionkit": json.dumps(facts)})
        return refused(path)

    return write


def refused(path: Path) -> str:
    with pytest.raises(ModelError) as caught:
        load_model(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and len(message.splitlines()) == 1
    return message


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"layers": 1e29}, "layers is 1e+29, expected a whole number from 1 to 48"),
        ({"layers": 10**12}, "layers is 1000000000000, expected"),
        ({"heads": 0}, "heads is 0"),
        ({"heads": True}, "heads is True"),
        ({"window": 18}, "window is 18, expected a whole number from 1 to 17"),
        ({"window": 0}, "window is 0"),
        ({"width": -48}, "width is -48"),
        ({"width": "48"}, "width is '48'"),
        ({"partition": ["two"]}, "partition is ['two'], expected one of one, two"),
        ({"layout": None}, "layout is None"),
        ({"head_leak": None}, "head_leak is None, expected a number from 0 to 1"),
        ({"log_sigma_min": 3.0}, "log_sigma_min must be at most log_sigma_max"),
        ({"layer_controls": 1}, "layer_controls is 1, expected true or false"),
        ({"kernel": 0}, "kernel is 0"),
        ({"contact_hidden": 5}, "contact_mlp.inner.weight' has shape (1, 96, 64), expected (1, 96, 5)"),
        ({"layers": 3}, "is missing"),
        ({"ffn": 95}, "has shape (2, 48, 96), expected (2, 48, 95)"),
    ],
)
def test_config_values(
    changed: Callable[..., str], tiny_model: MotionModel, change: dict, complaint: str
) -> None:
    assert complaint in changed({"config": tiny_model.config.to_dict() | change})


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"fps": 0}, "fps is 0, expected a number from 1 to 480"),
        ({"fps": [60]}, "fps is [60]"),
        ({"types": "walking"}, "types are 'walking', expected a list"),
        ({"types": ["walking", "walking"]}, "types have a name twice"),
        ({"types": ["a\nb"]}, r"types have 'a\nb', expected a printable name"),
        ({"types": [3]}, "types have 3"),
        ({"characters": ["giant"]}, "characters lack 'default'"),
        ({"characters": [["default"]]}, "characters have ['default']"),
        (
            {"start_poses": {"flying": 1}},
            "start_poses names the type 'flying', which the model does not have",
        ),
        ({"start_poses": {"walking": -1}}, "start_poses of 'walking' are -1"),
        ({"start_poses": {"walking": 1.5}}, "start_poses of 'walking' are 1.5"),
        ({"reference_clips": {"walking": 10**30}}, "reference_clips of 'walking' are 1000"),
        ({"uses_references": "yes"}, "uses_references is 'yes', expected true or false"),
        ({"reference_gain": {"walking": "much"}}, "reference_gain of 'walking' is 'much', expected a number"),
        ({"noise_scale": None}, "noise_scale is None"),
        (
            {"velocity_blend": {"walking": 1.5}},
            "velocity_blend of 'walking' is 1.5, expected a number from 0 to 1",
        ),
        ({"gaits": {"walking": 9}}, "the gait of 'walking' is 9"),
        ({"gaits": {"walking": [1e30, 0.0]}}, "the gait of 'walking' is 1e+30"),
        ({"steered": ["flying"]}, "steered is ['flying'], expected a list of types"),
        ({"steered": {}}, "steered is {}"),
        ({"card": []}, "card is []"),
        ({"config": [1]}, "config is [1], expected an object"),
        ({"format": {}}, "format {}"),
    ],
)
def test_header_values(changed: Callable[..., str], change: dict, complaint: str) -> None:
    assert complaint in changed(change)


@pytest.mark.parametrize(
    ("name", "value", "complaint"),
    [
        ("network.aggregate.bias", torch.full((600,), torch.nan), "numbers that are NaN, infinite or above"),
        (
            "start_pose.0.walking:ground",
            torch.full((30, 3), torch.inf),
            "numbers that are NaN, infinite or above",
        ),
        ("scaling.std", torch.zeros(276), "expected positive deviations"),
        ("reference_rotations", torch.zeros(23, 4), "not unit quaternions"),
        ("character.default", torch.full((23, 3), 1e10), "a bone longer than"),
        (
            "network.aggregate.bias",
            torch.zeros(600, dtype=torch.int32),
            "is of type I32, expected F32 or F16",
        ),
        ("start_pose.0.walking:contacts", torch.zeros(30, 4), "is of type F32, expected U8"),
        ("scaling.mean", torch.zeros(1), "has shape (1,), expected (276,)"),
        ("scaling.mean", torch.zeros(()), "has shape (), expected (276,)"),
        ("reference_clip.0.walking:phases", torch.zeros(()), "has shape (), expected some frames"),
        ("network.extra", torch.zeros(3), "is unknown"),
    ],
)
def test_tensors(changed: Callable[..., str], name: str, value: torch.Tensor, complaint: str) -> None:
    message = changed(tensors={name: value})
    assert complaint in message and name in message


def test_a_header_of_many_brackets(tiny_model_file: Path, tmp_path: Path) -> None:
    path = tmp_path / "deep.safetensors"
    save_file({"weight": torch.zeros(3)}, path, metadata={"motionkit": "[" * 100_000})
    assert "nested more than" in refused(path)


@pytest.mark.parametrize("length", [2**63 - 1, 2**64 - 1, 90 * 2**20])
def test_a_header_too_long_to_be_read(tmp_path: Path, length: int) -> None:
    path = tmp_path / "long.safetensors"
    with path.open("wb") as file:
        file.write(length.to_bytes(8, "little") + b"{")
        file.truncate(100 * 2**20)  # sparse
    assert "its header has" in refused(path)


def test_files_that_are_none(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert "is not a regular file" in refused(tmp_path / "pipe")
    os.symlink("/dev/zero", tmp_path / "zeros")
    assert "is not a regular file" in refused(tmp_path / "zeros")
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(2 * 2**30)
    assert "has 2 GB, expected a motionkit model of at most 256 MB" in refused(tmp_path / "sparse")


VARIANTS = [preset(name) for name in PRESETS] + [
    preset("tiny", **change)
    for change in (
        {"partition": "one"},
        {"partition": "five", "fusion": "none"},
        {"kernel": 1, "window": 17, "head_momentum": False},
        {"position": "sinusoidal", "norm": "post", "layer_controls": False},
    )
]


@pytest.mark.parametrize("config", VARIANTS)
def test_the_shapes_expected_are_those_of_the_network(config) -> None:
    size = ControlLayout(("walking", "idle")).size
    shapes = {name: tuple(t.shape) for name, t in PartTransformer(config, size).state_dict().items()}
    assert weight_shapes(config, size) == shapes


def test_a_card_with_a_loss_that_went_astray_can_be_read(tiny_model: MotionModel, tmp_path: Path) -> None:
    card = tiny_model.card | {"losses": {"total": float("nan"), "fk": (float("inf"), 2.0)}}
    save_model(tmp_path / "m", replace(tiny_model, card=card))
    assert load_model(tmp_path / "m").card["losses"] == {"total": None, "fk": [None, 2.0]}
