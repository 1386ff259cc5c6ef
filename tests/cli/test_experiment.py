"""The commands of `motionkit experiment`: what they refuse, say, and fit into a narrow terminal."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from .conftest import Outcome

Run = Callable[..., Outcome]


def floors(motionkit: Run, data: Path, *words: object) -> Outcome:
    """A run that takes a second."""
    options = ("--set", "all", "--data", data, "--frames", 30, "--results", "results")
    return motionkit("experiment", "run", "last frame", *options, *words)


def test_a_finished_run_is_told_by_what_it_was_made_from(motionkit: Run, paper_folder: Path) -> None:
    first = floors(motionkit, paper_folder)
    assert first.code == 0 and first.err.startswith("1 run, 0 of them done\n")
    again = floors(motionkit, paper_folder)
    assert (again.code, again.err) == (0, "1 run, 1 of them done\n")
    assert floors(motionkit, paper_folder, "--frames", 60).failed_with(
        "last-frame-0.json", "--frames 30, not 60"
    )
    (file,) = Path("results").rglob("*.json")
    file.write_text("")
    assert floors(motionkit, paper_folder).failed_with("last-frame-0.json", "delete it")
    listed = motionkit(
        "experiment", "list", "--set", "all", "--data", paper_folder, "--results", "results", "--json"
    )
    assert listed.code == 0 and "not counted: " in listed.err
    assert {row["name"]: row["done"] for row in json.loads(listed.out)}["last frame"] == 0


def test_what_cannot_be_read_or_written_is_said_first(motionkit: Run, paper_folder: Path) -> None:
    Path("results").mkdir()
    Path("results/all").write_text("")
    assert floors(motionkit, paper_folder).failed_with("results", "cannot be written", "--results")
    assert motionkit("experiment", "list", "--data", "nowhere").failed_with("nowhere: not a dataset folder")
    assert motionkit("experiment", "list").code == 0, "the default folder need not be there"


def test_tables_and_figures_name_a_broken_result(motionkit: Run, paper_folder: Path) -> None:
    floors(motionkit, paper_folder)
    (file,) = Path("results").rglob("*.json")
    result = json.loads(file.read_text())
    del result["groups"]
    file.write_text(json.dumps(result))
    for command in ("tables", "figures"):
        said = motionkit("experiment", command, "--results", "results", "-o", "out")
        assert said.failed_with("last-frame-0.json", "groups is missing")
