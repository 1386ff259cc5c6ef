"""`motionkit experiment tables` and `figures`: results of finished runs, compared with the paper's."""

from __future__ import annotations

from pathlib import Path

import click

from motionkit.cli.common import FILE, FOLDER, option, stdout_console
from motionkit.cli.experiment.options import needs_torch, output_option, results_option
from motionkit.errors import MotionkitError


@click.command("tables")
@results_option
@click.option("--set", "selection", help="Only this data set; all by default.")
@output_option("docs/experiments.md", folder=False)
@click.option("--latex", type=FILE, help="Also write all tables in LaTeX.")
def tables_command(results: Path, selection: str | None, output: Path, latex: Path | None) -> None:
    """Write all tables from the results, the paper's figures beside ours. Nothing is trained."""
    needs_torch()
    from motionkit.lab.paper.model_results import OF_ONE_MODEL, read_models
    from motionkit.lab.paper.page import Extras, write_page

    extras = {kind: tuple(read_models(results.parent / kind, kind)) for kind in OF_ONE_MODEL}
    found = [each for each in _read(results) if selection in (None, each["data"])]
    if not found:
        raise MotionkitError(f"{results}: no results of the data set {selection} yet")
    write_page(found, output, latex, Extras(**extras))
    stdout_console().print(f"wrote {output}" + (f" and {latex}" if latex else ""))


@click.command("figures")
@results_option
@option(
    "--data",
    type=FOLDER,
    help="Dataset folder of the runs: also draw what networks made of a jump and of a twist (paper figures 10, 11).",
)
@output_option("experiments/figures", folder=True)
def figures_command(results: Path, data: Path | None, output: Path) -> None:
    """Draw PNGs from the results: training curves, BM against AFS, and inference speed against parts."""
    needs_torch()
    from motionkit.lab.paper.figures import write_figures
    from motionkit.lab.paper.rollout_sheets import write_sheets

    sheets = write_sheets(data, results, output) if data else ()
    for path in (*write_figures(_read(results), output), *sheets):
        stdout_console().print(f"wrote {path}")


def _read(results: Path) -> list[dict]:
    from motionkit.lab.paper.runs import read_results

    found = read_results(results) if results.exists() else []
    if not found:
        raise MotionkitError(f"{results}: no results yet; make some with motionkit experiment run")
    return found


COMMANDS = (tables_command, figures_command)
