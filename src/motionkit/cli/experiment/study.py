"""`motionkit experiment study` and `ttest`: the paper's user study (section 5.4)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.common import (
    EXISTING_FILE,
    EXISTING_FOLDER,
    json_option,
    option,
    print_json,
    remark,
    seed_option,
    stdout_console,
)
from motionkit.cli.experiment.options import output_option
from motionkit.cli.fitting_table import print_fitting
from motionkit.errors import MotionkitError
from motionkit.lab.paper.published import STUDIES, StudyRow
from motionkit.names import counted

if TYPE_CHECKING:
    from motionkit.lab.paper.ttest import Comparison, Score


@click.command("study")
@click.argument("folder", type=EXISTING_FOLDER)
@output_option("study.html", folder=False)
@seed_option
def study_command(folder: Path, output: Path, seed: int) -> None:
    """Write the page of a user study (paper section 5.4): one HTML file that raters open.

    FOLDER has one folder for each group of motions: recording.bvh, and one BVH file per model, named after it. The
    page shows the models without their names and in random order beside the recording, asks for a rank in five aspects
    and for a score from 1 to 5, and saves the answers as answers-NAME.json, NAME being the rater's.
    """
    from motionkit.lab.paper.study import write_study

    groups = write_study(folder, output, seed)
    stdout_console().print(f"wrote {output}: {counted(groups, 'group')} of motions")


@click.command("ttest")
@click.argument("answers", nargs=-1, required=True, type=EXISTING_FILE)
@option("--model", default="TPTN", help="Model that is compared with all others.")
@click.option(
    "--paper",
    "paper_table",
    type=click.Choice(tuple(STUDIES)),
    help="Also print the paper's table 4 (without dances) or 5 (with dances).",
)
@json_option
def ttest_command(answers: tuple[Path, ...], model: str, paper_table: str | None, as_json: bool) -> None:
    """Print the paper's tables 4 and 5 from ANSWERS of a study, one file for each rater.

    A sample is the mean score of a group of motions over all raters. n is the number of samples of each model; with
    them stand mean, standard deviation, t, degrees of freedom and one-sided p. Raters and motions of the paper's
    study are others than yours: what can be held against it is which models are liked better.
    """
    from motionkit.lab.paper.ttest import read_answers, scores, unequal_samples

    read = read_answers(answers)
    found = scores(read)
    rows = _comparisons(found, model)
    if len(read) == 1:
        remark("one rater alone: the figures are that person's taste")
    if differing := unequal_samples(read):
        remark(differing)
    if not rows:
        raise MotionkitError(f"no model is left to compare {model} with")
    paper = STUDIES.get(paper_table or "", {})
    if model != "TPTN":  # the paper gives t and p for TPTN only
        paper = {name: StudyRow(row.mean, row.std) for name, row in paper.items()}
    if paper_table and not paper.keys() & {row.rival.name for row in rows}:
        remark(f"the paper's table {paper_table} has none of these models, but {', '.join(paper)}")
    if as_json:
        print_json(_ttest_facts(found[model], rows, len(answers), paper))
    else:
        _print_ttest(found[model], rows, len(answers), paper)


def _comparisons(found: dict[str, Score], model: str) -> list[Comparison]:
    """Compare a model with each other one; report and skip those without anything to test."""
    from motionkit.lab.paper.ttest import NothingToTest, compare

    if model not in found:
        raise MotionkitError(f"no answers about {model!r}, expected one of {', '.join(sorted(found))}")
    if len(found) == 1:
        raise MotionkitError(f"no answers about models other than {model}: nothing to compare it with")
    rows = []
    for name, rival in sorted(found.items()):
        try:
            rows += [compare(found[model], rival)] if name != model else []
        except NothingToTest as error:
            remark(f"{name} is left out: {error}")
    return rows


def _score_facts(score: Score) -> dict[str, Any]:
    return {"model": score.name, "n": len(score.values), "mean": score.mean, "std": score.deviation}


def _ttest_facts(
    mine: Score, rows: Sequence[Comparison], raters: int, paper: dict[str, StudyRow]
) -> dict[str, Any]:
    """The t-test for --json, with the paper's numbers if requested and available."""

    def beside(facts: dict[str, Any]) -> dict[str, Any]:
        return {**facts, "paper": paper[facts["model"]]._asdict()} if facts["model"] in paper else facts

    against = [beside({**_score_facts(r.rival), "t": r.t, "freedom": r.freedom, "p": r.p}) for r in rows]
    return {**beside(_score_facts(mine)), "raters": raters, "against": against}


def _print_ttest(mine: Score, rows: Sequence[Comparison], raters: int, paper: dict[str, StudyRow]) -> None:
    header = ["against", "n", "mean", "std", "t", "df", "p (one-sided)"]
    spare = [1, 5, 3]
    if paper:
        header += [f"paper {name}" for name in StudyRow._fields]
        spare += [8, 7, 10]
    lines = []
    for row in rows:
        figures = (f"{row.rival.mean:.3f}", f"{row.rival.deviation:.3f}", f"{row.t:.3f}")
        line = [row.rival.name, f"{len(row.rival.values)}", *figures, f"{row.freedom}", f"{row.p:.3e}"]
        if paper:
            line += _paper_cells(paper.get(row.rival.name))
        lines.append(line)
    stdout_console().print(
        f"{mine.name}: n {len(mine.values)}, mean {mine.mean:.3f}, std {mine.deviation:.3f}; "
        f"{counted(raters, 'rater')}"
    )
    if mine.name in paper:
        theirs = paper[mine.name]
        stdout_console().print(f"in the paper: mean {theirs.mean:.3f}, std {theirs.std:.3f}")
    print_fitting(header, lines, spare)


def _paper_cells(row: StudyRow | None) -> list[str]:
    """The cells of a row of the paper's table; empty if it has no such row."""
    shapes = (".3f", ".3f", ".3f", ".3e")
    values = row or (None,) * len(shapes)
    return ["" if value is None else f"{value:{shape}}" for value, shape in zip(values, shapes, strict=True)]


COMMANDS = (study_command, ttest_command)
