"""The ONNX graph against motionkit's own roll-out, and the example in docs/onnx.md."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from model_changes import with_preset
from motionkit.features.layout import FEATURE_COUNT
from motionkit.models.checkpoint import load_model
from motionkit.models.model import MotionModel
from motionkit.models.network import PartTransformer
from motionkit.models.presets import preset

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

from motionkit.export.onnx_export import OnnxStep, build_graph, check_export, export_onnx
from motionkit.export.onnx_graph import OPSET
from motionkit.export.onnx_network import present_name

PAGE = Path(__file__).resolve().parents[2] / "docs" / "onnx.md"


@pytest.fixture(scope="module")
def exported(tiny_model_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The graph of tiny_model, with its metadata beside it; tests must not write to it."""
    path = tmp_path_factory.mktemp("onnx") / "model.onnx"
    export_onnx(load_model(tiny_model_file), path)
    return path


VARIANTS: list[dict] = [
    {"fusion": "none"},
    {"kernel": 1},
    {"kernel": 2},
    {"kernel": 5},
    {"layer_controls": False},
    {"partition": "one"},
    {"partition": "five"},
    {"layout": "expmap-root-1"},
]


@pytest.mark.parametrize("change", VARIANTS)
def test_variants(tiny_model: MotionModel, tmp_path: Path, change: dict) -> None:
    network = PartTransformer(preset("tiny", **change), tiny_model.controls.size)
    assert network.momentum is not None
    torch.nn.init.uniform_(network.momentum, -0.2, 0.2)  # zero at the start
    model, path = replace(tiny_model, network=network.weights()), tmp_path / "model.onnx"
    path.write_bytes(build_graph(model).SerializeToString())
    assert check_export(model, path, "default", frames=60).positions < 0.05


def test_the_slip_correction_is_that_of_motionkit(tiny_model: MotionModel, tmp_path: Path) -> None:
    model = with_preset(tiny_model, slip_correction=0.6)
    path = tmp_path / "model.onnx"
    path.write_bytes(build_graph(model).SerializeToString())
    assert check_export(model, path, "default", frames=120).positions < 0.05
    # A roll-out without the correction goes elsewhere.
    assert check_export(with_preset(model, slip_correction=0.0), path, "default", frames=120).positions > 1.0


def test_the_slip_correction_input_scales_the_correction(tiny_model: MotionModel, tmp_path: Path) -> None:
    def features(share: float, asked: float) -> np.ndarray:
        path = tmp_path / f"{share}.onnx"
        path.write_bytes(build_graph(with_preset(tiny_model, slip_correction=share)).SerializeToString())
        graph = OnnxStep(path)
        graph.values["type_weights"][0, 0], graph.values["phase"][:] = 1.0, -1.0
        graph.values["slip_correction"][:] = asked
        graph.values["pose"][:] = np.random.default_rng(5).standard_normal((1, FEATURE_COUNT))
        return graph.step()["features"].copy()

    free, half, full = features(0.6, 0.0), features(0.6, 0.5), features(0.6, 1.0)
    assert np.abs(full - free).max() > 0.5  # cm/s
    np.testing.assert_allclose(half, features(0.3, 1.0), rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(free, features(0.0, 1.0))


def test_a_larger_body(tiny_model: MotionModel, tmp_path: Path) -> None:
    tall = {**tiny_model.characters, "tall": 1.2 * tiny_model.characters["default"]}
    check = export_onnx(replace(tiny_model, characters=tall), tmp_path / "tall.onnx", "tall")
    assert check is not None and check.positions < 0.05
    offsets = json.loads((tmp_path / "tall.json").read_text())["offsets"]
    assert np.allclose(offsets, tall["tall"], atol=1e-3)


def test_a_phase_counts_from_zero_on(tiny_model: MotionModel, exported: Path) -> None:
    def features(progress: float) -> np.ndarray:
        graph = OnnxStep(exported)
        graph.values["type_weights"][0, 0], graph.values["phase"][:] = 1.0, progress
        return graph.step()["features"].copy()

    assert np.array_equal(features(-1.0), features(-0.3))
    assert not np.allclose(features(-1.0), features(0.0), atol=1e-4)
    assert np.allclose(features(0.0), features(1.0), atol=1e-3)


def test_steps_alternate_between_two_buffers_of_state(exported: Path) -> None:
    graph = OnnxStep(exported)
    graph.values["phase"][:] = -1.0
    before = [graph.values["pose"]]
    for _ in range(4):
        made = graph.step()
        assert graph.values["pose"] is made["present_pose"] and graph.values["phase"][0, 0] == -1.0
        before.append(graph.values["pose"])
    assert before[0] is before[2] is before[4] and before[1] is before[3] is not before[0]


def test_the_frame_count_wraps(tiny_model: MotionModel, exported: Path) -> None:
    graph, window = OnnxStep(exported), tiny_model.config.window
    counted = [float(graph.step()["present_frames_seen"][0, 0]) for _ in range(4 * window)]
    assert counted[: 2 * window - 2] == list(range(1, 2 * window - 1))
    assert set(counted[2 * window :]) == set(range(window - 1, 2 * window - 1))
    assert [n % window for n in counted] == [(i + 1) % window for i in range(4 * window)]


@pytest.mark.parametrize("name", ["trajectory", "phase", "noise", "type_weights"])
def test_every_control_has_an_effect(exported: Path, name: str) -> None:
    made = []
    for value in (0.0, 0.25):
        graph = OnnxStep(exported)
        graph.values["trajectory_mask"][:] = 1.0
        graph.values[name][:] = value
        made.append(graph.step()["features"])
    assert not np.array_equal(*made)


def test_a_masked_trajectory_has_no_effect(exported: Path) -> None:
    made = []
    for value in (0.0, 50.0):
        graph = OnnxStep(exported)
        graph.values["trajectory"][:] = value
        made.append(graph.step()["features"])
    assert np.array_equal(*made)


def test_shapes_are_static_and_state_keeps_its_shape(exported: Path) -> None:
    import onnx

    proto = onnx.load(str(exported))
    onnx.checker.check_model(proto, full_check=True)
    assert proto.opset_import[0].version == OPSET and {n.domain for n in proto.graph.node} == {""}
    shapes = [
        {v.name: [d.dim_value for d in v.type.tensor_type.shape.dim] for v in values}
        for values in (proto.graph.input, proto.graph.output)
    ]
    assert all(0 not in shape for side in shapes for shape in side.values())
    about = json.loads(exported.with_suffix(".json").read_text())
    for name, state in about["state"].items():
        assert shapes[0][name] == shapes[1][state["out"]] == state["shape"]
        assert state["out"] == present_name(name)
    assert present_name("past_key_values.3.key") == "present.3.key"
    inside = json.loads(proto.metadata_props[0].value)
    assert inside == {key: value for key, value in about.items() if key not in ("starts", "reference_clips")}
    assert len(about["joints"]) == len(about["parents"]) == len(about["offsets"]) == 23


def test_the_example_on_the_page_runs(
    exported: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    assert len(code) == 1 and "motionkit" not in code[0].replace("about", "")
    monkeypatch.chdir(exported.parent)
    exec(compile(code[0], "onnx.md", "exec"), {})
    assert re.match(r"Hips went to \[.*\] cm", capsys.readouterr().out)
