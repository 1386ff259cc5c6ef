from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from motionkit.data.labels import (
    Segment,
    beyond_end,
    find_sources,
    mirrored_type,
    read_labels,
    type_from_file_name,
)
from motionkit.errors import DatasetError

HEADER = "file,start_frame,end_frame,type,subject,fps,split,note\n"


@pytest.fixture
def table(tmp_path: Path):
    def write(rows: str, header: str = HEADER) -> Path:
        path = tmp_path / "labels.csv"
        path.write_text(header + rows, encoding="utf-8")
        return path

    return write


def test_a_full_row(table) -> None:
    rows = read_labels(table("a.bvh,10,-1,walking,s1,120,test,a note\n"))
    assert rows == {"a.bvh": [Segment(10, -1, "walking", "s1", 120.0, "test")]}


def test_only_the_four_required_columns(table) -> None:
    rows = read_labels(table("a.bvh,,,walking\n", "file,start_frame,end_frame,type\n"))
    assert rows == {"a.bvh": [Segment(0, -1, "walking")]}


def test_segments_are_sorted_and_blank_lines_left_out(table) -> None:
    rows = read_labels(table("a.bvh,50,90,running,,,,\n\na.bvh,0,50,walking,,,,\n"))
    assert [s.type for s in rows["a.bvh"]] == ["walking", "running"]


def test_byte_order_mark_and_crlf_are_fine(tmp_path: Path) -> None:
    path = tmp_path / "labels.csv"
    path.write_bytes(b"\xef\xbb\xbf" + HEADER.replace("\n", "\r\n").encode() + b"a.bvh,0,9,idle,,,,\r\n")
    assert read_labels(path)["a.bvh"][0].type == "idle"


@pytest.mark.parametrize(
    ("row", "complaint"),
    [
        ("a.bvh,zero,9,idle,,,,", "expected a number for start_frame, found 'zero'"),
        ("a.bvh,0,9x,idle,,,,", "expected a number for end_frame, found '9x'"),
        ("a.bvh,nan,9,idle,,,,", "expected a number for start_frame, found 'nan'"),
        ("a.bvh,0,inf,idle,,,,", "expected a number for end_frame, found 'inf'"),
        (
            "a.bvh,1e308,-1,idle,,,,",
            "expected a whole number up to 1,000,000,000 for start_frame, found '1e308'",
        ),
        ("a.bvh,0,1e10,idle,,,,", "expected a whole number up to 1,000,000,000 for end_frame"),
        ("a.bvh,0.5,9,idle,,,,", "expected a whole number"),
        ("a.bvh,1_0,90,idle,,,,", "expected a number for start_frame, found '1_0'"),
        ('a.bvh,0,9,"walk,run",,,,', "expected a motion type, found 'walk,run', which contains ','"),
        ("a.bvh,0,9,walk:2,,,,", "expected a motion type, found 'walk:2', which contains ':'"),
        ("a.bvh,0,9,walk\x1b[2J,,,,", "which has unprintable characters"),
        ("a.bvh,0,9," + "w" * 101 + ",,,,", "which has 101 characters, expected at most 100"),
        ("a.bvh,0,9,idle,s\x07,,,", "expected a subject, found 's\\x07'"),
        ("a\x00.bvh,0,9,idle,,,,", "NUL" if sys.version_info < (3, 11) else "expected a file name, found"),
        ("a.bvh,0,9,,,,,", "expected a motion type"),
        ("a.bvh,0,9", "expected a motion type"),
        ("a.bvh,9,9,idle,,,,", "expected start_frame < end_frame, found 9 and 9"),
        ("a.bvh,-3,9,idle,,,,", "expected start_frame < end_frame, found -3 and 9"),
        ("a.bvh,0,-2,idle,,,,", "expected start_frame < end_frame"),
        ("a.bvh,0,9,idle,,0,,", "expected fps between 1 and 1000, found 0"),
        ("a.bvh,0,9,idle,,nan,,", "fps"),
        ("a.bvh,0,9,idle,,,valid,", "expected train, validation, test or nothing for split, found 'valid'"),
        (",0,9,idle,,,,", "expected a file name"),
        ("a.bvh,3,20,idle,,,,", "overlap"),
        ("a.bvh,0,-1,idle,,,,\na.bvh,50,60,idle,,,,", "overlap"),
    ],
)
def test_a_broken_row_is_named_by_its_line(table, row: str, complaint: str) -> None:
    path = table("a.bvh,0,5,walking,,,,\n" + row + "\n")
    line = 2 + len(row.splitlines()) if "overlap" not in complaint else None
    with pytest.raises(DatasetError) as caught:
        read_labels(path)
    message = str(caught.value)
    assert complaint in message
    assert "\n" not in message
    assert message.startswith(f"{path}:{line}: " if line else f"{path}:3: ")


def test_a_short_row_in_a_table_whose_file_column_comes_last(table) -> None:
    path = table("0,9,idle\n", "start_frame,end_frame,type,file\n")
    with pytest.raises(DatasetError, match=r"labels.csv:2: expected a file name"):
        read_labels(path)


def test_missing_columns_are_named(table) -> None:
    with pytest.raises(DatasetError, match=r"labels.csv:1: .*lacks the columns end_frame, type"):
        read_labels(table("a.bvh,0\n", "file,start_frame\n"))


def test_a_table_with_semicolons_is_told(table) -> None:
    with pytest.raises(DatasetError, match="its columns are to be separated by commas"):
        read_labels(table("a.bvh;0;9;idle\n", "file;start_frame;end_frame;type\n"))


def test_values_beyond_the_columns_are_refused(table) -> None:
    header = "file,start_frame,end_frame,type\n"
    with pytest.raises(DatasetError, match=r"labels.csv:2: expected 4 values, found 'high' after them"):
        read_labels(table("a.bvh,0,9,kick, high\n", header))
    assert read_labels(table("a.bvh,0,9,kick,,\n", header))["a.bvh"][0].type == "kick"


def test_an_empty_table_lacks_all_columns(table) -> None:
    with pytest.raises(DatasetError, match="lacks the columns file, start_frame, end_frame, type"):
        read_labels(table("", ""))


@pytest.mark.parametrize("data", [b"\xff\xfe" + "file".encode("utf-16-le"), b"\x89PNG\xff\xff"])
def test_a_table_that_is_no_text(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "labels.csv"
    path.write_bytes(data)
    with pytest.raises(DatasetError, match=r"labels.csv"):
        read_labels(path)


def test_a_huge_field_is_a_dataset_error(table) -> None:
    path = table('a.bvh,0,9,"' + "x" * 200_000 + '",,,,\n')
    with pytest.raises(DatasetError, match=r"labels.csv:2"):
        read_labels(path)


def test_a_folder_is_no_table(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="is a folder, expected a label table"):
        read_labels(tmp_path)


def test_pipes_devices_and_huge_files_are_no_tables(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "zeros.csv").symlink_to("/dev/zero")
    with (tmp_path / "sparse.csv").open("wb") as file:
        file.truncate(2 * 2**30)
    for name, says in (("pipe.csv", "regular file"), ("zeros.csv", "regular"), ("sparse.csv", "64 MB")):
        with pytest.raises(DatasetError, match=says):
            read_labels(tmp_path / name)


@pytest.mark.parametrize("kind", ["walk,run", "walk:2", "w" * 101])
def test_a_folder_whose_name_is_no_type_is_refused(tmp_path: Path, kind: str) -> None:
    touch(tmp_path, f"{kind}/a.bvh")
    with pytest.raises(DatasetError, match=f"{kind[:3]}.*the folder or file name.*rename it"):
        find_sources([tmp_path])


def test_a_name_too_long_for_the_system_is_simply_not_there(tmp_path: Path, table) -> None:
    touch(tmp_path, "a.bvh")
    table("b" * 5000 + ".bvh,0,9,idle,,,,\n")
    assert find_sources([tmp_path])[0][0].skip_reason == "not in labels.csv"


@pytest.mark.parametrize(
    ("kind", "mirrored"),
    [
        ("jumping-l", "jumping-r"),
        ("jumping-r", "jumping-l"),
        ("kick left high", "kick right high"),
        ("w-kicking", "w-kicking"),
        ("walking", "walking"),
        ("l", "r"),
        ("rolling", "rolling"),
    ],
)
def test_mirrored_type(kind: str, mirrored: str) -> None:
    assert mirrored_type(kind) == mirrored
    assert mirrored_type(mirrored) == kind


@pytest.mark.parametrize(
    ("stem", "kind"),
    [
        ("Walk_Fast-02", "walk-fast"),
        ("run01", "run"),
        ("05_12", "motion"),
        ("cartwheel", "cartwheel"),
        ("Jump.left 3", "jump-left"),
        ("Take 2, walk: fast", "take-walk-fast"),
    ],
)
def test_type_from_file_name(stem: str, kind: str) -> None:
    assert type_from_file_name(stem) == kind


def touch(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("x")


def test_without_labels_folders_then_file_names_tell_the_type(tmp_path: Path) -> None:
    touch(tmp_path, "walking/a.bvh", "deep/running/b.BVH", "Cart_Wheel_3.bvh", "notes.txt")
    sources, table = find_sources([tmp_path])
    assert table is None
    assert {s.path.name: s.segments[0].type for s in sources} == {
        "a.bvh": "walking",
        "b.BVH": "running",
        "Cart_Wheel_3.bvh": "cart-wheel",
    }


@pytest.mark.parametrize("place", ["clips/labels.csv", "labels.csv"])
def test_labels_are_found_in_the_folder_or_just_above(tmp_path: Path, place: str) -> None:
    touch(tmp_path, "clips/a.bvh", "clips/b.bvh")
    name = "a.bvh" if place.startswith("clips") else "clips/a.bvh"
    (tmp_path / place).write_text(f"{HEADER}{name},0,9,idle,,,,\n")
    sources, table = find_sources([tmp_path / "clips"])
    assert table == tmp_path / place
    by_name = {s.path.name: s for s in sources}
    assert by_name["a.bvh"].segments == (Segment(0, 9, "idle"),)
    assert by_name["b.bvh"].skip_reason == "not in labels.csv"


def test_an_explicit_table_matches_unique_file_names_anywhere(tmp_path: Path) -> None:
    touch(tmp_path, "clips/deep/a.bvh")
    labels = tmp_path / "elsewhere" / "mine.csv"
    labels.parent.mkdir()
    labels.write_text(f"{HEADER}other/A.bvh,0,9,idle,,,,\n")
    sources, _ = find_sources([tmp_path / "clips"], labels)
    assert sources[0].segments == (Segment(0, 9, "idle"),)


def test_a_path_in_a_table_means_no_other_file_of_its_name(tmp_path: Path, table) -> None:
    touch(tmp_path, "a/x.bvh", "b/x.bvh", "c/y.bvh", "d/y.bvh")
    table(
        "a/x.bvh,0,9,walking,,,,\ny.bvh,0,9,idle,,,,\nb/gone.bvh,0,9,idle,,,,\n../other/z.bvh,0,9,idle,,,,\n"
    )
    reasons = {source.name.partition("/")[2]: source.skip_reason for source in find_sources([tmp_path])[0]}
    assert reasons["a/x.bvh"] == "" and reasons["b/x.bvh"] == "not in labels.csv"
    assert reasons["c/y.bvh"] == "labels.csv does not tell its folder, but 2 files have this name"
    assert {name: why for name, why in reasons.items() if "no such file" in why} == {
        "gone.bvh": "in labels.csv, but there is no such file"
    }, "a file outside the folders may be there on another day"


def test_files_of_several_folders_have_different_names_in_any_order(tmp_path: Path) -> None:
    touch(tmp_path, "p/walk/x.bvh", "q/walk/x.bvh", "q/walk/y.bvh")
    orders = [[tmp_path / "p", tmp_path / "q"], [tmp_path / "q", tmp_path / "p"]]
    names = [
        {source.path.parent.parent.name + source.path.name: source.name for source in find_sources(order)[0]}
        for order in orders
    ]
    assert (
        names[0] == names[1] == {"px.bvh": "p/walk/x.bvh", "qx.bvh": "q/walk/x.bvh", "qy.bvh": "walk/y.bvh"}
    )


def test_a_file_has_one_rate(table) -> None:
    path = table("a.bvh,0,9,idle,,120,,\na.bvh,9,20,idle,,,,\nb.bvh,0,9,idle,,120,,\nb.bvh,9,20,idle,,60,,\n")
    with pytest.raises(DatasetError, match=r"labels.csv:5: expected one fps for b.bvh, found 60 and 120"):
        read_labels(path)


def test_columns_are_known_in_any_case(tmp_path: Path) -> None:
    (tmp_path / "labels.csv").write_text("File, Start_Frame ,END_FRAME,Type,Split\na.bvh,0,9,idle,test\n")
    assert read_labels(tmp_path / "labels.csv") == {"a.bvh": [Segment(0, 9, "idle", split="test")]}


def test_a_file_can_be_given_for_a_folder(tmp_path: Path) -> None:
    touch(tmp_path, "walk.bvh")
    sources, _ = find_sources([tmp_path / "walk.bvh"])
    assert [s.segments[0].type for s in sources] == ["walk"]


def test_a_pipe_that_is_named_is_not_passed_over(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "walk.bvh")
    assert [s.path.name for s in find_sources([tmp_path / "walk.bvh"])[0]] == ["walk.bvh"]


def test_labels_beyond_the_end_of_a_clip_are_told() -> None:
    labels = [Segment(0, 50, "walk"), Segment(60, 9999, "run")]
    assert beyond_end(labels, 195) == "labelled up to frame 9,999, but the clip has 195"
    assert not beyond_end(labels, 9999) and not beyond_end([Segment(0, -1, "walk")], 9)
    assert not beyond_end(labels, 9998), "its last frame may be counted in"
    assert (
        beyond_end([Segment(0, 50, "walk"), Segment(400, -1, "run")], 195)
        == "labelled up to frame 401, but the clip has 195"
    )


def test_a_file_is_taken_once_however_often_it_is_given(tmp_path: Path) -> None:
    for name in ("walk/a.bvh", "run/b.bvh"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).touch()
    sources, _ = find_sources([tmp_path, tmp_path / "walk", tmp_path / "walk" / "a.bvh"])
    assert {source.name: source.segments[0].type for source in sources} == {
        "walk/a.bvh": "walk",
        "run/b.bvh": "run",
    }


def test_a_file_under_two_names_in_a_table_is_refused(tmp_path: Path, table) -> None:
    (tmp_path / "walk").mkdir()
    (tmp_path / "walk" / "a.bvh").touch()
    file = table("walk/a.bvh,0,50,walk,,,,\n./walk/a.bvh,20,80,run,,,,\n")
    with pytest.raises(DatasetError, match=r"walk/a.bvh and ./walk/a.bvh are the same file"):
        find_sources([tmp_path], file)


def test_no_bvh_files(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"no \.bvh, .* files found"):
        find_sources([tmp_path])


@pytest.mark.parametrize(
    ("kind", "mirrored"),
    [
        ("kickL", "kickR"),
        ("KickLeft", "KickRight"),
        ("Tritt Rechts", "Tritt Links"),
        ("coup-gauche", "coup-droite"),
        ("左キック", "右キック"),
        ("der Lauf", "der Lauf"),
        ("JUMP_R", "JUMP_L"),
        ("Lauf_02", "Lauf_02"),
        ("HDM", "HDM"),
        ("walkLong", "walkLong"),
    ],
)
def test_sides_in_names_are_found_in_any_case(kind: str, mirrored: str) -> None:
    assert mirrored_type(kind) == mirrored and mirrored_type(mirrored) == kind
