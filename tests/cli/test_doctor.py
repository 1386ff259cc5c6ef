from __future__ import annotations

import json
from pathlib import Path


def test_a_folder_is_described(motionkit, clips_folder: Path) -> None:
    said = motionkit("doctor", clips_folder)
    assert said.code == 0 and "labels.csv" in said.out and "warning:" in said.out
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


def test_an_empty_folder(motionkit, tmp_path: Path) -> None:
    (tmp_path / "none").mkdir()
    assert motionkit("doctor", "none").failed_with("no .bvh files found")
