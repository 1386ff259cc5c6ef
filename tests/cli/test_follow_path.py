from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit import follow_path
from motionkit.errors import ControlError
from motionkit.models.bundled import load_bundled_model
from motionkit.models.checkpoint import save_model
from motionkit.motion.bvh import bvh_to_motion, read_bvh

from .conftest import page_data


@pytest.fixture
def follow(motionkit, tiny_model_file: Path):
    return lambda *words: motionkit("follow-path", "--model", tiny_model_file, *words)


def test_a_named_shape(follow, tmp_path: Path) -> None:
    said = follow("line", "--size", 0.5, "--types", "walking,running")
    assert said.code == 0 and said.err == ""
    assert [p.name for p in tmp_path.iterdir()] == ["line-walking.bvh"]
    assert "along 0.5 m" in said.out and "reach" in said.out
    assert "part 1 walking: " in said.out and "part 2 running: " in said.out
    assert "trajectory distance " in said.out and "cm from the path" in said.out


def test_a_file_and_json(follow, tmp_path: Path) -> None:
    (tmp_path / "way.json").write_text(
        json.dumps({"parts": [{"type": "walking", "speed": 2.5, "points": [[0, 0], [0, 0.5]]}]})
    )
    said = follow("way.json", "-o", "out.bvh", "--json")
    value = json.loads(said.out)
    assert said.code == 0 and value["file"] == "out.bvh"
    assert value["path_cm"] == pytest.approx(50.0)
    assert [part["type"] for part in value["parts"]] == ["walking"]
    assert value["trajectory_distance_cm"] == pytest.approx(value["parts"][0]["mean_cm"], rel=1e-5)
    assert len(read_bvh(tmp_path / "out.bvh").values) == value["frames"]


def test_json_tells_the_frames_of_the_file(follow, tmp_path: Path) -> None:
    said = follow("line", "--size", "0.5", "--fps", "30", "-o", "out.bvh", "--json")
    value = json.loads(said.out)
    assert len(read_bvh(tmp_path / "out.bvh").values) == value["frames"] and value["fps"] == 30.0


def test_a_table(follow, tmp_path: Path) -> None:
    (tmp_path / "way.csv").write_text("x,z,type,speed\n0,0,walking,2\n0,0.4,walking,2\n")
    assert follow("way.csv").code == 0
    assert (tmp_path / "way-walking.bvh").is_file()


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["cirkle"], "did you mean 'circle'"),
        (["circle", "--size", "0"], "expected a size"),
        (["circle", "--speed", "99"], "expected a speed"),
        (["circle", "--types", "floating"], "unknown motion type 'floating'"),
        (["circle", "--character", "nobody"], "unknown character 'nobody'"),
        (["missing.json"], "missing.json: no such file"),
    ],
)
def test_faults_leave_no_file(follow, tmp_path: Path, words: list[str], complaint: str) -> None:
    assert follow(*words).failed_with(complaint)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("words", [("--types", "running"), ("--speed", 2), ("--size", 2)])
def test_what_a_path_file_has_of_its_own_is_refused_beside_it(follow, tmp_path: Path, words: tuple) -> None:
    (tmp_path / "way.csv").write_text("x,z,type,speed\n0,0,walking,2\n0,0.4,walking,2\n")
    said = follow("way.csv", *words)
    assert said.code == 2 and "a path file holds its own" in said.err
    with pytest.raises(ControlError, match="a path file holds its own"):
        follow_path(tmp_path / "way.csv", **{words[0][2:]: words[1]})


def test_a_part_too_short_for_its_performance_is_told(motionkit, tmp_path: Path) -> None:
    (tmp_path / "way.csv").write_text("x,z,type\n0,0,walking\n0,1,walking\n0,1.3,cartwheel\n0,2,walking\n")
    said = motionkit("follow-path", "way.csv", "-o", "a.bvh")
    assert said.code == 0 and "part 2: cartwheel takes some 3" in said.err and "found 0.3 m" in said.err
    (tmp_path / "long.csv").write_text("x,z,type\n0,0,cartwheel\n0,3,cartwheel\n")
    assert "may not be shown" not in motionkit("follow-path", "long.csv", "-o", "a.bvh").err


def test_a_broken_table_names_the_line(follow, tmp_path: Path) -> None:
    (tmp_path / "way.csv").write_text("x,z,type\n0,0,walking\n0,far,walking\n")
    assert follow("way.csv").failed_with("way.csv:3: expected numbers")
    assert [p.name for p in tmp_path.iterdir()] == ["way.csv"]


def test_a_page_with_the_path_and_its_parts(follow, tmp_path: Path) -> None:
    said = follow("line", "--size", 0.5, "--speed", 3, "--types", "walking,running", "--view")
    assert said.code == 0 and "wrote line-walking.html" in said.out
    (motion,) = page_data(tmp_path / "line-walking.html")["motions"]
    assert motion["path"]["shape"] == [26, 2]
    assert [band["type"] for band in motion["types"]] == ["walking", "running"]
    assert motion["types"][0]["end"] == motion["types"][1]["start"]
    assert motion["types"][1]["end"] == pytest.approx(motion["frames"] / motion["fps"])


def test_a_path_is_walked_with_the_models_walk_whatever_it_is_called(motionkit, tmp_path: Path) -> None:
    model = load_bundled_model()
    kept = {{"walking": "Lauf_02"}.get(name, name): kind for name, kind in model.types.items()}
    save_model(tmp_path / "m.safetensors", replace(model, types=kept))
    said = motionkit("follow-path", "line", "--size", 1.5, "--model", "m.safetensors", "--json")
    value = json.loads(said.out)
    assert said.code == 0 and value["finished"] and value["parts"][0]["type"] == "Lauf_02"
    assert (tmp_path / "line-Lauf_02.bvh").exists()
    assert motionkit("follow-path", "line", "--types", " ,").code == 2


@pytest.mark.parametrize("words", [(), ("--rig", "@mixamo")])
def test_the_path_of_a_body_of_another_size_is_as_long(motionkit, tmp_path: Path, words: tuple) -> None:
    """It ends at the end of the path, whatever the size of the character and of the rig."""
    said = motionkit("follow-path", "line", "--size", 4, "--character", "subject-32", "-o", "a.bvh", *words)
    assert said.code == 0 and ("--character is left out" in said.err) == bool(words)
    end = bvh_to_motion(read_bvh(tmp_path / "a.bvh")).root_positions[-1]
    assert abs(end[2] - 400.0) < 10.0 and abs(end[0]) < 5.0


def test_a_body_that_stands_at_a_stop_is_in_the_part_before(motionkit, tmp_path: Path) -> None:
    (tmp_path / "way.csv").write_text(
        "x,z,type,stop\n0,0,walking,0\n0,2,walking,2\n0,4,b-walking,0\n", encoding="utf-8"
    )
    assert motionkit("follow-path", "way.csv", "-o", "a.npz").code == 0
    with np.load(tmp_path / "a.npz") as arrays:
        kinds = arrays["types"][np.abs(arrays["root_positions"][:, 2] - 200.0) < 10.0]
    assert len(kinds) > 120 and (kinds[:-20] == "walking").all() and kinds[-1] == "b-walking"
