"""log.csv and TensorBoard's files beside a run."""

from __future__ import annotations

import csv
import sys
import types
from pathlib import Path
from typing import Any

import pytest

from motionkit.errors import OverwriteError
from motionkit.training.log_folder import TABLE, LogFolder, check_table
from motionkit.training.report import TrainEvent
from motionkit.training.scores import TypeScore

SCORE = TypeScore("walking", 0.9, 3.5, 1.1, (80.0, 95.0))
EVENTS = [
    TrainEvent("step", 1, 0.5, {"total": 9.0}),
    TrainEvent("log", 10, 5.0, {"total": 4.0, "contacts": 0.5}),
    TrainEvent("score", 20, 9.0, {}, (SCORE,)),
    TrainEvent("log", 20, 10.0, {"total": 3.0, "contacts": 0.4}),
]


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / TABLE).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_losses_become_rows_and_a_resumed_run_adds_to_them(tmp_path: Path) -> None:
    later = [TrainEvent("log", 30, 12.0, {"total": 2.0, "contacts": 0.3})]
    for events, resumed in ((later, False), (EVENTS, False), (later, True)):
        with LogFolder(tmp_path / "new" / "logs", resumed) as logs:
            for event in events:
                logs(event)
    found = rows(tmp_path / "new" / "logs")
    assert [row["step"] for row in found] == ["10", "20", "30"]
    assert [float(row["total"]) for row in found] == [4.0, 3.0, 2.0] and float(found[-1]["contacts"]) == 0.3


def test_a_table_of_others_is_refused_and_an_earlier_one_stays_until_the_first_row(tmp_path: Path) -> None:
    check_table(tmp_path)
    with LogFolder(tmp_path) as logs:
        logs(EVENTS[1])
    with pytest.raises(OverwriteError, match=r"log.csv: exists; choose another folder"):
        check_table(tmp_path)
    check_table(tmp_path, resumed=True)
    with LogFolder(tmp_path):
        assert len(rows(tmp_path)) == 1
    (tmp_path / TABLE).write_text("mine\n", "utf-8")
    with pytest.raises(OverwriteError, match=r"log.csv: was not written by motionkit"):
        check_table(tmp_path)


def test_a_table_that_cannot_be_written_is_a_note(tmp_path: Path) -> None:
    notes: list[str] = []
    (tmp_path / TABLE).mkdir()
    with LogFolder(tmp_path, on_note=notes.append) as logs:
        for event in EVENTS:
            logs(event)
    assert len(notes) == 1 and notes[0].startswith("cannot write log.csv (")


def test_tensorboard_gets_losses_and_scores(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[tuple[Any, ...]] = []

    class Writer:
        def __init__(self, folder: str) -> None:
            written.append(("open", folder))

        def add_scalar(self, name: str, value: float, step: int) -> None:
            written.append((name, value, step))

        def close(self) -> None:
            written.append(("close",))

    board = types.ModuleType("torch.utils.tensorboard")
    board.SummaryWriter = Writer  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", board)
    with LogFolder(tmp_path) as logs:
        for event in EVENTS:
            logs(event)
    assert ("loss/total", 4.0, 10) in written and ("slide/walking", 1.1, 20) in written
    assert written[0] == ("open", str(tmp_path)) and written[-1] == ("close",)


def test_without_tensorboard_there_is_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    with LogFolder(tmp_path) as logs:
        for event in EVENTS:
            logs(event)
    assert len(rows(tmp_path)) == 2
