"""`motionkit experiment`: the paper's experiments, tables, figures and user study."""

from __future__ import annotations

import click

from motionkit.cli.experiment import in_between, results, rollouts, runs, study


@click.group("experiment")
def command() -> None:
    """The paper's experiments: train every variant alike, test it, and write the paper's tables.

    Names are those of the paper's tables (TPTN, EBTN, w/o-FFL ...); groups are tptn, parts, fusion, memory, losses,
    baselines and floors; all is everything.
    """


for _module in (runs, results, rollouts, in_between, study):
    for _subcommand in _module.COMMANDS:
        command.add_command(_subcommand)
