"""Options that the commands of `motionkit experiment` share, and their check for torch."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from motionkit.cli.common import FOLDER, gathered, option, together
from motionkit.errors import MotionkitError
from motionkit.training.budgets import BUDGETS

if TYPE_CHECKING:
    from motionkit.lab.paper.runs import Plan

RESULTS = Path("experiments/results")
# Folders for results of single models, beside the results folder.
SCENES, LONG, BODIES = (RESULTS.parent / name for name in ("scenes", "long", "bodies"))

data_option = option(
    "--data",
    default="datasets/paper",
    type=FOLDER,
    help="Dataset folder, made by preprocess --layout expmap-root-1 --own-bodies --raw.",
)
set_option = option(
    "--set",
    "selection",
    default="D_L",
    help="Data set: D_L, all, all-mirrored, no-dances, locomotion, or one of your own (sets/NAME.json in --data).",
)
results_option = option(
    "--results", default=str(RESULTS), type=FOLDER, help="Folder of results; checkpoints go beside it."
)


def frames_option(text: str) -> Callable:
    """--frames: how many frames are made of a test sequence."""
    return option("--frames", default=240, type=click.IntRange(30, 10_000), help=text)


def seeds_option(default: int, text: str) -> Callable:
    """--seeds: how often something is made."""
    return option("--seeds", default=default, type=click.IntRange(1, 100), help=text)


def _plan(data: Path, selection: str, budget: str, steps: int | None, frames: int, results: Path) -> Plan:
    needs_torch()
    from motionkit.lab.paper.runs import Plan

    return Plan(data, selection, budget, steps, results, results.parent / "checkpoints", frames)


# The data set, the amount of training and the results folder, which the command gets as its plan.
plan_options = together(
    data_option,
    set_option,
    option(
        "--budget",
        default="cpu",
        type=click.Choice(tuple(BUDGETS)),
        help="Training of every network: steps, batch, window and rate for a CPU, for a GPU, or the paper's own.",
    ),
    click.option("--steps", type=click.IntRange(min=1), help="Training steps; the budget's by default."),
    frames_option("Largest number of frames to make of a test sequence."),
    results_option,
    gathered("plan", _plan),
)


def output_option(default: str, folder: bool) -> Callable:
    """-o: the folder or the page to write."""
    return option(
        "-o",
        "--output",
        default=default,
        type=click.Path(path_type=Path, file_okay=not folder, dir_okay=folder),
        help="Folder to write to." if folder else "Page to write.",
    )


def needs_torch() -> None:
    """Raise MotionkitError if torch is not installed, before anything imports it."""
    from importlib.util import find_spec

    if find_spec("torch") is None:
        raise MotionkitError("experiments need torch: pip install 'motionkit[train]'")
