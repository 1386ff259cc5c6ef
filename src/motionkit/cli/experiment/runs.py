"""`motionkit experiment list`, `run` and `shipped`: train and measure networks."""

from __future__ import annotations

import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from motionkit.cli.common import STOPPED, Stages, json_option, option, print_json, remark, stdout_console
from motionkit.cli.experiment.options import (
    data_option,
    frames_option,
    needs_torch,
    plan_options,
    results_option,
    seeds_option,
    set_option,
)
from motionkit.errors import MotionkitError
from motionkit.names import counted

if TYPE_CHECKING:
    from motionkit.lab.paper.runs import Plan


@click.command("list")
@plan_options
@json_option
def list_command(plan: Plan, as_json: bool) -> None:
    """List experiments: group, parameters in millions beside the paper's, and finished runs."""
    from motionkit.lab.paper.runs import listed

    named = click.get_current_context().get_parameter_source("data") is not ParameterSource.DEFAULT
    rows, faults = listed(plan, named or plan.data.exists())
    if faults:
        others = f" (and {counted(len(faults) - 1, 'other')})" if faults[1:] else ""
        remark(f"not counted: {faults[0]}{others}")
    if as_json:
        print_json(rows)
    else:
        _print_list(rows)


def _print_list(rows: list[dict[str, Any]]) -> None:
    from rich.table import Table
    from rich.text import Text

    table = Table(caption="M: millions of parameters, paper: the paper's; min: minutes that a run took here")
    for name in ("name", "M", "paper", "min", "done", "what it is"):
        right = name in ("M", "paper", "min")
        table.add_column(name, justify="right" if right else "left", no_wrap=name != "what it is")
    for number, row in enumerate(rows):
        if number == 0 or row["group"] != rows[number - 1]["group"]:
            table.add_section()
            table.add_row(Text(row["group"], style="bold"))
        count = f"{row['parameters'] / 1e6:.2f}" if row["parameters"] else ""
        paper = f"{row['paper_parameters']:g}" if row["paper_parameters"] else ""
        spent = "" if row["minutes"] is None else f"{row['minutes']:.0f}"
        table.add_row(row["name"], count, paper, spent, f"{row['done']} of {row['seeds']}", row["text"])
    stdout_console().print(table)


@click.command("run")
@click.argument("names", nargs=-1, required=True)
@plan_options
@seeds_option(1, "Seeds of each network, up to the number that its table needs.")
@click.option("--every-seed", is_flag=True, help="Give every variant all of --seeds.")
@option("--jobs", default=1, type=click.IntRange(1, 64), help="Runs at a time, each on one thread.")
@option("--device", default="auto", help="Device to train on: auto, cpu, cuda, cuda:1 ...")
@click.option(
    "--together", is_flag=True, help="Train networks in the same steps, which one GPU does much faster."
)
def run_command(
    names: tuple[str, ...], plan: Plan, seeds: int, every_seed: bool, jobs: int, device: str, together: bool
) -> None:
    """Run NAMES: experiments, groups or all. Finished runs are skipped, stopped runs continue.

    Each run trains on the data set, rolls out its test sequences, and writes one JSON file to the folder of results.
    The first seed of everything comes first.
    """
    from motionkit.lab.paper.runs import run_all, tasks_of, unfinished
    from motionkit.lab.paper.together import run_together

    plan = replace(plan, device=device)
    tasks = tasks_of(plan, names, seeds, every_seed)
    left = unfinished(plan, tasks)
    remark(f"{counted(len(tasks), 'run')}, {len(tasks) - len(left)} of them done")
    run = run_together if together else run_all
    with Stages() as show:
        try:
            # Ctrl-C closes this at once, so that runs in other processes stop before the last line is printed.
            with closing(run(plan, left, jobs, remark, show.share("running"))) as made:
                for count, path in enumerate(made, 1):
                    remark(f"{count} of {len(left)}: wrote {path}")
        except KeyboardInterrupt:
            remark("stopped; the same command continues")
            sys.exit(STOPPED)


@click.command("shipped")
@data_option
@set_option
@frames_option("Most frames to make of a test sequence; use the number of the runs to compare with.")
@seeds_option(3, "Runs.")
@results_option
def shipped_command(data: Path, selection: str, frames: int, seeds: int, results: Path) -> None:
    """Measure the bundled model as shipped on the test sequences, for the second table.

    Reference poses, sampling presets, corrections and foot locks are on; it is measured with --reference none
    too. Test sequences that are mirror images of training clips are left out, since the model has seen them.
    Earlier results are overwritten, also those with another number of --frames.
    """
    from motionkit.lab.paper.datasets import select
    from motionkit.lab.paper.shipped import run_shipped
    from motionkit.models.bundled import BUNDLED, open_model

    dataset = select(data, selection)
    models = {
        name: open_model(BUNDLED, reference)
        for name, reference in (("shipped", "auto"), ("shipped without references", "none"))
    }
    with Stages() as show:
        files = run_shipped(models, dataset, selection, seeds, frames, results, show.share("measuring"))
    for file in files:
        stdout_console().print(f"wrote {file}")


@click.command("measure")
@data_option
@results_option
def measure_command(data: Path, results: Path) -> None:
    """Measure the saved roll-outs of finished runs again. Nothing is trained.

    Every metric is written into the results again, so older results get new metrics too.
    """
    needs_torch()
    from motionkit.lab.paper.runs import measure_again

    count = 0
    for path in measure_again(data, results):
        stdout_console().print(f"measured {path}")
        count += 1
    if not count:
        raise MotionkitError(f"{results}: no roll-outs; motionkit experiment run keeps them beside results")


COMMANDS = (list_command, run_command, shipped_command, measure_command)
