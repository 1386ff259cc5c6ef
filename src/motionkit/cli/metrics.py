"""`motionkit metrics`: measures of a BVH file, alone or against its ground truth."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.common import (
    default_output,
    json_option,
    print_json,
    progress_bar,
    remark,
    say,
    stdout_console,
)
from motionkit.cli.finite import FINITE, FiniteRange
from motionkit.cli.showing import view_option, write_and_open
from motionkit.errors import MotionkitError
from motionkit.metrics.value import MetricSettings
from motionkit.names import visible

if TYPE_CHECKING:
    from motionkit.metrics.pairs import Pair, PairResult
    from motionkit.metrics.report import MetricReport, MetricRow
    from motionkit.metrics.value import MetricValue

_FILE: Any = click.Path(exists=True, dir_okay=False, path_type=Path)
_PLACE: Any = click.Path(exists=True, path_type=Path)
CSV_COLUMNS = (
    "ground_truth", "generated", "frames", "metric", "unit", "value", "ground_truth_value", "ratio", "reason",
)  # fmt: skip
# Columns of the table of many pairs; the table of means, --csv and --json hold all metrics.
_OF_EACH = {
    True: ("afs", "jerk", "ssim-window", "mpjpe", "path-mean"),
    False: ("bm-geodesic", "afs", "skate-ratio", "jerk", "penetration-mean"),
}


def _positive(flag: str, text: str, default: float | None = None) -> Any:
    return click.option(
        flag,
        type=FiniteRange(min=0, min_open=True),
        default=default,
        show_default=default is not None,
        help=text,
    )


@click.command(
    "metrics",
    help="""Measure GROUND_TRUTH, alone or with GENERATED.

    Each file is measured by body movement (bm), average foot sliding (afs), foot skate, jerk, penetration, leaps of
    knees and elbows, planted and hovering feet, and flights; a pair also by SSIM, MPJPE, trajectory distance
    (path), L2P, L2Q and NPSS. docs/metrics.md defines every id. Other rigs are mapped onto the 23 joints, other rates
    are resampled to 60 fps, and clips of different length are compared over their common frames; notes under the
    table say what was changed.

    Both may be folders: files of the same name are pairs, and files without a partner are listed. One folder
    alone is measured file by file. --pair pairs files of different names. For many pairs the table shows each
    pair, the means, and Frechet distance and diversity of all files together; the exit code is 1 if any file was
    left out.
    """,
)
@click.argument("ground_truth", type=_PLACE, required=False)
@click.argument("generated", type=_PLACE, required=False)
@click.option(
    "--pair",
    "given_pairs",
    type=(_FILE, _FILE),
    multiple=True,
    metavar="GROUND_TRUTH GENERATED",
    help="Two files to compare; repeat it for more pairs.",
)
@click.option(
    "--skip",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Leave out this many frames at the start of both (60 fps), such as a T-pose.",
)
@click.option(
    "--given",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
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
@_positive("--foot-height", "Height threshold H of the feet for afs, cm.", MetricSettings.foot_height)
@_positive("--toe-height", "Height threshold H of the toes for afs, cm.", MetricSettings.toe_height)
@_positive("--skate-height", "A toe below this height stands on the floor, cm.", MetricSettings.skate_height)
@_positive("--skate-speed", "A standing toe faster than this skates, cm/s.", MetricSettings.skate_speed)
@_positive(
    "--path-tolerance", "A path point is covered within this distance, cm.", MetricSettings.path_tolerance
)
@_positive("--scale", "Centimetres per unit of GROUND_TRUTH; detected by default.")
@_positive("--generated-scale", "Centimetres per unit of GENERATED; detected by default.")
@_positive("--fps", "Frame rate of GROUND_TRUTH, if its header is wrong.")
@_positive("--generated-fps", "Frame rate of GENERATED, if its header is wrong.")
@view_option
@json_option
@click.option("--csv", "as_csv", is_flag=True, help="Print the result as CSV, one row per metric.")
def command(
    ground_truth: Path | None,
    generated: Path | None,
    given_pairs: tuple[tuple[Path, Path], ...],
    skip: int,
    given: int,
    align_start: bool,
    scale: float | None,
    generated_scale: float | None,
    fps: float | None,
    generated_fps: float | None,
    view: bool,
    as_json: bool,
    as_csv: bool,
    floor: float | None,
    **thresholds: float,
) -> None:
    if as_json and as_csv:
        raise click.UsageError("--json and --csv exclude each other")
    if (ground_truth is None) != bool(given_pairs):
        raise click.UsageError("give GROUND_TRUTH, GROUND_TRUTH GENERATED, or --pair")
    if ground_truth and generated and ground_truth.is_dir() != generated.is_dir():
        raise click.UsageError("GROUND_TRUTH and GENERATED must both be files or both be folders")
    many = bool(given_pairs) or (ground_truth is not None and ground_truth.is_dir())
    if view and many:
        raise click.UsageError("--view shows one file or one pair")
    paired = bool(given_pairs) or generated is not None
    for name, set_to in (
        ("--given", given),
        ("--align-start", align_start),
        ("--generated-scale", generated_scale),
        ("--generated-fps", generated_fps),
    ):
        if set_to and not paired:
            raise click.UsageError(f"{name} needs a second file, GENERATED")

    from motionkit.metrics.pairs import PairResult, find_pairs
    from motionkit.metrics.report import evaluate_files
    from motionkit.metrics.sets import set_metrics_of_files

    settings = replace(MetricSettings(floor=floor), **thresholds)  # type: ignore[arg-type]
    scales, rates = (scale, generated_scale), (fps, generated_fps)

    def evaluate(truth: Path, made: Path | None) -> MetricReport:
        return evaluate_files(truth, made, settings, skip, align_start, scales, rates, given)

    def of_sets(measured: Sequence[PairResult]) -> tuple[MetricRow, ...]:
        files = [(r.ground_truth, r.generated) for r in measured if r.report and r.generated]
        return set_metrics_of_files(files, scales, rates, skip, given) if files else ()

    if ground_truth is None or many:
        pairs, lonely = (
            (list(given_pairs), []) if ground_truth is None else find_pairs(ground_truth, generated)
        )
        _measure_many(pairs, lonely, evaluate, of_sets, as_json, as_csv)
        return
    report = evaluate(ground_truth, generated)
    page = _view(ground_truth, generated, rates, as_json or as_csv) if view else None
    result = PairResult(ground_truth, generated, report)
    if as_json:
        print_json({**result.as_dict(), **({"view": str(page)} if page else {})})
        return
    if as_csv:
        _print_csv([result])
    else:
        _print_table(report, paired)
    if page:
        (remark if as_csv else say)(f"wrote {page}")


def _measure_many(
    pairs: Sequence[Pair],
    lonely: Sequence[Path],
    evaluate: Callable[[Path, Path | None], MetricReport],
    of_sets: Callable[[Sequence[PairResult]], tuple[MetricRow, ...]],
    as_json: bool,
    as_csv: bool,
) -> None:
    """Measure and print all pairs, alone and as sets; raises MotionkitError at the end if any failed."""
    from motionkit.metrics.pairs import evaluate_pairs, mean_rows

    with progress_bar() as bar:
        found = bar.track(evaluate_pairs(pairs, evaluate), total=len(pairs), description="measuring")
        results = list(found)
    failed = [result for result in results if result.report is None]
    sets = of_sets(results)
    if as_json:
        means = {row.id: {k: v for k, v in asdict(row).items() if k != "id"} for row in mean_rows(results)}
        left = [str(path) for path in lonely]
        print_json(
            {
                "pairs": [result.as_dict() for result in results],
                "mean": means,
                "sets": [row.as_dict() for row in sets],
                "without_partner": left,
            }
        )
    elif as_csv:
        _print_csv(results, sets)
    else:
        _print_tables(results, sets)
    for result in failed:
        remark(f"left out: {result.error}")
    for path in lonely:
        remark(f"left out: {path} has no partner of the same name")
    if failed or lonely:
        raise MotionkitError(
            f"{len(failed)} of {len(pairs)} not measured, {len(lonely)} files without a partner"
        )


def _print_csv(results: Sequence[PairResult], sets: Sequence[MetricRow] = ()) -> None:
    """Print one row per metric and pair, for spreadsheets and data frames; those of sets name no files."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for result in results:
        if result.report is None:
            continue
        names = visible(result.ground_truth), "" if result.generated is None else visible(result.generated)
        for row in result.report.rows:
            writer.writerow([*names, result.report.frames, *_csv_values(row)])
    for row in sets:
        writer.writerow(["", "", "", *_csv_values(row)])
    click.echo(text.getvalue(), nl=False)


def _csv_values(row: MetricRow) -> tuple:
    truth = None if row.ground_truth is None else row.ground_truth.value
    return row.id, row.motion.unit, row.motion.value, truth, row.ratio, row.motion.reason


def _print_tables(results: Sequence[PairResult], sets: Sequence[MetricRow]) -> None:
    """Print some metrics of every pair, then the means of all metrics, then the metrics of both sets."""
    from rich.table import Table

    from motionkit.metrics.pairs import mean_rows

    measured = [result for result in results if result.report is not None]
    if not measured:
        return
    paired = measured[0].generated is not None
    each = Table(box=None, header_style="bold", pad_edge=False)
    each.add_column("file", overflow="fold")
    for name in _OF_EACH[paired]:
        each.add_column(name, justify="right", overflow="fold")
    for result in measured:
        assert result.report is not None
        each.add_row(result.name, *(_number(result.report.value(name)) for name in _OF_EACH[paired]))
    means = Table(box=None, header_style="bold", pad_edge=False)
    means.add_column("metric", overflow="fold")
    for heading in (*(("ground truth", "generated") if paired else ("mean",)), "lowest", "highest"):
        means.add_column(heading, justify="right", overflow="fold")
    means.add_column("unit", overflow="fold")
    for row in mean_rows(measured):
        truth = [_number(row.ground_truth)] if paired else []
        means.add_row(row.id, *truth, *map(_number, (row.value, row.lowest, row.highest)), row.unit)
    console = stdout_console()
    console.print(each)
    console.print()
    console.print(f"means of {len(measured)} {'pairs' if paired else 'files'}, weighted equally:")
    console.print(means)
    if not sets:
        return
    both = Table(box=None, header_style="bold", pad_edge=False)
    for heading in ("metric", "ground truth", "generated"):
        both.add_column(heading, justify="left" if heading == "metric" else "right")
    for of_set in sets:
        recorded = None if of_set.ground_truth is None else of_set.ground_truth.value
        both.add_row(of_set.id, _number(recorded), _number(of_set.motion.value))
    console.print()
    console.print("all files together, as two sets of windows of a second:")
    console.print(both)


def _view(
    ground_truth: Path, generated: Path | None, fps: tuple[float | None, float | None], quiet: bool
) -> Path:
    """Write a viewer page of the unchanged files to the current folder."""
    from motionkit.motion.bvh import bvh_to_motion, read_bvh
    from motionkit.view.figure_data import Shown

    files = [file for file in (ground_truth, generated) if file is not None]
    words = ("ground truth", "generated") if generated is not None else ("",)
    shown = [
        Shown(visible(f"{file.stem} {word}".strip()), bvh_to_motion(read_bvh(file), fps=rate))
        for file, word, rate in zip(files, words, fps, strict=False)
    ]
    return write_and_open(default_output("-".join(file.stem for file in files), ".html"), shown, quiet)


def _print_table(report: MetricReport, paired: bool) -> None:
    from rich.table import Table

    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("metric")
    for heading in ("ground truth", "generated", "ratio") if paired else ("value",):
        table.add_column(heading, justify="right")
    table.add_column("unit")
    for row in report.rows:
        cells = [_number(row.motion.value)]
        if row.ground_truth is not None:
            ratio = "" if row.ratio is None else f"{row.ratio:.2f}"
            cells = [_number(row.ground_truth.value), *cells, ratio]
        table.add_row(row.id, *cells, row.motion.unit)
    console = stdout_console()
    console.print(table)
    console.print()
    console.print(f"{report.frames} frames at {report.fps:g} fps")
    for note in _remarks(report):
        console.print(f"note: {note}")
    for line in _thresholds(report):
        console.print(line, style="dim")


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _remarks(report: MetricReport) -> list[str]:
    notes = list(report.notes)
    for row in report.rows:
        values: list[MetricValue] = [value for value in (row.motion, row.ground_truth) if value is not None]
        notes += [f"{value.id}: {value.reason}" for value in values if value.reason]
    return list(dict.fromkeys(notes))


def _thresholds(report: MetricReport) -> list[str]:
    """One line per metric with thresholds; the floor of each clip has its own row instead."""
    lines = []
    for row in report.rows:
        words = [
            f"{key} {value:g}" if isinstance(value, float) else f"{key} {value}"
            for key, value in row.motion.parameters.items()
            if key != "floor_cm"
        ]
        if words:
            lines.append(f"{row.id}: {', '.join(words)}")
    return lines
