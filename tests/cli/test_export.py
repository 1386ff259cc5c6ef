"""motionkit export."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from motionkit.models.checkpoint import MotionModel, save_model
from motionkit.models.network import PartTransformer
from motionkit.models.presets import preset

pytest.importorskip("onnx")


def test_a_graph_and_what_it_means(motionkit: Callable, tiny_model_file: Path, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    done = motionkit("export", "--onnx", "out.onnx", "--model", tiny_model_file, "--json")
    assert done.code == 0
    said = json.loads(done.out)
    assert said["largest_joint_difference_cm"] < 0.05 and said["frames"] == 600
    assert (tmp_path / said["file"]).is_file() and (tmp_path / said["metadata"]).is_file()


def test_weights_in_8_bits(motionkit: Callable, tiny_model_file: Path, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    done = motionkit("export", "--onnx", "out.onnx", "--model", tiny_model_file, "--weights", "int8")
    assert done.code == 0 and "600 frames in closed loop" in done.out
    assert json.loads((tmp_path / "out.json").read_text())["weights"] == "int8"


def test_bad_input(motionkit: Callable, tiny_model_file: Path) -> None:
    words = ("export", "--model", tiny_model_file, "--onnx")
    assert motionkit(*words, "/dev/null/x.onnx").failed_with("/dev/null/x.onnx: cannot be written")
    assert motionkit(*words, "x.onnx", "--character", "giant").failed_with("unknown character 'giant'")
    assert motionkit("export").code == motionkit(*words, "x.onnx", "--weights", "int4").code == 2


def test_a_network_that_recomputes(motionkit: Callable, tiny_model: MotionModel, tmp_path: Path) -> None:
    config = replace(preset("tiny"), position="sinusoidal")
    network = PartTransformer(config, tiny_model.controls.size).eval()
    save_model(tmp_path / "paper.safetensors", replace(tiny_model, network=network))
    done = motionkit("export", "--onnx", "out.onnx", "--model", "paper.safetensors")
    assert done.failed_with("cannot be packed", "sinusoidal") and not (tmp_path / "out.onnx").exists()


def test_without_onnx(motionkit: Callable, tiny_model_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnx", None)
    done = motionkit("export", "--onnx", "out.onnx", "--model", tiny_model_file)
    assert done.failed_with("pip install", "motionkit[onnx]")
