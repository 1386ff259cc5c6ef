from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import pytest

from motionkit.cli.training_monitor import TrainingMonitor, check_preview
from motionkit.data.dataset import Dataset
from motionkit.data.repeat import FEW_SECONDS, small_types, type_amounts
from motionkit.motion.bvh import write_bvh
from motionkit.names import duration
from motionkit.training.presets import train_options
from motionkit.training.report import TrainEvent
from synthetic_motions import make_walk

LOSSES = {"gauss": 2.0, "total": 3.0}
STEP = TrainEvent("step", 1, 2.0, LOSSES, share=0.01)


def test_lines_say_how_far_how_fast_and_how_long(capsys, tmp_path: Path) -> None:
    monitor = TrainingMonitor(False, train_options("tiny", steps=100), None, tmp_path)
    for share in (0.0, 0.1, 0.5, 0.9):
        monitor(TrainEvent("stage", 0, 0.0, {}, text="making spliced transitions", share=share))
    monitor(STEP)
    monitor(replace(STEP, kind="log", step=21, seconds=42.0, share=0.21))
    lines = capsys.readouterr().err.splitlines()
    assert lines[:3] == [f"making spliced transitions: {percent} %" for percent in (0, 50, 90)]
    assert lines[3] == "step 21 of 100, 21%, 0.50 steps/s, 2.6 min left: gauss 2.000 total 3.000".replace(
        "2.6", "3"
    )
    assert len(lines) == 4
    for name in ("calibrating", "scoring"):
        monitor(TrainEvent("stage", 100, 2.0, {}, text=name))
    assert capsys.readouterr().err.splitlines() == ["calibrating: 0 %", "scoring: 0 %"]


def test_the_first_line_has_no_rate_and_losses_can_be_left_out(capsys, tmp_path: Path) -> None:
    monitor = TrainingMonitor(False, train_options("tiny", steps=100), None, tmp_path, losses=False)
    monitor(replace(STEP, kind="log"))
    monitor(replace(STEP, kind="log", step=2, seconds=4.0, share=0.02))
    assert capsys.readouterr().err.splitlines() == [
        "step 1 of 100, 1%", "step 2 of 100, 2%, 0.50 steps/s, 3 min left"
    ]  # fmt: skip


def test_the_rate_of_a_resumed_run_and_what_is_left_are_those_since_it_went_on(
    capsys, tmp_path: Path
) -> None:
    monitor = TrainingMonitor(False, train_options("tiny", steps=2000), None, tmp_path)
    monitor(replace(STEP, step=1000, seconds=9000.0, share=0.5))
    monitor(replace(STEP, kind="log", step=1040, seconds=9020.0, share=0.52))
    assert "step 1040 of 2000, 52%, 2.00 steps/s, 8 min left" in capsys.readouterr().err


@pytest.mark.parametrize(("seconds", "words"), [(5, "5 s"), (200, "3 min"), (9000, "2.5 h")])
def test_durations(seconds: float, words: str) -> None:
    assert duration(seconds) == words


def test_a_signal_is_answered_at_once(capfd, tmp_path: Path) -> None:
    monitor = TrainingMonitor(False, train_options("tiny", steps=2), None, tmp_path)
    monitor(TrainEvent("stop", 5, 1.0, LOSSES, text="stopping after this step"))
    assert capfd.readouterr().err == "stopping after this step\n"


def test_a_preview_grows_with_every_evaluation(tmp_path: Path) -> None:
    samples, page = tmp_path / "run" / "samples", tmp_path / "page.html"
    samples.mkdir(parents=True)
    for name in ("go-predicted", "go-true"):
        write_bvh(samples / f"{name}.bvh", make_walk(20))
    monitor = TrainingMonitor(True, train_options("tiny", steps=2), page, samples)
    monitor(TrainEvent("score", 5, 1.0, {}))
    first = page.read_text("utf-8")
    assert "go-step-5" in first and "go-true" in first and "go-step-15" not in first
    for step in (15, 25, 35, 45):
        monitor(TrainEvent("score", step, 1.0, {}))
    text = page.read_text("utf-8")
    assert [step for step in (5, 15, 25, 35, 45) if f"go-step-{step}" in text] == [5, 25, 35, 45]


def test_a_preview_that_fails_does_not_end_the_run(capsys, tmp_path: Path) -> None:
    monitor = TrainingMonitor(True, train_options("tiny", steps=2), tmp_path / "page.html", tmp_path / "none")
    monitor(TrainEvent("score", 5, 1.0, {}))
    assert "the preview failed, the run continues" in capsys.readouterr().err


def test_a_preview_is_a_page_or_a_sheet() -> None:
    check_preview(None)
    check_preview(Path("a.PNG"))
    with pytest.raises(click.UsageError, match=r"--preview a.gif: expected a file named .html or .png"):
        check_preview(Path("a.gif"))


def test_types_with_little_to_learn_from_are_named(dataset: Dataset) -> None:
    amounts = type_amounts(dataset)
    assert set(amounts) == set(dataset.types)
    frames = {  # the image of a hop to the left is one to the right
        (clip.start, kind): int((dataset.clip_types(clip) == kind).sum())
        for clip in dataset.select("train")
        for kind in np.unique(dataset.clip_types(clip)).tolist()
    }
    assert sum(seconds for _, seconds in amounts.values()) == pytest.approx(
        sum(frames.values()) / dataset.fps
    )
    lines = small_types(dataset)
    for kind, (clips, seconds) in amounts.items():
        mine = [line for line in lines if line.startswith(repr(kind))]
        assert len(mine) == (clips < 2 or seconds < FEW_SECONDS), kind
