"""motionkit export."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from motionkit.errors import MotionkitError
from motionkit.export.onnx_export import OnnxStep, export_onnx
from motionkit.models.checkpoint import save_model
from motionkit.models.model import MotionModel
from motionkit.models.network import PartTransformer
from motionkit.models.presets import preset

pytest.importorskip("onnx")


def test_a_graph_and_its_metadata(motionkit: Callable, tiny_model_file: Path, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    done = motionkit("export", "--onnx", "out.onnx", "--model", tiny_model_file, "--json")
    assert done.code == 0
    said = json.loads(done.out)
    assert said["largest_joint_difference_cm"] < 0.05 and said["frames"] == 600
    assert (tmp_path / said["file"]).is_file() and (tmp_path / said["metadata"]).is_file()


def test_bad_input(motionkit: Callable, tiny_model_file: Path) -> None:
    words = ("export", "--model", tiny_model_file, "--onnx")
    assert motionkit(*words, "/dev/null/x.onnx").failed_with("/dev/null/x.onnx: cannot be written")
    assert motionkit(*words, "x.onnx", "--character", "giant").failed_with("unknown character 'giant'")
    assert motionkit(*words, "x.txt").code == 2 and not list(Path().glob("x.*"))
    assert motionkit("export").code == motionkit(*words, "x.onnx", "--weights", "int8").code == 2


@pytest.mark.parametrize("name", ["x.json", "x.JSON", ".json"])
def test_a_graph_cannot_have_the_name_of_its_metadata(
    motionkit: Callable, tiny_model_file: Path, tmp_path: Path, name: str
) -> None:
    done = motionkit("export", "--model", tiny_model_file, "--onnx", name)
    assert done.code == 2 and f"{name}: the metadata are written to this file" in done.err
    assert not list(tmp_path.glob("*.[jJ]*"))


def test_an_empty_name_is_one_line(motionkit: Callable, tiny_model_file: Path) -> None:
    assert motionkit("export", "--model", tiny_model_file, "--onnx", "").failed_with("found an empty name")


def test_files_of_other_kinds_are_not_overwritten(
    motionkit: Callable, tiny_model_file: Path, tmp_path: Path
) -> None:
    (tmp_path / "package.json").write_text('{"name": "mine"}')
    done = motionkit("export", "--model", tiny_model_file, "--onnx", "package.onnx")
    assert done.failed_with("package.json: exists and was not written by export")
    assert (tmp_path / "package.json").read_text() == '{"name": "mine"}'
    model = tmp_path / "own.safetensors"
    model.write_bytes(tiny_model_file.read_bytes())
    done = motionkit("export", "--model", model, "--onnx", model)
    assert done.code != 0 and "is read by this command" in done.err
    assert model.read_bytes() == tiny_model_file.read_bytes()


@pytest.mark.parametrize("before", [False, True])
@pytest.mark.parametrize("fails_at", ["fsync", "replace 1", "replace 2"])
def test_graph_and_metadata_appear_together(
    tiny_model: MotionModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails_at: str, before: bool
) -> None:
    monkeypatch.setattr("motionkit.export.onnx_export.CHECK_FRAMES", 10)
    graph, beside = tmp_path / "x.onnx", tmp_path / "x.json"
    if before:
        graph.write_bytes(b"old")
        beside.write_text('{"format": "motionkit-onnx-6"}')
    calls = []

    def full(*words: object, real: Callable, **more: object) -> object:
        calls.append(words)
        if len(calls) >= int(fails_at[-1:] if fails_at[-1:].isdecimal() else 1):
            raise OSError(28, "No space left on device")
        return real(*words, **more)

    name = fails_at.split()[0]
    monkeypatch.setattr(os, name, partial(full, real=getattr(os, name)))
    with pytest.raises(MotionkitError, match="No space left"):
        export_onnx(tiny_model, graph)
    left = {path.name for path in tmp_path.iterdir()}
    assert left in (set(), {"x.onnx", "x.json"}) and (before or not left)
    assert not left or graph.read_bytes() == b"old"


def test_a_network_that_recomputes(motionkit: Callable, tiny_model: MotionModel, tmp_path: Path) -> None:
    config = preset("tiny", position="sinusoidal")
    network = PartTransformer(config, tiny_model.controls.size).weights()
    save_model(tmp_path / "paper.safetensors", replace(tiny_model, network=network))
    done = motionkit("export", "--onnx", "out.onnx", "--model", "paper.safetensors")
    assert done.failed_with("cannot be packed", "sinusoidal") and not (tmp_path / "out.onnx").exists()


def test_without_onnx(motionkit: Callable, tiny_model_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnx", None)
    done = motionkit("export", "--onnx", "out.onnx", "--model", tiny_model_file)
    assert done.failed_with("pip install", "motionkit[onnx]")


def test_a_graph_that_computes_something_else_is_an_error(
    motionkit: Callable, tiny_model_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("onnxruntime")
    before = OnnxStep.step
    (tmp_path / "x.onnx").write_bytes(b"a good graph")
    for value, said in (
        (1.0, "differ from motionkit's by 1"),
        (math.nan, "differ from motionkit's by nan cm"),
    ):

        def step(self: OnnxStep, value: float = value) -> dict:
            made = before(self)
            return made | {"positions": made["positions"] + np.float32([value, 0.0, 0.0])}

        monkeypatch.setattr(OnnxStep, "step", step)
        done = motionkit("export", "--onnx", "x.onnx", "--model", tiny_model_file)
        assert done.failed_with("nothing written", said, "expected at most 0.5")
        assert [p.name for p in tmp_path.iterdir()] == ["x.onnx"]
        assert (tmp_path / "x.onnx").read_bytes() == b"a good graph"


def test_a_model_that_does_not_move_is_an_error(
    motionkit: Callable, tiny_model: MotionModel, tmp_path: Path
) -> None:
    pytest.importorskip("onnxruntime")
    arrays = tiny_model.network.arrays
    arrays = arrays | {"aggregate.bias": np.full_like(arrays["aggregate.bias"], 3e38)}
    network = replace(tiny_model.network, arrays=arrays)
    save_model(tmp_path / "m.safetensors", replace(tiny_model, network=network))
    done = motionkit("export", "--onnx", "x.onnx", "--model", "m.safetensors")
    assert done.failed_with("has numbers that are NaN, infinite or above 1e+12")
    assert [p.name for p in tmp_path.iterdir()] == ["m.safetensors"]
