from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from motionkit.cli.main import main
from motionkit.errors import MotionkitError
from motionkit.lab.paper.rollout_sheets import KINDS, sheet_file
from motionkit.lab.paper.scenes import SCENES, chosen_scenes, picture_name


def test_figures_1_and_5_to_9_have_scenes_with_the_distances_of_the_paper() -> None:
    assert sorted({each.figure[0] for each in SCENES}) == ["1", "5", "6", "7", "8", "9"]
    paper = {each.figure: each.paper for each in SCENES if each.paper is not None}
    assert paper == {"6": 0.513, "7a": 1.988, "7b": 1.749, "8": 0.454}


def test_both_paths_of_figure_7_are_the_same_path() -> None:
    one, two = ([p for _, points in each.sections for p in points] for each in chosen_scenes(["7a", "7b"]))
    np.testing.assert_array_equal(one, two)


def test_names_and_figures_choose_scenes() -> None:
    assert [each.figure for each in chosen_scenes(["complex", "6"])] == ["6", "8"]
    assert len(chosen_scenes([])) == len(SCENES)
    with pytest.raises(MotionkitError, match="unknown scene 'moonwalk', expected one of heterogeneous"):
        chosen_scenes(["moonwalk"])


def test_the_command_writes_motion_picture_and_distance(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("PIL")
    words = ["motionkit", "experiment", "scenes", "u-turn", "--seeds", "2", "-o", str(tmp_path), "--json"]
    monkeypatch.setattr(sys, "argv", words)
    main()
    (row,) = json.loads(capsys.readouterr().out)["scenes"]
    assert row["figure"] == "9b" and row["finished"] == 2 and len(row["distances"]) == 2
    assert 0.0 < max(row["distances"]) < 5.0 and row["distances"][0] != row["distances"][1]
    assert {file.suffix for file in (tmp_path / "shipped").iterdir()} == {".bvh", ".png"}
    assert not list(tmp_path.glob("*.json"))  # only all scenes together make a results file


def test_the_pictures_in_docs_are_those_of_the_script(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("PIL")
    docs = Path(__file__).resolve().parents[3] / "docs"
    monkeypatch.syspath_prepend(str(docs))
    import make_scenes

    made = {picture_name(each.figure, each.name) for each in chosen_scenes(make_scenes.FIGURES)}
    made |= {sheet_file(number) for number in KINDS}  # of experiment figures
    assert {path.name for path in docs.glob("figure-*.png")} == made
    assert all(f"]({name})" in (docs / "experiments.md").read_text("utf-8") for name in made)
