from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

from motionkit.arrays import Array
from motionkit.errors import ControlError, ModelError
from motionkit.inference.step import NetworkStep
from motionkit.inference.step_kernel import StepKernel
from motionkit.inference.step_weights import pack
from motionkit.models.bundled import open_model
from motionkit.models.checkpoint import load_model, model_arrays, read_header, save_model
from motionkit.models.model import MotionModel


def predict(model: MotionModel) -> Array:
    draw = np.random.default_rng(1)
    x = draw.standard_normal((1, 30, 276), np.float32)
    contacts = np.ones((1, 30, 4), np.float32)
    controls = draw.standard_normal((1, 30, model.controls.size), np.float32)
    step = NetworkStep(StepKernel(pack(model.network)), 1)
    means = []
    for t in range(30):
        step.step(x[:, t], contacts[:, t], controls[:, t])
        means.append(step.mean.copy())
    return np.stack(means)


def raw(path: Path) -> tuple[dict[str, Array], dict]:
    """A model file taken apart: tensors and header."""
    with safe_open(str(path), framework="numpy") as file:
        return {n: file.get_tensor(n) for n in file.keys()}, json.loads(file.metadata()["motionkit"])


def test_what_is_saved_is_what_is_loaded(tiny_model: MotionModel, tmp_path: Path) -> None:
    save_model(tmp_path / "copy.safetensors", tiny_model)
    copy = load_model(tmp_path / "copy.safetensors")
    assert np.array_equal(predict(copy), predict(tiny_model))
    assert copy.type_names == tiny_model.type_names and copy.fps == tiny_model.fps
    assert copy.config == tiny_model.config and copy.card == tiny_model.card
    assert list(copy.characters) == list(tiny_model.characters)
    for name, kind in tiny_model.types.items():
        other = copy.types[name]
        assert (other.gait, other.preset, other.steered) == (kind.gait, kind.preset, kind.steered)
        assert len(other.reference_clips) == len(kind.reference_clips)
        for a, b in zip(kind.start_poses, other.start_poses, strict=True):
            assert np.array_equal(a.features, b.features) and np.array_equal(a.contacts, b.contacts)
            assert np.array_equal(a.ground, b.ground)
    for name in ("scaling", "trajectory_scaling"):
        assert np.array_equal(getattr(copy, name).mean, getattr(tiny_model, name).mean)
        assert np.array_equal(getattr(copy, name).std, getattr(tiny_model, name).std)
    assert np.array_equal(copy.reference_rotations, tiny_model.reference_rotations)


FORMER_KEYS = {
    "start_poses": "seeds",
    "reference_clips": "outlines",
    "uses_references": "guides",
    "reference_gain": "guidance",
    "noise_scale": "noise",
    "velocity_blend": "inertia",
    "slip_correction": "grip",
}


def former(name: str) -> str:
    """What the first releases called a tensor."""
    for present, before in (
        ("start_pose.", "seed."),
        ("reference_clip.", "outline."),
        ("pose_embedding.", "outline."),
        ("reference_rotations", "references"),
    ):
        if name.startswith(present):
            return before + name.removeprefix(present)
    return name


def write_former(path: Path, tensors: dict[str, Array], header: dict) -> None:
    """Write a model as the first releases did, which measured what is steered whenever they opened one."""
    header = {FORMER_KEYS.get(k, k): v for k, v in header.items() if k != "steered"}
    header["format"] = "motionkit-model-3"
    named = {former(name): array for name, array in tensors.items()}
    save_file(named, path, metadata={"motionkit": json.dumps(header)})


def test_files_of_the_first_releases_open(
    tiny_model_file: Path, tiny_model: MotionModel, tmp_path: Path
) -> None:
    tensors, header = raw(tiny_model_file)
    write_former(tmp_path / "former", tensors, header)
    assert {"seed.0.walking:features", "outline.matrix"} <= set(raw(tmp_path / "former")[0])
    opened = load_model(tmp_path / "former")
    assert [kind.steered for kind in opened.types.values()] == [k.steered for k in tiny_model.types.values()]
    save_model(tmp_path / "written-anew", opened)
    assert (tmp_path / "written-anew").read_bytes() == tiny_model_file.read_bytes()


def test_a_former_file_with_a_tensor_twice(tiny_model_file: Path, tmp_path: Path) -> None:
    tensors, header = raw(tiny_model_file)
    write_former(tmp_path / "former", tensors, header)
    tensors, header = raw(tmp_path / "former")
    tensors["reference_rotations"] = tensors["references"].copy()
    save_file(tensors, tmp_path / "twice", metadata={"motionkit": json.dumps(header)})
    assert "'reference_rotations' and 'references' are one and the same" in refused(tmp_path / "twice")


def test_what_is_steered_is_read_not_measured(tiny_model: MotionModel, tmp_path: Path) -> None:
    swapped = tiny_model.with_types({"cartwheel": {"steered": not tiny_model.types["cartwheel"].steered}})
    save_model(tmp_path / "m", swapped)
    assert load_model(tmp_path / "m").types["cartwheel"].steered == swapped.types["cartwheel"].steered


def test_the_same_model_gives_the_same_bytes(tiny_model: MotionModel, tmp_path: Path) -> None:
    for name in "ab":
        save_model(tmp_path / name, tiny_model)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_half_precision_is_half_the_size_and_close(tiny_model: MotionModel, tmp_path: Path) -> None:
    save_model(tmp_path / "whole", tiny_model)
    save_model(tmp_path / "half", tiny_model, half=True)
    assert (tmp_path / "half").stat().st_size < 0.6 * (tmp_path / "whole").stat().st_size
    half = load_model(tmp_path / "half")
    assert np.abs(predict(half) - predict(tiny_model)).max() < 0.02
    assert half.network["aggregate.weight"].dtype == np.float32
    for name, kind in tiny_model.types.items():
        start = half.types[name].start_poses[0]
        assert np.allclose(start.features, kind.start_poses[0].features, rtol=1e-3, atol=1e-2)


def test_consistency_modules_are_not_in_the_file(tiny_model: MotionModel) -> None:
    names = set(model_arrays(tiny_model, half=False))
    assert not any("consistency" in name for name in names)
    assert {n for n in names if n.startswith("network.")} == {
        f"network.{n}" for n in tiny_model.network.arrays
    }


def test_every_type_has_start_poses_of_its_own(tiny_model: MotionModel) -> None:
    for kind in tiny_model.types.values():
        assert 1 <= len(kind.start_poses) <= 3
        for start in kind.start_poses:
            assert start.features.shape[1] == 276 and len(start.features) == len(start.contacts) >= 2


def test_header_without_weights(tiny_model_file: Path) -> None:
    header = read_header(tiny_model_file)
    assert header["types"] == ["cartwheel", "idle", "jumping-l", "jumping-r", "running", "walking"]
    assert header["card"]["steps"] == 20


def refused(path: Path) -> str:
    with pytest.raises(ModelError) as caught:
        load_model(path)
    message = str(caught.value)
    assert str(path) in message and "\n" not in message
    return message


@pytest.mark.parametrize("share", [0.0, 0.001, 0.3, 0.999])
def test_truncated_file(tiny_model_file: Path, tmp_path: Path, share: float) -> None:
    data = tiny_model_file.read_bytes()
    path = tmp_path / "cut.safetensors"
    path.write_bytes(data[: int(share * len(data))])
    refused(path)


def test_text_file_folder_and_nothing_at_all(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("HIERARCHY\nROOT Hips\n" * 100)
    refused(tmp_path / "notes.txt")
    refused(tmp_path)
    assert "no such file" in refused(tmp_path / "missing.safetensors")


def test_somebody_elses_safetensors(tmp_path: Path) -> None:
    path = tmp_path / "other.safetensors"
    save_file({"weight": np.zeros(3, np.float32)}, path)
    assert "not a motionkit model" in refused(path)
    save_file({"weight": np.zeros(3, np.float32)}, path, metadata={"motionkit": "no json"})
    assert "not a motionkit model" in refused(path)
    for text in ("[]", "3", "null"):
        save_file({"weight": np.zeros(3, np.float32)}, path, metadata={"motionkit": text})
        refused(path)
    save_file(
        {"weight": np.zeros(3, np.float32)}, path, metadata={"motionkit": '{"format": "motionkit-model-99"}'}
    )
    assert "motionkit-model-99" in refused(path)


@pytest.mark.parametrize(
    "name", ["network.aggregate.bias", "scaling.mean", "reference_rotations", "character.default"]
)
def test_a_missing_tensor(tiny_model_file: Path, tmp_path: Path, name: str) -> None:
    tensors, header = raw(tiny_model_file)
    del tensors[name]
    save_file(tensors, tmp_path / "m", metadata={"motionkit": json.dumps(header)})
    refused(tmp_path / "m")


def test_a_tensor_of_another_shape(tiny_model_file: Path, tmp_path: Path) -> None:
    tensors, header = raw(tiny_model_file)
    tensors["network.aggregate.bias"] = np.zeros(5, np.float32)
    save_file(tensors, tmp_path / "m", metadata={"motionkit": json.dumps(header)})
    refused(tmp_path / "m")


@pytest.mark.parametrize(
    "change",
    [
        {"types": None},
        {"fps": "sixty"},
        {"start_poses": []},
        {"start_poses": {"walking": 9}},
        {"characters": ["giant"]},
        {"gaits": {"walking": [1.0]}},
        {"config": {"wings": 2}},
        {"config": {"partition": "nine"}},
        {"config": None},
    ],
)
def test_a_header_that_does_not_fit(tiny_model_file: Path, tmp_path: Path, change: dict) -> None:
    tensors, header = raw(tiny_model_file)
    save_file(tensors, tmp_path / "m", metadata={"motionkit": json.dumps(header | change)})
    refused(tmp_path / "m")


def test_unknown_type_lists_the_known_ones_and_the_nearest(tiny_model: MotionModel) -> None:
    with pytest.raises(ControlError) as caught:
        tiny_model.type_id("Runing")
    assert str(caught.value) == (
        "unknown motion type 'Runing'; did you mean 'running'? "
        "(known: cartwheel, idle, jumping-l, jumping-r, running, walking)"
    )
    with pytest.raises(ControlError, match="unknown motion type 'xyz' \\(known: "):
        tiny_model.type_id("xyz")


def test_characters(tiny_model: MotionModel) -> None:
    assert len(tiny_model.character("default")) == 23
    with pytest.raises(ControlError, match="unknown character 'Default'; did you mean 'default'"):
        tiny_model.character("Default")


def test_saving_into_what_is_no_folder_is_told_in_a_line(tiny_model: MotionModel, tmp_path: Path) -> None:
    from motionkit.errors import MotionkitError

    with pytest.raises(MotionkitError, match="cannot be written"):
        (tmp_path / "a-file").touch()
        save_model(tmp_path / "a-file" / "m.safetensors", tiny_model)


def test_open_model_takes_the_file_given(tiny_model_file: Path) -> None:
    assert open_model(tiny_model_file).type_names[0] == "cartwheel"
