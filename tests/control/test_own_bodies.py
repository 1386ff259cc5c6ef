"""Models trained on performers' own bodies: a character's skeleton is a control, and its bones are the output's."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.control.follow import follow_path
from motionkit.control.path import shape_path
from motionkit.control.script import TypePart
from motionkit.control.synthesize import SynthesisOptions, synthesize
from motionkit.data.dataset import Dataset
from motionkit.data.options import PreprocessOptions
from motionkit.data.preprocess import preprocess
from motionkit.features.control import Controls
from motionkit.inference.character import CharacterStream
from motionkit.inference.noise import Noise
from motionkit.models.checkpoint import load_model, read_header
from motionkit.models.model import MotionModel
from motionkit.motion.bvh import write_bvh
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import canonical_skeleton, leg_length
from motionkit.training.options import TrainOptions
from motionkit.training.trainer import train
from synthetic_motions import make_idle, make_walk

SMALL = 0.8  # size of the second performer
PARTS = [TypePart("walk", 1.0)]
MEAN = Noise("mean")


def smaller(motion: Motion) -> Motion:
    """The motion on a body that is smaller in all its bones."""
    skeleton = canonical_skeleton(SMALL * motion.skeleton.offsets)
    return replace(motion, skeleton=skeleton, root_positions=SMALL * motion.root_positions)


@pytest.fixture(scope="module")
def own_clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Walks and standing of two performers, in folders by type."""
    folder = tmp_path_factory.mktemp("own")
    for kind in ("walk", "stand"):
        (folder / kind).mkdir()
    for number, turn in enumerate((0.0, 0.3)):
        write_bvh(folder / "walk" / f"tall_{number}.bvh", make_walk(150, turn=turn))
        write_bvh(folder / "walk" / f"small_{number}.bvh", smaller(make_walk(150, turn=turn)))
    write_bvh(folder / "stand" / "tall.bvh", make_idle(120))
    write_bvh(folder / "stand" / "small.bvh", smaller(make_idle(120)))
    return folder


@pytest.fixture(scope="module")
def own_model_file(
    own_clips: Path,
    tiny_options: Callable[..., TrainOptions],
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:
    folder = tmp_path_factory.mktemp("own-model")
    preprocess([own_clips], folder / "dataset", PreprocessOptions(jobs=1, own_bodies=True))
    train(folder / "dataset", folder / "own.safetensors", tiny_options(steps=12), device="cpu")
    return folder / "own.safetensors"


@pytest.fixture
def own_model(own_model_file: Path) -> MotionModel:
    return load_model(own_model_file)


def small_name(model: MotionModel) -> str:
    """The name of the smaller performer's body."""
    return min(model.characters, key=lambda name: leg_length(model.character(name)))


def test_bodies_without_names_of_performers_are_characters(own_model: MotionModel, tmp_path: Path) -> None:
    assert own_model.own_bodies and own_model.shows_bodies and not own_model.plain
    assert set(own_model.characters) == {"default", "body-1", "body-2"}
    small = own_model.character(small_name(own_model))
    assert leg_length(small) == pytest.approx(SMALL * leg_length(canonical_skeleton()), rel=1e-3)


def test_a_model_of_one_body_is_not_shown_bodies(tiny_model: MotionModel, dataset: Dataset) -> None:
    assert not dataset.own_bodies and not tiny_model.shows_bodies
    bodies = {"default": canonical_skeleton().offsets, "child": SMALL * canonical_skeleton().offsets}
    model = replace(tiny_model, characters=bodies)
    parts = [TypePart("walking", 0.5)]
    tall, child = (synthesize(model, parts, SynthesisOptions(character=name)).motion for name in bodies)
    assert np.array_equal(tall.local_rotations, child.local_rotations)
    assert np.allclose(child.root_positions, SMALL * tall.root_positions, atol=1e-3)


def test_the_header_says_whether_bodies_are_shown(own_model_file: Path, tiny_model_file: Path) -> None:
    assert read_header(own_model_file)["own_bodies"] is True
    assert "own_bodies" not in read_header(tiny_model_file)


def test_a_character_changes_what_the_network_does_and_the_bones(own_model: MotionModel) -> None:
    names = ("default", small_name(own_model))
    tall, small = (
        synthesize(own_model, PARTS, SynthesisOptions(character=n, noise=MEAN, ik=False)) for n in names
    )
    assert np.allclose(small.motion.skeleton.offsets, own_model.characters[names[1]])
    assert not np.allclose(tall.motion.local_rotations, small.motion.local_rotations, atol=1e-4)
    heights = [made.motion.root_positions[0, 1] for made in (tall, small)]
    assert heights[1] / heights[0] == pytest.approx(SMALL, abs=0.05), "it starts on its own legs"
    crowd = synthesize(own_model, PARTS, SynthesisOptions(2, character=",".join(names), noise=MEAN, ik=False))
    second = synthesize(own_model, PARTS, SynthesisOptions(1, 1, MEAN, names[1], ik=False))
    for alone, together in zip((tall, second), crowd.motions, strict=True):
        assert np.allclose(alone.motion.root_positions, together.motion.root_positions, atol=1e-3)


def test_a_path_is_followed_on_the_body_as_it_is(
    own_model: MotionModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("motionkit.control.follow.PATIENCE", -0.5)
    path = shape_path("line", 2.0, ["walk"], None)
    name = small_name(own_model)
    made = follow_path(own_model, path, SynthesisOptions(character=name, noise=MEAN, ik=False))
    default = follow_path(own_model, path, SynthesisOptions(noise=MEAN, ik=False))
    assert np.allclose(made.motion.skeleton.offsets, own_model.characters[name])
    frames = min(len(made.motion), len(default.motion))
    assert not np.allclose(
        made.motion.local_rotations[:frames], default.motion.local_rotations[:frames], atol=1e-4
    )


def test_live_characters_move_as_their_bodies_do(own_model: MotionModel) -> None:
    names = ("default", small_name(own_model))
    stream = CharacterStream(own_model, 2, MEAN, ik=False, characters=names)
    weights = np.zeros((2, len(own_model.types)), np.float32)
    weights[:, own_model.type_id("stand")] = 1.0
    assert stream.body.scale.tolist() == [1.0, 1.0]
    for _ in range(5):
        frame = stream.step(Controls.of_types(weights))
    assert not np.allclose(frame.rotations[0], frame.rotations[1], atol=1e-4)
    thighs = np.linalg.norm(frame.positions[:, 3] - frame.positions[:, 2], axis=-1)
    assert thighs[1] / thighs[0] == pytest.approx(SMALL, rel=1e-3)
    stream.reset(0, names[1])
    stream.reset(1, names[1])
    frame = stream.step(Controls.of_types(weights))
    assert np.allclose(frame.rotations[0], frame.rotations[1], atol=1e-5)


def test_a_graph_is_of_one_body(own_model: MotionModel, tmp_path: Path) -> None:
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    from motionkit.export.onnx_export import check_export, export_onnx, metadata

    name = small_name(own_model)
    export_onnx(own_model, tmp_path / "small.onnx", name)
    assert check_export(own_model, tmp_path / "small.onnx", name, frames=30).positions < 0.05
    assert check_export(own_model, tmp_path / "small.onnx", "default", frames=30).positions > 1.0
    starts = [metadata(own_model, each)["starts"]["walk"]["pose"] for each in ("default", name)]
    assert json.dumps(starts[0]) != json.dumps(starts[1])
