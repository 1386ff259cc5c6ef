from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import pytest

from motionkit.errors import MotionkitError
from motionkit.files import atomic_write


@pytest.fixture
def evaluate(motionkit, tiny_model_file: Path, dataset_folder: Path):
    return lambda *words: motionkit("evaluate", tiny_model_file, dataset_folder, "--quick", *words)


def test_accuracy_as_json_and_as_reports(evaluate, tmp_path: Path) -> None:
    said = evaluate("--only", "accuracy", "--seeds", 1, "--json", "-o", "out.md", "-o", "out.json")
    assert said.code == 0 and said.err == ""
    value = json.loads(said.out)
    assert value == json.loads((tmp_path / "out.json").read_text("utf-8"))
    assert value["seeds"] == 1 and [section["name"] for section in value["sections"]] == ["accuracy"]
    rows = value["sections"][0]["tables"][0]["rows"]
    assert {row["type"] for row in rows} >= {"walking", "running", "idle"}
    text = (tmp_path / "out.md").read_text("utf-8")
    assert "| accuracy | accuracy of walking |" in text and "## Action accuracy" in text


def test_one_heading_for_the_targets(evaluate) -> None:
    said = evaluate("--only", "accuracy", "--seeds", 1)
    assert said.code == 0 and said.out.count("Targets") == 1


def test_a_report_that_cannot_be_written_loses_nothing_else(
    evaluate, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The disk is full at the first report, after minutes of measuring: the board is printed, the second written."""

    @contextmanager
    def full(path: Path) -> Iterator[IO]:
        if path.name == "full.md":
            raise MotionkitError(f"{path}: cannot be written (no space left)")
        with atomic_write(path) as out:
            yield out

    monkeypatch.setattr("motionkit.files.atomic_write", full)
    said = evaluate("--only", "accuracy", "--seeds", 1, "-o", "full.md", "-o", "out.json")
    assert said.code == 1 and said.err == "error: full.md: cannot be written (no space left)\n"
    assert "Targets" in said.out and not (tmp_path / "full.md").exists()
    assert json.loads((tmp_path / "out.json").read_text("utf-8"))["seeds"] == 1


def test_reports_are_written_if_the_board_cannot_be_printed(
    evaluate, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def closed(*_: object) -> None:
        raise MotionkitError("closed")

    monkeypatch.setattr("motionkit.cli.evaluate._print", closed)
    said = evaluate("--only", "accuracy", "--seeds", 1, "-o", "out.json")
    assert said.failed_with("closed") and (tmp_path / "out.json").exists()


@pytest.mark.parametrize(
    ("words", "complaint"),
    [(["--only", "acuracy"], "unknown section 'acuracy'; did you mean 'accuracy'")],
)
def test_faults_leave_no_report(evaluate, tmp_path: Path, words: list[str], complaint: str) -> None:
    assert evaluate(*words, "-o", "out.md").failed_with(complaint)
    assert not list(tmp_path.iterdir())


def test_splits_are_not_mixed(evaluate, motionkit, tiny_model_file: Path, dataset_folder: Path) -> None:
    words = ("evaluate", tiny_model_file, dataset_folder, "--only", "stability", "--quick")
    for split, seed in (("test", 5), ("validation", 1000)):
        said = motionkit(*words, "--split", split, "--seed", seed)
        assert (
            said.code == 2
            and f"does not belong to the {split} split" in said.err
            and "Traceback" not in said.err
        )
    value = json.loads(evaluate("--only", "reconstruction", "--split", "validation", "--json").out)
    assert value["split"] == "validation" and value["seed"] == 0
    assert "has no validation clips" in value["sections"][0]["notes"][0]


def test_wrong_files_and_names(
    motionkit, tmp_path: Path, tiny_model_file: Path, dataset_folder: Path
) -> None:
    assert motionkit("evaluate", "nothing.safetensors", dataset_folder).failed_with("no such file")
    assert motionkit("evaluate", tiny_model_file, tmp_path).failed_with("not a dataset folder")
    assert motionkit("evaluate", tiny_model_file, dataset_folder, "-o", "out.pdf").code == 2
    assert motionkit("evaluate", tiny_model_file, dataset_folder, "--seeds", "0").code == 2
