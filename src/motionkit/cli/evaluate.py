"""`motionkit evaluate`: the scoreboard of a model."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from motionkit.cli.common import (
    FILE,
    PLACE,
    Stages,
    gathered,
    json_option,
    option,
    print_json,
    stdout_console,
)
from motionkit.cli.synthesis_options import make_noise, noise_options, reference_option

if TYPE_CHECKING:
    from motionkit.cli.console import PlainConsole
    from motionkit.lab.scoreboard.report import Scoreboard
    from motionkit.lab.scoreboard.settings import EvaluationSettings
    from motionkit.models.model import MotionModel
    from motionkit.tables import Table


@dataclass(frozen=True)
class EvaluateOptions:
    """The options of the command."""

    only: str | None
    split: str
    seeds: int | None
    quick: bool
    output: tuple[Path, ...]
    jobs: int
    noise: str | None
    temperature: float | None
    reference: str
    seed: int | None
    as_json: bool

    def measured(self, model: MotionModel) -> tuple[list[str], EvaluationSettings]:
        """The sections to measure, and the evaluation settings."""
        from motionkit.errors import ControlError
        from motionkit.lab.scoreboard.settings import QUICK, QUICK_TYPES, EvaluationSettings

        sections = [word.strip() for word in (self.only or "").split(",") if word.strip()]
        basis = QUICK if self.quick else EvaluationSettings()
        if self.quick and not sections:
            sections, basis = ["types"], QUICK_TYPES
        noise = make_noise(self.noise, self.temperature, model)
        try:
            settings = replace(basis, seeds=self.seeds or basis.seeds, split=self.split, seed=self.seed)
            return sections, replace(settings, noise=noise, reference=self.reference)
        except ControlError as error:
            raise click.UsageError(str(error)) from None


@click.command("evaluate")
@click.argument("model")
@click.argument("dataset", type=PLACE)
@click.option(
    "--only", help="Sections to measure, separated by commas, such as accuracy,paths; all by default."
)
@option(
    "--split",
    default="test",
    type=click.Choice(["validation", "test"]),
    help="Held-out clips and seeds to use: validation (seeds below 1000) to choose settings, test (from 1000 on) to "
    "report.",
)
@click.option(
    "--seeds",
    type=click.IntRange(1, 500),
    help="Roll-outs per type for accuracy, visible and variety; 20 by default.",
)
@click.option(
    "--quick",
    is_flag=True,
    help="Only say which types work, and why the others do not, in about two minutes; with --only, measure those "
    "sections with 3 seeds and shorter roll-outs.",
)
@click.option(
    "-o",
    "--output",
    type=FILE,
    multiple=True,
    help="Write the report to a .md or .json file; repeat it for both.",
)
@option("--jobs", default=1, type=click.IntRange(1, 256), help="Number of processes.")
@noise_options
@reference_option
@click.option(
    "--seed",
    type=int,
    help="First random seed; the first of the split by default, 0 or 1000. The same seed gives the same result.",
)
@json_option
@gathered("options", EvaluateOptions)
def command(model: str, dataset: Path, options: EvaluateOptions) -> None:
    """Compare the motion of MODEL with the recordings of DATASET, and print its scoreboard.

    MODEL is a model file, or the word bundled. DATASET is a folder made by preprocess. The sections are:

    \b
    visible         leaps of knees, flipped bodies, floating, sinking, falls
    accuracy        how often the motion shows the type asked for
    variety         distance between seeds, share of the recordings they show
    stability       whether long roll-outs keep moving and stay on the floor
    reconstruction  held-out clips, rolled out from their first frames
    gaits           steadiness of gaits, tight circles, steps a second
    paths           distance from the path
    response        seconds from a command to the response
    smoothness      joint speed and braking in transitions that no clip contains
    types           whether each type works, and why not; only with --quick or --only
    classes         accuracy of a classifier on the motion; only with --only

    The default output is measured, with feet locked; other columns have the raw network and the model without
    its reference recordings. docs/evaluation.md defines every number. The exit code is 0 whether or not the
    targets are reached.
    """
    for file in options.output:
        if file.suffix.lower() not in (".md", ".json"):
            raise click.UsageError(f"{file}: expected a report named .md or .json")

    from motionkit.files import check_outputs
    from motionkit.lab.scoreboard.board import evaluate
    from motionkit.models.bundled import open_model

    check_outputs(options.output, [model, *dataset.glob("*")])
    loaded = open_model(model)
    sections, settings = options.measured(loaded)
    with Stages() as show:
        show("reading", 0)
        board = evaluate(
            dataset,
            model=loaded,
            only=sections,
            settings=settings,
            jobs=options.jobs,
            progress=lambda name, share: show(name, 100 * share, 100),
        )
    board.about.update({"model": model, "dataset": str(dataset)})
    # The run takes long: neither a report that cannot be written nor a closed pipe may lose it.
    try:
        if options.as_json:
            print_json(board.as_dict())
        else:
            _print(board, stdout_console())
    finally:
        _write_reports(board, options.output)


def _write_reports(board: Scoreboard, files: Sequence[Path]) -> None:
    """Write every report that can be written; raises the first MotionkitError at the end."""
    from motionkit.errors import MotionkitError
    from motionkit.files import atomic_write, plain

    faults = []
    for file in files:
        try:
            with atomic_write(file) as out:
                if file.suffix.lower() == ".md":
                    out.write(board.markdown())
                else:
                    json.dump(plain(board.as_dict()), out, indent=2)
        except MotionkitError as error:
            faults.append(error)
    if faults:
        raise faults[0]


def _print(board: Scoreboard, console: PlainConsole) -> None:
    for section in board.sections:
        console.print()
        console.print(section.title, style="bold")
        for table in section.tables:
            _print_table(table, console)
        for note in section.notes:
            console.print(f"note: {note}", style="dim")
    console.print()
    _print_table(board.summary(), console)


def _print_table(table: Table, console: PlainConsole) -> None:
    from motionkit.cli.console import BARE, make_table

    style = {"title": table.title, "title_justify": "left", **BARE}
    console.print(make_table(table.columns, table.texts(), range(len(table.columns)), **style))
