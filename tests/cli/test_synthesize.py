from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.errors import ControlError
from motionkit.models.checkpoint import save_model
from motionkit.models.model import MotionModel
from motionkit.motion.bvh import bvh_to_motion, read_bvh

from .conftest import page_data


@pytest.fixture
def synthesize(motionkit, tiny_model_file: Path):
    return lambda *words: motionkit("synthesize", "--model", tiny_model_file, *words)


def test_writes_a_file_named_after_the_types_and_says_what_it_made(synthesize, tmp_path: Path) -> None:
    said = synthesize("--types", "running:0.5,cartwheel:0.3")
    assert said.code == 0 and said.err.startswith("cartwheel takes ") and "found 0.3 s" in said.err
    assert said.err.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["running-cartwheel.bvh"]
    assert "wrote running-cartwheel.bvh: running 0.5 s, cartwheel 0.3 s; 48 frames at 60 fps" in said.out
    assert (
        "frames per second" in said.out and "feet on the floor slide " in said.out and "afs" not in said.out
    )
    assert len(bvh_to_motion(read_bvh(tmp_path / "running-cartwheel.bvh"))) == 48


def test_a_file_that_is_there_is_not_overwritten_by_default(synthesize, tmp_path: Path) -> None:
    for _ in range(2):
        assert synthesize("--types", "idle:0.2").code == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["idle-2.bvh", "idle.bvh"]


def test_several_files_do_not_replace_earlier_ones(synthesize, tmp_path: Path) -> None:
    for seed in (0, 7):
        assert synthesize("--types", "idle:0.2", "--count", 2, "--seed", seed, "--view").code == 0
    names = ["idle-1.bvh", "idle-2-1.bvh", "idle-2-2.bvh", "idle-2.bvh", "idle-2.html", "idle.html"]
    assert sorted(p.name for p in tmp_path.iterdir()) == names
    assert (tmp_path / "idle-1.bvh").read_bytes() != (tmp_path / "idle-2-1.bvh").read_bytes()


@pytest.mark.parametrize("seed", [-1, 2**32, 1.5])
def test_what_is_no_seed_is_refused(synthesize, tmp_path: Path, tiny_model: MotionModel, seed: float) -> None:
    said = synthesize("--types", "idle:0.2", "--seed", seed)
    assert said.code == 2 and "--seed" in said.err and not list(tmp_path.iterdir())
    with pytest.raises(ControlError, match="expected a whole number from 0"):
        mk.synthesize("idle:0.2", model=tiny_model, seed=seed)  # type: ignore[arg-type]
    with pytest.raises(ControlError, match="expected a whole number from 0"):
        mk.CharacterStream(tiny_model, seed=seed)  # type: ignore[arg-type]


def test_the_same_seed_writes_the_same_bytes(synthesize, tmp_path: Path) -> None:
    for name, seed in (("a", 5), ("b", 5), ("c", 6)):
        assert synthesize("--types", "idle:0.3", "--seed", seed, "-o", f"{name}.bvh").code == 0
    a, b, c = ((tmp_path / f"{name}.bvh").read_bytes() for name in "abc")
    assert a == b != c


def test_without_reference_recordings_the_network_is_alone(synthesize, tmp_path: Path) -> None:
    for name in ("auto", "none"):
        assert synthesize("--types", "cartwheel:0.5", "--reference", name, "-o", f"{name}.bvh").code == 0
    assert (tmp_path / "auto.bvh").read_bytes() != (tmp_path / "none.bvh").read_bytes()
    assert synthesize("--types", "cartwheel:0.5", "--reference", "some").code == 2


def test_several_files_are_numbered(synthesize, tmp_path: Path) -> None:
    said = synthesize("--types", "idle:0.2", "--count", 3, "-o", "take.bvh", "--json")
    names = ["take-1.bvh", "take-2.bvh", "take-3.bvh"]
    assert sorted(p.name for p in tmp_path.iterdir()) == names
    assert [entry["file"] for entry in json.loads(said.out)["motions"]] == names
    assert len({(tmp_path / name).read_bytes() for name in names}) == 3


def test_json(synthesize) -> None:
    value = json.loads(synthesize("--types", "walking,idle", "--seconds", 1, "--fps", 30, "--json").out)
    (entry,) = value["motions"]
    assert (entry["frames"], entry["fps"]) == (30, 30.0)
    assert entry["types"] == [["walking", 0.5], ["idle", 0.5]]
    assert {"value", "unit"} == set(entry["metrics"]["jerk"])
    assert value["frames_per_second"] > 0 and value["seed"] == 0


@pytest.mark.parametrize("noise", ["mean", "sample", "correlated"])
def test_noise_and_foot_locks(synthesize, noise: str, tmp_path: Path) -> None:
    said = synthesize("--types", "walking:0.3", "--noise", noise, "--ik", "--temperature", 0.2, "-o", "x.bvh")
    assert said.code == 0 and (tmp_path / "x.bvh").is_file()


def test_start_from_a_clip(synthesize, clips_folder: Path, tmp_path: Path) -> None:
    said = synthesize("--types", "walking:0.3", "--init", clips_folder / "walk_02.bvh", "-o", "x.bvh")
    assert said.code == 0 and (tmp_path / "x.bvh").is_file()


def test_list_of_types(synthesize, tmp_path: Path) -> None:
    said = synthesize("--list-types")
    assert said.out.splitlines()[0] == "types: cartwheel, idle, jumping-l, jumping-r, running, walking"
    assert json.loads(synthesize("--list-types", "--json").out)["characters"][0] == "default"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--types", "runing"], "did you mean 'running'? (known: cartwheel, idle,"),
        (["--types", "walking,qqq"], "unknown motion type 'qqq' (known: "),
        (["--types", "walking:x"], "expected seconds after the colon"),
        (["--types", "walking:5", "--character", "gaint"], "unknown character 'gaint'"),
        (["--types", "walking:5,idle", "--seconds", "3"], "the other parts take 5 of 3 s"),
        (["--types", "idle:0.1", "-o", "/dev/null/x.bvh"], "/dev/null/x.bvh: cannot be written"),
    ],
)
def test_faults_leave_no_file(synthesize, tmp_path: Path, words: list[str], complaint: str) -> None:
    assert synthesize(*words).failed_with(complaint)
    assert not list(tmp_path.iterdir())


def test_one_frame_is_no_motion(synthesize, tmp_path: Path) -> None:
    assert synthesize("--types", "idle:0.02", "-o", "one.bvh").failed_with(
        "at least 2 frames, 0.033 s at 60 fps, found"
    )
    assert synthesize("--types", "idle:0.3", "--fps", 1, "-o", "one.bvh").failed_with(
        "2 frames, 1 s at 1 fps"
    )
    assert not (tmp_path / "one.bvh").exists()
    assert synthesize("--types", "idle:0.034", "-o", "two.bvh").code == 0


def test_a_file_that_is_replaced_is_told(synthesize, tmp_path: Path) -> None:
    words = ("--types", "idle:0.1", "--count", 2, "-o", "a.bvh")
    assert "replaced" not in synthesize(*words).err
    assert "replaced a-1.bvh and 1 other file" in synthesize(*words).err


def test_a_folder_in_the_place_of_the_file(synthesize, tmp_path: Path) -> None:
    (tmp_path / "out.bvh").mkdir()
    assert synthesize("--types", "idle:0.1", "-o", "out.bvh").failed_with("out.bvh: is a folder")


@pytest.mark.parametrize("content", [b"", b"HIERARCHY\n" * 50, b"\x08\x00\x00\x00\x00\x00\x00\x00{}      "])
def test_a_model_that_is_none(motionkit, tmp_path: Path, content: bytes) -> None:
    (tmp_path / "m.safetensors").write_bytes(content)
    said = motionkit("synthesize", "--types", "idle:0.1", "--model", "m.safetensors")
    assert said.failed_with("m.safetensors")
    assert [p.name for p in tmp_path.iterdir()] == ["m.safetensors"]


def test_a_broken_start_clip(synthesize, tmp_path: Path, broken_folder: Path) -> None:
    said = synthesize("--types", "idle:0.1", "--init", broken_folder / "nan.bvh", "--strict")
    assert said.failed_with("nan.bvh")
    assert not list(tmp_path.iterdir())


def test_a_page_beside_the_motions(synthesize, tmp_path: Path) -> None:
    said = synthesize("--types", "running:0.3,idle:0.2", "--count", 2, "-o", "take.bvh", "--view", "--json")
    assert json.loads(said.out)["view"] == "take.html"
    data = page_data(tmp_path / "take.html")
    assert [motion["name"] for motion in data["motions"]] == ["take-1", "take-2"]
    bands = [
        (band["type"], round(band["start"], 6), round(band["end"], 6)) for band in data["motions"][1]["types"]
    ]
    assert bands == [("running", 0.0, 0.3), ("idle", 0.3, 0.5)]
    assert synthesize("--types", "idle:0.2", "--count", 33, "--view").code == 2


@pytest.mark.parametrize("value", [1e11, 1e12])
@pytest.mark.parametrize("command", ["synthesize", "follow-path"])
def test_a_model_that_goes_astray_leaves_what_is_there(
    motionkit,
    tiny_model: MotionModel,
    tmp_path: Path,
    command: str,
    value: float,
) -> None:
    arrays = tiny_model.network.arrays
    arrays = arrays | {"aggregate.bias": np.full_like(arrays["aggregate.bias"], value)}
    network = replace(tiny_model.network, arrays=arrays)
    save_model(tmp_path / "m.safetensors", replace(tiny_model, network=network))
    (tmp_path / "x.bvh").write_text("a good file")
    words = (
        ("--types", "idle:0.1", "--count", 2) if command == "synthesize" else ("line", "--types", "walking")
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # they would stand beside the one line
        said = motionkit(command, *words, "--model", "m.safetensors", "-o", "x.bvh")
    assert said.failed_with("the roll-out failed")
    assert (tmp_path / "x.bvh").read_text() == "a good file"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["m.safetensors", "x.bvh"]


def test_several_characters_are_several_motions(motionkit, tmp_path: Path) -> None:
    words = ("synthesize", "--types", "walking:1", "--character", "subject-91,default")
    refused = motionkit(*words, "-o", "-")
    assert refused.code == 2 and "2 motions cannot be combined with standard output" in refused.err
    assert motionkit(*words[:-1], "default,subject-91,subject-16", "--count", 2).failed_with(
        "a count of 3 or more"
    )
    assert not list(tmp_path.iterdir())
    (tmp_path / "keys.json").write_text('{"keys": [{"time": 0.8, "position": [0, 1]}]}')
    said = motionkit(*words[:-1], "default,default", "--keys", "keys.json", "--seed", 4, "--json")
    made = json.loads(said.out)["motions"]
    assert [(one["seed"], one["character"]) for one in made] == [(4, "default"), (5, "default")]
    assert all(one["keys"][0]["cm"] < 1.0 for one in made)
    told = json.loads(motionkit(*words, "--json").out)["motions"]
    assert [one["character"] for one in told] == ["subject-91", "default"]
