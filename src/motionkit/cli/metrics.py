"""`motionkit metrics`: measures clips, alone or against their ground truth."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.common import (
    EXISTING,
    EXISTING_FILE,
    Stages,
    animation_option,
    clip_options,
    gathered,
    json_option,
    lines_of_files,
    option,
    print_json,
    processes_option,
    remark,
    say,
    stdout_console,
)
from motionkit.cli.finite import FINITE, FiniteRange
from motionkit.cli.outputs import Outputs, default_output, input_lines, view_option
from motionkit.errors import MotionkitError
from motionkit.metrics.value import MetricSettings
from motionkit.names import visible

if TYPE_CHECKING:
    from rich.table import Table

    from motionkit.metrics.pairs import MeanRow, PairResult
    from motionkit.metrics.report import MetricReport, MetricRow

LISTED_FILES = 60  # rows of the table of pairs
# Columns of the table of pairs, with and without ground truth; other outputs have all metrics.
_OF_EACH = {
    True: ("afs", "jerk", "ssim-window", "mpjpe", "path-mean"),
    False: ("bm-geodesic", "afs", "skate-ratio", "jerk", "penetration-mean"),
}


def _positive(flag: str, text: str, **default: float) -> Any:
    return option(flag, type=FiniteRange(min=0, min_open=True), help=text, **default)


def _threshold(flag: str, text: str) -> Any:
    """An option for a field of MetricSettings."""
    return _positive(flag, text, default=getattr(MetricSettings, flag[2:].replace("-", "_")))


@dataclass(frozen=True)
class Measuring:
    """How to read, compare and measure files; options named generated apply to the second file of a pair."""

    skip: int
    given: int
    align_start: bool
    scale: float | None
    generated_scale: float | None
    fps: float | None
    generated_fps: float | None
    settings: MetricSettings

    @property
    def rates(self) -> tuple[float | None, float | None]:
        """Frame rates given for the two files."""
        return self.fps, self.generated_fps

    def check(self, paired: bool) -> None:
        """Raise UsageError if an option for the second file is given without one."""
        for name in ("given", "align_start", "generated_scale", "generated_fps"):
            if getattr(self, name) and not paired:
                raise click.UsageError(f"--{name.replace('_', '-')} needs a second file, GENERATED")

    def evaluate(self, truth: Path, made: Path | None) -> MetricReport:
        """The metrics of one file or of a pair."""
        from motionkit.metrics.report import evaluate_files

        scales = (self.scale, self.generated_scale)
        how = (self.settings, self.skip, self.align_start, scales, self.rates, self.given)
        return evaluate_files(truth, made, *how)

    def of_sets(self, measured: Sequence[PairResult], show: Stages) -> tuple[MetricRow, ...]:
        """The metrics of all pairs, compared as sets."""
        from motionkit.metrics.sets import set_metrics_of_files

        files = [(r.ground_truth, r.generated) for r in measured if r.report and r.generated]
        frames = [r.report.frames for r in measured if r.report and r.generated]
        scales = (self.scale, self.generated_scale)
        if not files:
            return ()
        progress = show.count("comparing", 2 * len(files))
        return set_metrics_of_files(files, scales, self.rates, self.skip, self.given, frames, progress)


@click.command(
    "metrics",
    help="""Measure GROUND_TRUTH, alone or with GENERATED.

    Each file is measured by body movement (bm), average foot sliding (afs), foot skate, jerk, penetration, leaps of
    knees and elbows, planted and hovering feet, and flights; a pair also by SSIM, MPJPE, trajectory distance
    (path), L2P, L2Q and NPSS. docs/metrics.md defines every id. Other rigs are mapped onto the 23 joints, other rates
    are resampled to 60 fps, and clips of different length are compared over their common frames; notes under the
    table say what was changed.

    Both may be folders of clips: files of the same name are pairs, and files without a partner are listed. One
    folder alone is measured file by file. --pair pairs files of different names. For many pairs the table shows each
    pair, the means, and Frechet distance and diversity of all files together; the exit code is 1 if any file was
    left out.
    """,
)
@click.argument("ground_truth", type=EXISTING, required=False)
@click.argument("generated", type=EXISTING, required=False)
@click.option(
    "--pair",
    "given_pairs",
    type=(EXISTING_FILE, EXISTING_FILE),
    multiple=True,
    metavar="GROUND_TRUTH GENERATED",
    help="Two files to compare; repeat it for more pairs.",
)
@option(
    "--skip",
    type=click.IntRange(min=0),
    default=0,
    help="Leave out this many frames at the start of both (60 fps), such as a T-pose.",
)
@option(
    "--given",
    type=click.IntRange(min=0),
    default=0,
    help="Leave out this many frames at the start of GROUND_TRUTH alone (60 fps): the 87 that synthesize --init "
    "continues.",
)
@click.option(
    "--align-start",
    is_flag=True,
    help="Move and turn GENERATED to the place and heading where GROUND_TRUTH starts.",
)
@click.option(
    "--floor",
    type=FINITE,
    help="Height of standing toes in cm; that of GROUND_TRUTH for both by default.",
)
@_threshold("--foot-height", "Height threshold H of the feet for afs, cm.")
@_threshold("--toe-height", "Height threshold H of the toes for afs, cm.")
@_threshold("--skate-height", "A toe below this height is planted, cm.")
@_threshold("--skate-speed", "A planted toe faster than this skates, cm/s.")
@_threshold("--path-tolerance", "A path point is covered within this distance, cm.")
@_positive("--scale", "Centimetres per unit of GROUND_TRUTH; detected by default.")
@_positive("--generated-scale", "Centimetres per unit of GENERATED; detected by default.")
@_positive("--fps", "Frame rate of GROUND_TRUTH, if its header is wrong.")
@_positive("--generated-fps", "Frame rate of GENERATED, if its header is wrong.")
@animation_option
@processes_option
@view_option
@clip_options
@json_option
@click.option("--csv", "as_csv", is_flag=True, help="Print the result as CSV, one row per metric.")
@gathered("settings", MetricSettings)
@gathered("measuring", Measuring)
def command(
    ground_truth: Path | None,
    generated: Path | None,
    given_pairs: tuple[tuple[Path, Path], ...],
    measuring: Measuring,
    jobs: int,
    view: bool,
    as_json: bool,
    as_csv: bool,
) -> None:
    if as_json and as_csv:
        raise click.UsageError("--json and --csv exclude each other")
    if (ground_truth is None) != bool(given_pairs):
        raise click.UsageError("give GROUND_TRUTH, GROUND_TRUTH GENERATED, or --pair")
    if ground_truth and generated and ground_truth.is_dir() != generated.is_dir():
        raise click.UsageError("GROUND_TRUTH and GENERATED must both be files or both be folders")
    measuring.check(bool(given_pairs) or generated is not None)
    if ground_truth is None or ground_truth.is_dir():
        if view:
            raise click.UsageError("--view shows one file or one pair")
        from motionkit.metrics.pairs import find_pairs

        pairs, lonely = find_pairs(ground_truth, generated) if ground_truth else (list(given_pairs), [])
        with Stages() as show:
            results = _measured(pairs, measuring, jobs, show)
            sets = measuring.of_sets(results, show)
        _tell_many(results, sets, lonely, generated or ground_truth, as_json, as_csv)
        return
    from motionkit.metrics.pairs import PairResult, csv_text

    report = measuring.evaluate(ground_truth, generated)
    page = _view(ground_truth, generated, measuring.rates, as_json or as_csv) if view else None
    result = PairResult(ground_truth, generated, report)
    if as_json:
        print_json({**result.as_dict(), **({"view": page} if page else {})})
        return
    if as_csv:
        click.echo(csv_text([result]), nl=False)
    else:
        clips = [ground_truth, *([generated] if generated else [])]
        _print_table(report, generated is not None, input_lines(clips, report.read_as))
    if page:
        (remark if as_csv else say)(f"wrote {page}")


def _measured(
    pairs: Sequence[tuple[Path, Path | None]], measuring: Measuring, jobs: int, show: Stages
) -> list[PairResult]:
    from motionkit.data.workers import worker_processes
    from motionkit.metrics.pairs import evaluate_pairs

    progress, results = show.count("measuring", len(pairs)), []
    with worker_processes(min(jobs or os.cpu_count() or 1, len(pairs))) as each:
        for result in evaluate_pairs(pairs, measuring.evaluate, each):
            results.append(result)
            progress(len(results))
    return results


def _tell_many(
    results: Sequence[PairResult],
    sets: Sequence[MetricRow],
    lonely: Sequence[Path],
    folder: Path | None,
    as_json: bool,
    as_csv: bool,
) -> None:
    """Print all pairs and the set metrics; raises MotionkitError at the end if any pair failed.

    folder is that of the measured files, if they are in one.
    """
    from motionkit.metrics.pairs import csv_text, mean_rows, names_of_pairs, pairs_as_dict

    if as_json:
        print_json(pairs_as_dict(results, sets) | {"without_partner": lonely})
    elif as_csv:
        click.echo(csv_text(results, sets), nl=False)
    else:
        measured = [result for result in results if result.report]
        names, means = names_of_pairs(measured, folder), mean_rows(measured)
        for line in _tables(measured, names, means, sets):
            stdout_console().print(line)
        for line in _remarks(measured, names, means, sets):
            stdout_console().print(f"note: {line}")
    failed = [result for result in results if result.report is None]
    faults = [(str(result.ground_truth), result.error) for result in failed]
    faults += [(str(path), f"{path} has no partner of the same name") for path in lonely]
    for line in lines_of_files(faults):
        remark(f"left out: {line}")
    if failed or lonely:
        raise MotionkitError(
            f"{len(failed)} of {len(results)} not measured, {len(lonely)} files without a partner"
        )


def _remarks(
    measured: Sequence[PairResult],
    names: Sequence[str],
    means: Sequence[MeanRow],
    sets: Sequence[MetricRow],
) -> Iterator[str]:
    """The notes on every pair, then the reason of every value that is missing in the tables."""
    reports = [(r.name, name, r.report) for r, name in zip(measured, names, strict=True) if r.report]
    notes = [
        (name, f"{name}: {note.removeprefix(f'{file}: ')}")
        for file, name, report in reports
        for note in report.notes
    ]
    reasons = [(name, reason) for _, name, report in reports for reason in report.reasons()]
    # Two lists, because each has few lines: reasons among the notes would leave no room for these.
    yield from lines_of_files(notes)
    yield from lines_of_files([(name, f"{name}: {reason}") for name, reason in reasons])
    said = {reason for _, reason in reasons}
    missing: dict[str, list[str]] = {}
    for row in means:
        if row.reason and f"{row.id}: {row.reason}" not in said:
            missing.setdefault(f"no mean, because {row.reason}", []).append(row.id)
    for one in sets:
        for reason in one.reasons():
            missing.setdefault(reason, []).append(one.id)
    yield from (f"{', '.join(ids)}: {reason}" for reason, ids in missing.items())


def _tables(
    measured: Sequence[PairResult],
    names: Sequence[str],
    means: Sequence[MeanRow],
    sets: Sequence[MetricRow],
) -> Iterator[str | Table]:
    """Selected metrics of every pair, by its name, then means of all metrics, then the set metrics."""
    from motionkit.cli.console import make_table

    if not measured:
        return
    paired = measured[0].generated is not None
    ids = _OF_EACH[paired]
    values = [
        (name, [r.report.value(id_) for id_ in ids])
        for name, r in zip(names, measured, strict=True)
        if r.report
    ]
    yield make_table(("file", *ids), [(name, *map(_number, row)) for name, row in values[:LISTED_FILES]])
    if len(values) > LISTED_FILES:
        yield f"... and {len(values) - LISTED_FILES} more files; --json and --csv list all"
    yield ""
    yield f"means of {len(measured)} {'pairs' if paired else 'files'}, weighted equally:"
    columns = [
        "metric",
        *(("ground truth", "generated") if paired else ("mean",)),
        "lowest",
        "highest",
        "unit",
    ]
    rows = []
    for row in means:
        truth = [_number(row.ground_truth)] if paired else []
        rows.append((row.id, *truth, *map(_number, (row.value, row.lowest, row.highest)), row.unit))
    yield make_table(columns, rows, (0, len(columns) - 1))
    if sets:
        yield ""
        yield "all files together, as two sets of windows of a second:"
        both = [
            (one.id, _number(one.ground_truth.value if one.ground_truth else None), _number(one.motion.value))
            for one in sets
        ]
        yield make_table(("metric", "ground truth", "generated"), both)


def _view(
    ground_truth: Path, generated: Path | None, fps: tuple[float | None, float | None], quiet: bool
) -> Path:
    """Write a viewer page of the unchanged files to the current folder."""
    from motionkit.motion.bvh import bvh_to_motion
    from motionkit.rig.read_file import read_file
    from motionkit.view.figure_data import MotionView

    files = [file for file in (ground_truth, generated) if file is not None]
    words = ("ground truth", "generated") if generated is not None else ("",)
    views = [
        MotionView(visible(f"{file.stem} {word}".strip()), bvh_to_motion(read_file(file), fps=rate))
        for file, word, rate in zip(files, words, fps, strict=False)
    ]
    page = default_output("-".join(file.stem for file in files), ".html")
    Outputs((), page, quiet).show(lambda: views)
    return page


def _print_table(report: MetricReport, paired: bool, inputs: Iterable[str]) -> None:
    from motionkit.cli.console import make_table

    columns = ["metric", *(("ground truth", "generated", "ratio") if paired else ("value",)), "unit"]
    rows = []
    for row in report.rows:
        cells = [_number(row.motion.value)]
        if row.ground_truth is not None:
            ratio = "" if row.ratio is None else f"{row.ratio:.2f}"
            cells = [_number(row.ground_truth.value), *cells, ratio]
        rows.append((row.id, *cells, row.motion.unit))
    console = stdout_console()
    console.print(make_table(columns, rows, (0, len(columns) - 1)))
    console.print()
    console.print(f"{report.frames} frames at {report.fps:g} fps")
    for line in inputs:
        console.print(line)
    for note in report.remarks():
        console.print(f"note: {note}")
    for line in report.thresholds():
        console.print(line, style="dim")


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
