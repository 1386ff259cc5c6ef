"""The ONNX graph against motionkit's own roll-out, and the example in docs/onnx.md."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from model_changes import with_preset
from motionkit.errors import ModelError
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.inference.step import NetworkStep
from motionkit.inference.step_weights import pack
from motionkit.models.checkpoint import load_model
from motionkit.models.model import MotionModel
from motionkit.models.network import PartTransformer
from motionkit.models.presets import preset

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

from motionkit.export.onnx_export import OnnxStep, build_graph, check_export, export_onnx
from motionkit.export.onnx_graph import OPSET
from motionkit.export.onnx_network import present_name
from motionkit.export.onnx_small import balance_heads, spread_channels, whole_numbers

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
    model = replace(tiny_model, characters=tall)
    assert export_onnx(model, tmp_path / "tall.onnx", "tall") is not None
    assert check_export(model, tmp_path / "tall.onnx", "tall", frames=60).positions < 0.05
    offsets = json.loads((tmp_path / "tall.json").read_text())["offsets"]
    assert np.allclose(offsets, tall["tall"], atol=1e-3)


def test_weights_in_8_bits(tiny_model: MotionModel, exported: Path, tmp_path: Path) -> None:
    import onnx

    # Without the correction, whose differences add up over 600 frames.
    free = with_preset(tiny_model, slip_correction=0.0)
    assert export_onnx(free, tmp_path / "small.onnx", weights="int8") is not None
    check = check_export(free, tmp_path / "small.onnx", "default", frames=60)
    assert 1e-4 < check.features < 0.05
    assert (tmp_path / "small.onnx").stat().st_size < 0.7 * exported.stat().st_size
    assert json.loads((tmp_path / "small.json").read_text())["weights"] == "int8"
    proto = onnx.load(str(tmp_path / "small.onnx"))
    onnx.checker.check_model(proto, full_check=True)
    assert proto.opset_import[0].version == OPSET and {n.domain for n in proto.graph.node} == {""}
    # Four products per layer, the controls, the step from shallow to deep, and sigma with contacts.
    products = [node for node in proto.graph.node if node.op_type == "MatMulInteger"]
    assert len(products) == 4 * 2 * tiny_model.config.layers + 3


def test_a_phase_counts_from_zero_on(tiny_model: MotionModel, exported: Path) -> None:
    def features(progress: float) -> np.ndarray:
        graph = OnnxStep(exported)
        graph.values["type_weights"][0, 0], graph.values["phase"][:] = 1.0, progress
        return graph.step()["features"].copy()

    assert np.array_equal(features(-1.0), features(-0.3))
    assert not np.allclose(features(-1.0), features(0.0), atol=1e-4)
    assert np.allclose(features(0.0), features(1.0), atol=1e-3)


def test_other_weights_are_refused(tiny_model: MotionModel) -> None:
    with pytest.raises(ModelError, match=r"'int4' are unknown, expected one of float32, int8"):
        build_graph(tiny_model, weights="int4")


@pytest.mark.parametrize("made_ready", [spread_channels, balance_heads])
def test_preparation_for_8_bits_leaves_the_network_unchanged(
    tiny_model: MotionModel, made_ready: Callable
) -> None:
    weights = pack(tiny_model.network)
    turned = made_ready(weights)
    assert not np.allclose(turned.shallow.qkv, weights.shallow.qkv, atol=0.1)
    steps = [NetworkStep(w, 1) for w in (weights, turned)]
    random = np.random.default_rng(0)
    sizes = (FEATURE_COUNT, CONTACT_COUNT, tiny_model.controls.size)
    for _ in range(5):
        frame = [random.standard_normal((1, size), np.float32) for size in sizes]
        for step in steps:
            step.step(*frame)
        np.testing.assert_allclose(steps[0].out, steps[1].out, atol=1e-4)
        np.testing.assert_allclose(steps[0].contact_logits, steps[1].contact_logits, atol=1e-4)


def test_one_scale_fits_queries_keys_and_values(tiny_model: MotionModel) -> None:
    weights = balance_heads(pack(tiny_model.network))
    for maps in (weights.shallow.qkv, weights.deep.qkv):
        for layer in maps:
            kinds = np.split(layer, 3, axis=-1)  # (P, D, H E) each
            sizes = [max(whole_numbers(part)[1].max() for part in kind) for kind in kinds]
            assert max(sizes) < 1.01 * min(sizes)
            whole, scales = whole_numbers(layer[0], even=True)
            assert len(set(scales.tolist())) == 1
            assert np.abs(whole * scales - layer[0]).max() <= 0.501 * scales[0]


@pytest.mark.parametrize("rows", [7, 8])
def test_two_neighbouring_products_of_8_bits_fit_into_16(rows: int) -> None:
    random = np.random.default_rng(3)
    weight = (random.standard_normal((rows, 400)) * 0.01 ** random.random(400)).astype(np.float32)
    whole, scales = whole_numbers(weight)
    assert (np.abs(whole * scales - weight) <= 0.501 * scales).all()
    pairs = np.concatenate([whole, np.zeros((rows % 2, 400), np.int8)]).astype(int).reshape(-1, 2, 400)
    highest = 255 * pairs.clip(min=0).sum(axis=1).max()
    lowest = 255 * pairs.clip(max=0).sum(axis=1).min()
    assert -(2**15) <= lowest and highest < 2**15
    # No steps are wasted either.
    assert (np.abs(pairs).sum(axis=1).max(axis=0) >= 126).all()


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
