"""A name is found however its letters are put together: macOS takes "ü" apart, keyboards do not."""

from __future__ import annotations

import json
import shutil
import unicodedata
from dataclasses import replace
from pathlib import Path

import click
import pytest

from motionkit.cli.train import _type_weights
from motionkit.control.path import read_path
from motionkit.control.script import parse_types
from motionkit.data.dataset import Dataset
from motionkit.data.labels import find_sources
from motionkit.errors import DatasetError, ModelError
from motionkit.models.checkpoint import load_model, save_model
from motionkit.models.model import MotionModel
from motionkit.names import unknown_name, visible
from motionkit.play.requests import parse_request

TYPED = "Hüpfen"
APART = unicodedata.normalize("NFD", TYPED)


def test_the_two_forms_differ() -> None:
    assert TYPED != APART and len(APART) == len(TYPED) + 1


def test_folders_and_label_tables(tmp_path: Path) -> None:
    (tmp_path / "clips" / APART).mkdir(parents=True)
    (tmp_path / "clips" / APART / f"{APART}_1.bvh").touch()
    (source,), _ = find_sources([tmp_path / "clips"])
    assert [segment.type for segment in source.segments] == [TYPED]
    for file in (f"{TYPED}/{TYPED}_1.bvh", f"{TYPED}_1.bvh"):
        (tmp_path / "clips" / "labels.csv").write_text(
            f"file,start_frame,end_frame,type,subject\n{file},0,-1,{APART},{APART}\n", encoding="utf-8"
        )
        (source,), _ = find_sources([tmp_path / "clips"])
        assert [(segment.type, segment.subject) for segment in source.segments] == [(TYPED, TYPED)]


def test_what_is_asked_for(tmp_path: Path) -> None:
    assert [part.type for part in parse_types(f"{APART}:2")] == [TYPED]
    points = [[0, 0], [0, 3]]
    (tmp_path / "p.json").write_text(json.dumps({"parts": [{"type": APART, "points": points}]}))
    (tmp_path / "p.csv").write_text(f"x,z,type\n0,0,{APART}\n0,3,{APART}\n", encoding="utf-8")
    for name in ("p.json", "p.csv"):
        assert [part.type for part in read_path(tmp_path / name).parts] == [TYPED]
    context = click.Context(click.Command("train"))
    assert _type_weights(context, click.Option(["--type-weights"]), f"{APART}=2") == {TYPED: 2.0}
    assert parse_request(json.dumps({"do": "wish", "type": APART})).fields["type"] == TYPED


def test_model_files(tiny_model: MotionModel, tmp_path: Path) -> None:
    path = tmp_path / "m.safetensors"
    first, *others = tiny_model.types
    types = {APART: tiny_model.types[first]} | {name: tiny_model.types[name] for name in others}
    characters = tiny_model.characters | {APART: tiny_model.characters["default"]}
    save_model(path, replace(tiny_model, types=types, characters=characters))
    model = load_model(path)
    assert model.type_names == (TYPED, *others) and len(model.types[TYPED].start_poses) > 0
    assert model.character(APART).offsets.shape == model.character(TYPED).offsets.shape
    save_model(path, replace(tiny_model, types=types | {TYPED: types.pop(others[0])}))
    with pytest.raises(ModelError, match="a name twice"):
        load_model(path)


def test_datasets_of_before(dataset_folder: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(dataset_folder, tmp_path / "ds"))
    manifest = json.loads((folder / "manifest.json").read_text("utf-8"))
    kind = next(iter(manifest["phase_seconds"]))
    text = json.dumps(manifest).replace(json.dumps(kind), json.dumps(APART))
    (folder / "manifest.json").write_text(text, "utf-8")
    dataset = Dataset(folder)
    assert TYPED in dataset.types and APART not in dataset.types and TYPED in dataset.phase_seconds
    manifest["types"][:2] = [TYPED, APART]
    (folder / "manifest.json").write_text(json.dumps(manifest), "utf-8")
    with pytest.raises(DatasetError, match="distinct names"):
        Dataset(folder)


@pytest.mark.parametrize(
    "mark", ["\n", "\r", "\x1b", "\x7f", "\x9b", "\u2028", "\u2029", "\u202e", "\u2066", "\ud800"]
)
def test_marks_that_steer_a_terminal_are_shown(mark: str) -> None:
    assert visible(f"a{mark}b") == f"a{mark.encode('unicode_escape', 'surrogatepass').decode('ascii')}b"


def test_other_letters_stay() -> None:
    assert visible("Ärger 跳 \u2027\u202f") == "Ärger 跳 \u2027\u202f"


@pytest.mark.parametrize(
    ("word", "hint"),
    [
        ("looking", "'idle'"),
        ("Jogging", "'running'"),
        ("boxing", "'punching'"),
        ("walkin", "'walking'"),
        ("smiling", ""),
    ],
)
def test_a_name_that_is_meant_is_suggested(word: str, hint: str) -> None:
    told = unknown_name("motion type", word, ("idle", "punching", "running", "walking"))
    assert f"{word!r}; did you mean {hint}? (known" in told if hint else "did you mean" not in told
