"""Options that the commands of `motionkit experiment` share, and their check for torch."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.errors import MotionkitError
from motionkit.training.budgets import BUDGETS

if TYPE_CHECKING:
    from motionkit.lab.paper.runs import Plan

RESULTS = Path("experiments/results")
# Folders for results of single models, beside the results folder.
SCENES, LONG, BODIES = (RESULTS.parent / name for name in ("scenes", "long", "bodies"))


def data_option(function: Callable) -> Callable:
    """--data: the dataset folder of the experiments."""
    return click.option(
        "--data",
        default="datasets/paper",
        show_default=True,
        type=click.Path(path_type=Path, file_okay=False),
        help="Dataset folder, made by preprocess --layout expmap-root-1 --own-bodies --raw.",
    )(function)


set_option = click.option(
    "--set",
    "selection",
    default="D_L",
    show_default=True,
    help="Data set: D_L, all, all-mirrored, no-dances, locomotion, or one of your own (sets/NAME.json in --data).",
)


def plan_options(function: Callable) -> Callable:
    """Options for the data set, the amount of training, and the results folder."""
    options: list[Callable] = [
        data_option,
        set_option,
        click.option(
            "--budget",
            default="cpu",
            show_default=True,
            type=click.Choice(tuple(BUDGETS)),
            help="Training of every network: steps, batch, window and rate for a CPU, for a GPU, or the paper's own.",
        ),
        click.option("--steps", type=click.IntRange(min=1), help="Training steps; the budget's by default."),
        click.option(
            "--frames",
            default=240,
            show_default=True,
            type=click.IntRange(30, 10_000),
            help="Largest number of frames to make of a test sequence.",
        ),
        results_option,
    ]
    for option in reversed(options):
        function = option(function)
    return function


def make_plan(options: dict[str, Any], device: str = "auto") -> Plan:
    """The plan described by plan_options."""
    from motionkit.lab.paper.runs import Plan

    results = options["results"]
    return Plan(
        options["data"],
        options["selection"],
        options["budget"],
        options["steps"],
        results,
        results.parent / "checkpoints",
        options["frames"],
        device,
    )


def output_option(default: str, folder: bool) -> Callable:
    """-o: the folder or the page to write."""
    return click.option(
        "-o",
        "--output",
        default=default,
        show_default=True,
        type=click.Path(path_type=Path, file_okay=not folder, dir_okay=folder),
        help="Folder to write to." if folder else "Page to write.",
    )


def results_option(function: Callable) -> Callable:
    """--results: the folder of results."""
    option: Callable = click.option(
        "--results",
        default=str(RESULTS),
        show_default=True,
        type=click.Path(path_type=Path, file_okay=False),
        help="Folder of results; checkpoints go beside it.",
    )
    return option(function)


def needs_torch() -> None:
    """Raise MotionkitError if torch is not installed, before anything imports it."""
    from importlib.util import find_spec

    if find_spec("torch") is None:
        raise MotionkitError("experiments need torch: pip install 'motionkit[train]'")
