from __future__ import annotations

import io
import json
from pathlib import Path

import pytest

from motionkit.cli import doctor
from motionkit.cli.console import PlainConsole
from motionkit.data.diagnosis import diagnose


def test_a_folder_is_described(motionkit, clips_folder: Path) -> None:
    said = motionkit("doctor", clips_folder, "--verbose")
    assert said.code == 0 and "labels.csv" in said.out and "warning:" in said.out
    short = motionkit("doctor", clips_folder).out.splitlines()
    assert short[0].startswith("all 8 files can be used; ") and " warning" in short[0]
    assert set(short[:-1]) <= set(said.out.splitlines()) and len(short) < said.out.count("\n")
    value = json.loads(motionkit("doctor", clips_folder, "--json").out)
    assert len(value["clips"]) == 8 and {"name", "fps", "rig", "unit", "up", "floor"} <= set(
        value["clips"][0]
    )
    assert all(f"{kind['name']}" in said.out for kind in value["types"])


def test_unusable_files_are_named_and_the_rest_is_told(motionkit, clips_folder: Path, tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "walk_1.bvh").write_bytes((clips_folder / "walk_01.bvh").read_bytes())
    (folder / "torn.bvh").write_text("HIERARCHY\n")
    said = motionkit("doctor", folder)
    assert said.code == 1 and "1 of 2 files cannot be used" in said.err and "cannot be used: " in said.out
    assert "walk" in said.out and "Traceback" not in said.err + said.out


def test_a_folder_without_a_usable_file_is_not_called_well(motionkit, tmp_path: Path) -> None:
    (tmp_path / "torn.bvh").write_text("HIERARCHY\n")
    said = motionkit("doctor", tmp_path)
    assert said.code == 1 and "cannot be used: " in said.out
    assert "nothing looks wrong" not in said.out and "minutes" not in said.out


def test_a_pose_is_no_fault(motionkit, clips_folder: Path, tmp_path: Path) -> None:
    text = (clips_folder / "walk_01.bvh").read_text()
    head, _, rows = text.partition("MOTION")
    (tmp_path / "pose.bvh").write_text("\n".join(f"{head}MOTION{rows}".split("\n")[: head.count("\n") + 5]))
    (tmp_path / "bones.bvh").write_text(head)
    said = motionkit("doctor", tmp_path)
    assert said.code == 0 and said.out.startswith(
        "all 2 files can be used, but all are poses, too short to train on"
    )
    for name in ("pose.bvh", "bones.bvh"):
        said = motionkit("retarget", clips_folder / "walk_01.bvh", "--rig", name, "-o", "on.bvh")
        assert said.code == 0, said.err


def test_an_empty_folder(motionkit, tmp_path: Path) -> None:
    (tmp_path / "none").mkdir()
    assert motionkit("doctor", "none").failed_with("no .bvh, .amc, .npz, .glb, .vrm or .fbx files found")


def test_files_that_are_not_labelled_are_no_fault(motionkit, clips_folder: Path, tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    for name in ("a", "b"):
        (folder / f"{name}.bvh").write_bytes((clips_folder / "walk_01.bvh").read_bytes())
    (folder / "labels.csv").write_text("file,start_frame,end_frame,type\na.bvh,0,-1,walk\n")
    said = motionkit("doctor", folder)
    assert (
        said.code == 0 and "skipped in/b.bvh: not in labels.csv" in said.out and "cannot be" not in said.out
    )
    (folder / "labels.csv").write_text("file,start_frame,end_frame,type\nc.bvh,0,-1,walk\n")
    said = motionkit("doctor", folder)
    assert said.code == 1 and "lists none of the files" in said.err and "nothing looks wrong" not in said.out
    assert "skipped c.bvh: in labels.csv, but there is no such file" in said.out


@pytest.mark.parametrize("columns", [None, 80])
def test_names_of_files_stay_whole(
    columns: int | None, clips_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a pipe in one line, on a narrow terminal folded."""
    names = [f"a_quite_long_name_as_capture_systems_give_{number}" for number in range(2)]
    for name in names:
        (tmp_path / "ein_langer_dauerlauf").mkdir(exist_ok=True)
        text = (
            (clips_folder / "walk_01.bvh").read_text().replace("Hips", "Pelvis" * (name[-1] == "1") + "Hips")
        )
        (tmp_path / "ein_langer_dauerlauf" / f"{name}.bvh").write_text(text)
    with io.StringIO() as file:
        console = PlainConsole(file)
        if columns:
            monkeypatch.setattr(PlainConsole, "is_terminal", True)
            console.width = columns
        monkeypatch.setattr(doctor, "stdout_console", lambda: console)
        doctor._print(diagnose([tmp_path]), verbose=True)
        lines = file.getvalue().splitlines()
    table = lines[1 : lines.index("")]
    if columns:
        assert max(map(len, table)) <= columns and "…" not in file_text(table)
        width = table[0].index("type")
        told = "".join(line[:width].strip() for line in table)
    else:
        told = file_text(table)
    assert all(name in told for name in names)


def file_text(lines: list[str]) -> str:
    return "\n".join(lines)
