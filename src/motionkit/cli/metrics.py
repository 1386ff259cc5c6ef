"""`motionkit metrics`: measure a BVH file, alone or beside its ground truth."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.common import default_output, json_option, print_json, stdout_console
from motionkit.cli.showing import view_option, write_and_open
from motionkit.metrics.value import MetricSettings

if TYPE_CHECKING:
    from motionkit.metrics.report import MetricReport
    from motionkit.metrics.value import MetricValue

_FILE = click.Path(exists=True, dir_okay=False)


def _finite(ctx: click.Context, parameter: click.Parameter, value: float | None) -> float | None:
    if value is not None and not math.isfinite(value):
        raise click.BadParameter(f"{value} is not a finite number")
    return value


def _positive(flag: str, text: str, default: float | None = None) -> Any:
    return click.option(
        flag,
        type=click.FloatRange(min=0, min_open=True),
        default=default,
        show_default=default is not None,
        callback=_finite,
        help=text,
    )


@click.command(
    "metrics",
    help="""Measure GROUND_TRUTH, or GENERATED beside it.

    Body movement (bm), average foot sliding (afs), foot skate, jerk and penetration for each file; SSIM,
    MPJPE and trajectory distance (path) for the pair. docs/metrics.md defines every id. Other rigs are
    mapped onto the 23 canonical joints, other rates brought to 60 fps, and different lengths compared
    over the frames both have; the notes under the table say what was done.
    """,
)
@click.argument("ground_truth", type=_FILE)
@click.argument("generated", type=_FILE, required=False)
@click.option(
    "--skip",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Frames at 60 fps to leave out at the start, such as those a synthesis was given.",
)
@click.option("--align-start", is_flag=True, help="Turn and move GENERATED to start as GROUND_TRUTH does.")
@click.option(
    "--floor", type=float, callback=_finite, help="Height of the floor in cm; each clip's own if not given."
)
@_positive("--foot-height", "H of the feet in afs, cm.", MetricSettings.foot_height)
@_positive("--toe-height", "H of the toes in afs, cm.", MetricSettings.toe_height)
@_positive("--skate-height", "Height under which a toe stands, cm.", MetricSettings.skate_height)
@_positive("--skate-speed", "Speed over which a standing toe skates, cm/s.", MetricSettings.skate_speed)
@_positive(
    "--path-tolerance", "Distance within which a path counts as covered, cm.", MetricSettings.path_tolerance
)
@_positive("--scale", "Centimetres per unit of GROUND_TRUTH.")
@_positive("--generated-scale", "Centimetres per unit of GENERATED.")
@_positive("--fps", "Rate of GROUND_TRUTH, where its header is wrong.")
@_positive("--generated-fps", "Rate of GENERATED, where its header is wrong.")
@view_option
@json_option
def command(
    ground_truth: str,
    generated: str | None,
    skip: int,
    align_start: bool,
    scale: float | None,
    generated_scale: float | None,
    fps: float | None,
    generated_fps: float | None,
    view: bool,
    as_json: bool,
    floor: float | None,
    **thresholds: float,
) -> None:
    for name, given in (
        ("--align-start", align_start),
        ("--generated-scale", generated_scale),
        ("--generated-fps", generated_fps),
    ):
        if given and generated is None:
            raise click.UsageError(f"{name} needs a second file, GENERATED")

    from motionkit.metrics.report import evaluate_files

    settings = replace(MetricSettings(floor=floor), **thresholds)  # type: ignore[arg-type]
    report = evaluate_files(
        ground_truth, generated, settings, skip, align_start, (scale, generated_scale), (fps, generated_fps)
    )
    page = _view(ground_truth, generated, (fps, generated_fps), as_json) if view else None
    if as_json:
        files = {"ground_truth": ground_truth, "generated": generated}
        print_json({**files, **report.as_dict(), **({"view": str(page)} if page else {})})
        return
    _print_table(report, paired=generated is not None)
    if page:
        stdout_console().print(f"wrote {page}")


def _view(
    ground_truth: str, generated: str | None, fps: tuple[float | None, float | None], quiet: bool
) -> Path:
    """Write a page of the files as they are to the current folder."""
    from motionkit.apps.figure_data import Shown
    from motionkit.motion.bvh import bvh_to_motion, read_bvh

    files = [Path(file) for file in (ground_truth, generated) if file is not None]
    words = ("ground truth", "generated") if generated is not None else ("",)
    shown = [
        Shown(f"{file.stem} {word}".strip(), bvh_to_motion(read_bvh(file), fps=rate))
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
    """One line for each metric with thresholds; each clip's floor has a row of its own."""
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
