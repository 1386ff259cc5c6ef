from __future__ import annotations

import json
import math
import os
import re
from pathlib import Path

import numpy as np
import pytest

from motionkit.control.path import SHAPES, SPACING, PathPart, make_path, read_path, shape_path
from motionkit.errors import ControlError

# Name, size in metres, expected length in metres.
LENGTHS = [
    ("line", 10.0, 10.0),
    ("circle", 3.0, 2 * math.pi * 3),
    ("figure-eight", 2.0, 4 * math.pi * 2),
    ("square", 5.0, 20.0),
    ("pentagram", 4.0, 20.0),
    ("u-turn", 6.0, 2 * 6 + math.pi * 0.6),
]


@pytest.mark.parametrize(("name", "size", "metres"), LENGTHS)
def test_length_of_shapes(name: str, size: float, metres: float) -> None:
    assert shape_path(name, size, ["walking"], None).length == pytest.approx(100 * metres, rel=0.005, abs=2.5)


@pytest.mark.parametrize("name", SHAPES)
def test_shapes_start_at_the_origin_facing_ahead(name: str) -> None:
    path = shape_path(name, None, ["walking"], None)
    assert np.linalg.norm(path.points[0]) < 0.1
    assert np.allclose(path.tangents[0], np.array([0.0, 1.0], np.float32), atol=0.02)


@pytest.mark.parametrize("name", ["circle", "figure-eight", "square", "pentagram"])
def test_closed_shapes_end_where_they_start(name: str) -> None:
    path = shape_path(name, 2.0, ["walking"], None)
    assert np.linalg.norm(path.points[-1] - path.points[0]) < 2 * SPACING


def test_points_are_evenly_spaced_and_tangents_are_unit() -> None:
    for name in SHAPES:
        path = shape_path(name, 3.0, ["walking"], None)
        steps = np.linalg.norm(np.diff(path.points, axis=0), axis=-1)
        assert steps.max() < 1.001 * SPACING
        assert float((steps < 0.95 * SPACING).astype(np.float32).mean()) < 0.01, (
            "shorter ones at corners only"
        )
        assert np.allclose(
            np.linalg.norm(path.tangents, axis=-1), np.ones(len(path.points), np.float32), atol=1e-5
        )


def test_a_circle_turns_left_about_its_centre() -> None:
    path = shape_path("circle", 3.0, ["walking"], None)
    distance = np.linalg.norm(path.points - np.array([300.0, 0.0], np.float32), axis=-1)
    assert np.abs(distance - 300.0).max() < 0.1


def test_corners_of_a_square() -> None:
    path = shape_path("square", 5.0, ["walking"], None)
    assert path.points.min() > -1 and path.points.max() < 501
    for corner in ([0.0, 500.0], [500.0, 500.0], [500.0, 0.0]):
        assert np.linalg.norm(path.points - np.array(corner), axis=-1).min() < SPACING


def test_a_u_turn_comes_back_beside_itself() -> None:
    path = shape_path("u-turn", 6.0, ["walking"], None)
    assert np.allclose(path.points[-1], np.array([120.0, 0.0], np.float32), atol=2 * SPACING)
    assert np.allclose(path.tangents[-1], np.array([0.0, -1.0], np.float32), atol=0.02)


def test_types_share_the_length_of_a_shape() -> None:
    path = shape_path("line", 9.0, ["walking", "running", "walking"], 2.0)
    assert [part.type for part in path.parts] == ["walking", "running", "walking"]
    assert all(part.speed == 200.0 for part in path.parts)
    shares = np.bincount(path.part).astype(np.float32) / len(path.part)
    assert np.allclose(shares, np.full((3,), 1 / 3), atol=0.01)
    assert (np.diff(path.part) >= 0).all()


@pytest.mark.parametrize(
    ("name", "size", "speed", "complaint"),
    [
        ("spiral", 1.0, None, "spiral"),
        ("circel", 1.0, None, "did you mean 'circle'"),
        ("circle", 0.0, None, "expected a size between 0.2 and 1000"),
        ("circle", -2.0, None, "size"),
        ("circle", math.nan, None, "size"),
        ("circle", 1e9, None, "size"),
        ("circle", 1.0, 0.0, "expected a speed between 0.05 and 15"),
        ("circle", 1.0, math.inf, "speed"),
    ],
)
def test_impossible_shapes(name: str, size: float, speed: float | None, complaint: str) -> None:
    with pytest.raises(ControlError, match=complaint):
        shape_path(name, size, ["walking"], speed)


def test_more_types_than_a_shape_has_room_for() -> None:
    with pytest.raises(ControlError, match="cm long, expected at least 4 cm"):
        shape_path("line", 0.2, ["walking"] * 30, None)


def test_parts_that_go_nowhere() -> None:
    with pytest.raises(ControlError, match="no parts"):
        make_path([])
    still = np.zeros((5, 2), np.float32)
    with pytest.raises(ControlError, match=r"part 1 of the path \(idle\) is 0\.0 cm long"):
        make_path([PathPart(still, "idle")])


def test_repeated_points_do_no_harm() -> None:
    points = np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 50.0], [0.0, 50.0], [0.0, 100.0]], np.float32)
    path = make_path([PathPart(points, "walking")])
    assert path.length == pytest.approx(100.0)
    assert np.isfinite(path.points).all() and np.isfinite(path.tangents).all()


def test_a_part_begins_where_the_one_before_ends() -> None:
    a = PathPart(np.array([[0.0, 0.0], [0.0, 100.0]], np.float32), "walking")
    b = PathPart(np.array([[100.0, 100.0], [100.0, 200.0]], np.float32), "running")
    path = make_path([a, b])
    assert path.length == pytest.approx(300.0)
    assert path.part[[25, 50, 51, 150]].tolist() == [0, 0, 1, 1]


# ---- files ----

GOOD = {"parts": [
    {"type": "walking", "speed": 1.4, "points": [[0, 0], [0, 2]]},
    {"type": "running", "points": [[0, 4], [1, 5]]},
]}  # fmt: skip


def write(tmp_path: Path, text: str, name: str = "path.json") -> Path:
    file = tmp_path / name
    file.write_text(text, encoding="utf-8")
    return file


def test_json_in_metres(tmp_path: Path) -> None:
    path = read_path(write(tmp_path, json.dumps(GOOD)))
    assert path.length == pytest.approx(400.0 + 100 * math.sqrt(2), abs=SPACING)
    assert [(p.type, p.speed) for p in path.parts] == [("walking", 140.0), ("running", None)]


def test_stops_are_at_ends_of_parts(tmp_path: Path) -> None:
    text = "x,z,type,stop\n0,0,walking,\n0,2,walking,1.5\n0,4,walking,\n0,6,walking,3\n"
    (tmp_path / "path.csv").write_text(text)
    path = read_path(tmp_path / "path.csv")
    assert [p.stop for p in path.parts] == [1.5, 3.0]
    assert np.bincount(path.part).tolist() == [101, 200]


def test_unknown_words_beside_the_parts_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "way.json"
    parts = [{"type": "walking", "points": [[0, 0], [0, 3]]}]
    file.write_text(json.dumps({"parts": parts, "unit": "cm"}))
    with pytest.raises(ControlError, match=r"way\.json: unknown field 'unit', expected parts"):
        read_path(file)


def test_json_may_be_a_bare_list(tmp_path: Path) -> None:
    assert len(read_path(write(tmp_path, json.dumps(GOOD["parts"]))).parts) == 2


def test_csv_rows_of_one_type_make_a_part(tmp_path: Path) -> None:
    text = "x,z,type,speed\n0,0,walking,1.4\n0,2,walking,1.4\n0,4,running,\n1,5,running,\n"
    path = read_path(write(tmp_path, text, "path.csv"))
    assert [(p.type, p.speed) for p in path.parts] == [("walking", 140.0), ("running", None)]
    assert path.length == pytest.approx(400.0 + 100 * math.sqrt(2), abs=SPACING)
    plain = write(tmp_path, "x,z,type\n0,0,walking\n0,2,walking\n", "plain.csv")
    assert read_path(plain).parts[0].speed is None


def one_part(**changes: object) -> str:
    """A path of one good part, with some of it changed; None leaves it out."""
    part = {"type": "walking", "points": [[0, 0], [0, 1]]} | changes
    return json.dumps({"parts": [{key: value for key, value in part.items() if value is not None}]})


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "not JSON"),
        ("{", "not JSON"),
        ("3", 'expected {"parts": [...]} with at least one part'),
        ("{}", "at least one part"),
        ('{"parts": []}', "at least one part"),
        ('{"parts": [1]}', "part 1: expected an object with type and points"),
        (one_part(type=None), "part 1: expected an object with type and points"),
        (one_part(points=None), "part 1: expected points as a list of [x, z] numbers"),
        (one_part(points=[[0, 0, 0]]), "part 1: expected points"),
        (one_part(points=[[0, "a"]]), "part 1: expected points"),
        (one_part(points=[[0, math.nan], [0, 1]]), "not JSON (NaN is not a finite number)"),
        (one_part(points=[[0, 10**400], [0, 1]]), "not JSON (an integer of 401 digits)"),
        (one_part(points=[[0, 10**39], [0, 1]]), "part 1: expected points as a list of [x, z] numbers up to"),
        (one_part(points=[[0, 1e308], [0, 1]]), "part 1: expected points"),
        (one_part(speed=10**39), "part 1: expected a number for speed"),
        (one_part(type="walk\ning"), "part 1: expected a motion type, found"),
        (one_part(points=[[0, 0], [0, True]]), "part 1: expected points"),
        (one_part(speed="fast"), "part 1: expected a number for speed"),
        (one_part(stopp=2), "part 1: unknown field 'stopp', expected type, points, speed, stop"),
        (one_part(stop="long"), "part 1: expected a number for stop"),
        (one_part(stop=-1), "part 1: expected a stop between 0 and 600"),
        (one_part(speed=-1), "part 1: expected a speed between"),
        (one_part(points=[[0, 0], [0, 0.001]]), "part 1 of the path (walking) is 0.1 cm long"),
        (one_part(points=[[0, 0], [0, 4e3], [0, -4e3]]), "12,000 m long, expected at most 10,000 m"),
        (one_part(points=[[0, 0], [0, 6e3]]), "numbers up to 5,000"),
        (json.dumps(GOOD["parts"] + [{"type": "idle", "points": [[1, 5]]}]), "part 3 of the path (idle)"),
    ],
)
def test_broken_json_names_the_part(tmp_path: Path, text: str, complaint: str) -> None:
    file = write(tmp_path, text)
    with pytest.raises(ControlError) as caught:
        read_path(file)
    message = str(caught.value)
    assert message.startswith(f"{file}: ") and complaint in message and "\n" not in message


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", ":1: expected a first line that names the columns x, z and type, found nothing"),
        ("x,y,type\n0,0,walking\n", "x, z and type, found 'x,y,type'; it lacks z"),
        ("0,0,walking\n0,1,walking\n", "found '0,0,walking'; it lacks x, z, type"),
        ("x,z,type\n0,0,walking\n0,1,5,walking\n", ":3: has more values than columns; put semicolons"),
        ("x,z,type\n0,0,walking\n", "part 1 of the path (walking) has one point, expected at least 4 cm"),
        (
            "x,z,type\n0,0,walking\n0,70000,walking\n",
            ":3: expected finite numbers up to 5,000; paths are in metres",
        ),
        ("x,z,type\n0,0,walking\n0,one,walking\n", ":3: expected numbers for x, z, speed and stop"),
        ("x,z,type\n0,0,walking\n0\n", ":3: expected numbers for x, z, speed and stop"),
        ("x,z,type,speed\n0,0,walking,quick\n", ":2: expected numbers for x, z, speed and stop"),
        ("x,z,type\n0,0,walking\n0,inf,walking\n", ":3: expected finite numbers"),
        ("x,z,type,X\n0,0,walking,5\n0,2,walking,7\n", ":1: expected each column once, found x 2 times"),
        ("x,z,type\n0,1e308,walking\n0,0,walking\n", ":2: expected finite numbers up to 5,000"),
        ("x,z,type\n0,0,\n0,1,\n", ":2: expected a motion type, found none"),
        ("x,z,type\n", "no parts"),
        ('x,z,type\n0,0,"' + "w" * 200_000 + '"\n', ":2: "),
    ],
)
def test_broken_csv_names_the_line(tmp_path: Path, text: str, complaint: str) -> None:
    file = write(tmp_path, text, "path.csv")
    with pytest.raises(ControlError) as caught:
        read_path(file)
    assert str(file) in str(caught.value) and complaint in str(caught.value)


def test_files_that_are_no_text(tmp_path: Path) -> None:
    (tmp_path / "path.json").write_bytes(b"\xff\xfe\x00")
    for place, says in (
        ("path.json", "is not UTF-8 text, expected a path"),
        ("", "is a folder, expected a path"),
        ("missing.csv", "no such file"),
    ):
        with pytest.raises(ControlError, match=says):
            read_path(tmp_path / place)


def test_pipes_devices_and_huge_files_are_no_paths(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "zeros.json").symlink_to("/dev/zero")
    with (tmp_path / "sparse.json").open("wb") as file:
        file.truncate(2 * 2**30)
    for name, says in (("pipe.csv", "regular file"), ("zeros.json", "regular"), ("sparse.json", "64 MB")):
        with pytest.raises(ControlError, match=says):
            read_path(tmp_path / name)


def test_deeply_nested_json_is_told_in_a_line(tmp_path: Path) -> None:
    with pytest.raises(ControlError, match="nested more than 50 levels deep"):
        read_path(write(tmp_path, "[" * 100_000))


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.csv", "x;z;type\n0,0;0;walking\n0,5;1,5;walking\n"),
        ("a.csv", "x\tz\ttype\n0\t0\twalking\n0,5\t1,5\twalking\n"),
        ("a.tsv", "x\tz\ttype\n0\t0\twalking\n0.5\t1.5\twalking\n"),
        ("a.txt", "x,z,type\n0,0,walking\n0.5,1.5,walking\n"),
        ("a.csv", "sep=;\nx;y;z;type;\n0;0;0;walking;\n0,5;0;1,5;walking;\n;;;;\n"),
        ("a.csv", "\ufeffX, Z, Type \r\n0, 0, walking\r\n0.5, 1.5, walking\r\n"),
        ("a.path", '[{"type": "walking", "points": [[0, 0], [0.5, 1.5]]}]'),
    ],
)
def test_tables_of_every_spreadsheet_are_read(tmp_path: Path, name: str, text: str) -> None:
    """Semicolons, tabs, decimal commas, capitals, spaces, and other endings."""
    plain = read_path(write(tmp_path, "x,z,type\n0.0,0,walking\n0.5,1.5,walking\n", "plain.csv"))
    assert np.array_equal(read_path(write(tmp_path, text, name)).points, plain.points)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x,z,type,stops\n0,0,walking,1\n0,1,walking,1\n", ":1: unknown column 'stops'; did you mean 'stop'"),
        ("sep=;\nx;z;typ\n0;0;walking\n", ":2: expected a first line that names the columns"),
        ("sep=;\nx;z;type\n0;oh;walking\n", ":3: expected numbers"),
        ("<svg/>", "expected a path as JSON or CSV, found XML"),
    ],
)
def test_what_a_table_of_a_path_cannot_hold(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ControlError, match=re.escape(said)):
        read_path(write(tmp_path, text, "a.svg" if text[0] == "<" else "a.csv"))


@pytest.mark.parametrize(
    ("part", "said"),
    [
        (PathPart(np.array([[0.0, 0.0], [0.0, np.nan], [0.0, 300.0]]), "walking"), "expected points"),
        (PathPart(np.zeros((3, 3)), "walking"), "expected points"),
        (PathPart(np.array([[0.0, 0.0], [0.0, 300.0]]), "walking", -100.0), "expected a speed above 0"),
        (PathPart(np.array([[0.0, 0.0], [0.0, 300.0]]), "walking", math.nan), "expected a speed above 0"),
        (
            PathPart(np.array([[0.0, 0.0], [0.0, 300.0]]), "walking", stop=math.nan),
            "expected a stop of 0 s or more",
        ),
        (
            PathPart(np.array([[0.0, 0.0], [0.0, 300.0]]), "walking", stop=-1.0),
            "expected a stop of 0 s or more",
        ),
        (PathPart([[0.0, 0.0], [300.0]], "walking"), "expected points"),  # type: ignore[arg-type]
    ],
)
def test_parts_that_are_no_paths(part: PathPart, said: str) -> None:
    with pytest.raises(ControlError, match=f"part 1 of the path .walking.: {said}"):
        make_path([part])


def test_lists_of_points_are_scaled_and_arrays_are_copied() -> None:
    listed = make_path([PathPart([[0, 0], [0, 400]], "walking")])  # type: ignore[arg-type]
    assert listed.scaled(2.0).length == pytest.approx(800.0)
    points = np.array([[0.0, 0.0], [0.0, 400.0]])
    path = make_path([PathPart(points, "walking")])
    points *= 3.0
    assert path.scaled(1.0).length == pytest.approx(400.0)
