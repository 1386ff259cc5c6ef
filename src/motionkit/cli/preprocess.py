"""`motionkit preprocess`: folders of BVH files to a dataset folder."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from motionkit.cli.common import (
    json_option,
    print_json,
    progress_bar,
    stages_on,
    stderr_console,
    stdout_console,
)
from motionkit.cli.finite import FiniteRange
from motionkit.errors import MotionkitError

if TYPE_CHECKING:
    from motionkit.data.preprocess import PreprocessReport

LAYOUT_CHOICES = ("sixd-root-1", "expmap-root-1")
SHOWN_SKIPS = 20


@click.command("preprocess")
@click.argument("data", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
@click.option(
    "-o",
    "--output",
    default="datasets/motion",
    show_default=True,
    type=click.Path(file_okay=False, path_type=Path),
    help="Dataset folder to write.",
)
@click.option(
    "--labels",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="CSV table of segments: file,start_frame,end_frame,type[,subject,fps,split,note]. "
    "By default labels.csv in or just above the data.",
)
@click.option("--fps", type=FiniteRange(1, 1000), help="Frame rate of the files, if their headers are wrong.")
@click.option("--scale", type=FiniteRange(1e-4, 1e4), help="Centimetres per file unit; detected by default.")
@click.option(
    "--jobs",
    default=0,
    type=click.IntRange(0, 256),
    help="Number of processes; 0 chooses it by cores and files.",
)
@click.option(
    "--mirror/--no-mirror", default=True, show_default=True, help="Add the mirror image of each clip."
)
@click.option(
    "--own-bodies", is_flag=True, help="Keep each performer's bone lengths instead of one body for all."
)
@click.option(
    "--layout",
    default=LAYOUT_CHOICES[0],
    show_default=True,
    type=click.Choice(LAYOUT_CHOICES),
    help="Version of the 276 features; the preset tptn-paper needs expmap-root-1.",
)
@click.option(
    "--smooth/--raw",
    "smooth",
    default=True,
    show_default=True,
    help="Filter out marker jitter (7 Hz low-pass), or keep the recorded rotations.",
)
@click.option(
    "--level/--no-level",
    default=True,
    show_default=True,
    help="Take out the tilt of the floor that the standing feet of a performer's clips show, up to 4 cm a metre; "
    "--raw leaves it.",
)
@click.option(
    "--references",
    default="bundled",
    show_default=True,
    metavar="MODEL|own",
    help="Model file whose reference rotations the features are relative to, so that training can begin from it; "
    "own takes the mean rotations of the data.",
)
@click.option("--strict", is_flag=True, help="Stop at the first file that cannot be used.")
@click.option(
    "--validation/--no-validation",
    default=True,
    show_default=True,
    help="Hold out a tenth of the training files, of types with at least four, to choose settings by.",
)
@click.option(
    "--test/--no-test",
    default=True,
    show_default=True,
    help="Hold out about a sixth of the clips of each type to evaluate on, or its mirror image if it has one clip.",
)
@json_option
def command(
    data: tuple[Path, ...],
    output: Path,
    labels: Path | None,
    fps: float | None,
    scale: float | None,
    jobs: int,
    mirror: bool,
    own_bodies: bool,
    layout: str,
    smooth: bool,
    level: bool,
    references: str,
    strict: bool,
    validation: bool,
    test: bool,
    as_json: bool,
) -> None:
    """Turn BVH files and folders of them (DATA) into a dataset for training.

    Every skeleton is mapped onto 23 joints, scaled to cm, resampled to 60 fps, cleaned, and written as
    276 features per frame, with mirror images and a split into training, validation and test clips. Links to
    folders are followed.
    Unusable files are skipped and listed; the dataset then holds the others and the exit code is 1.
    """
    from motionkit.data.options import PreprocessOptions
    from motionkit.data.preprocess import preprocess
    from motionkit.models.bundled import reference_rotations

    rotations = reference_rotations(references, layout)
    options = PreprocessOptions(
        labels,
        fps,
        scale,
        mirror,
        own_bodies,
        layout,
        jobs,
        strict,
        smooth,
        level=level,
        reference_rotations=rotations,
        held_out=tuple(name for name, asked in (("validation", validation), ("test", test)) if asked),
    )
    with progress_bar() as bar:
        report = preprocess(data, output, options, stages_on(bar))
    for note in report.notes:
        stderr_console().print(note, markup=False)
    if as_json:
        print_json(_as_dict(report))
    else:
        _print(report)
    faults = sum(file.fault for file in report.files)
    if faults:
        raise MotionkitError(
            f"{faults} of {len(report.files)} files are unusable; the dataset holds the others"
        )


def _as_dict(report: PreprocessReport) -> dict:
    from dataclasses import asdict

    return {
        "dataset": str(report.folder),
        "labels": None if report.labels is None else str(report.labels),
        "clips": report.clips,
        "seconds": round(report.seconds, 3),
        "types": report.types,
        "files": [asdict(file) for file in report.files],
    }


def _print(report: PreprocessReport) -> None:
    from rich.table import Table

    table = Table(title=f"{report.folder}: {report.seconds / 60:.1f} minutes at 60 fps")
    for name in (
        "type",
        "clips",
        "mirrored",
        "train min",
        "val. min",
        "test clips",
        "test min",
    ):
        table.add_column(name, justify="left" if name == "type" else "right")
    for kind, row in report.types.items():
        table.add_row(
            kind,
            f"{row['clips']:.0f}",
            f"{row['mirrored']:.0f}",
            f"{row['train_seconds'] / 60:.2f}",
            f"{row['validation_seconds'] / 60:.2f}",
            f"{row['test_clips']:.0f}",
            f"{row['test_seconds'] / 60:.2f}",
        )
    out = stdout_console()
    out.print(table)
    out.print(f"types from {report.labels}" if report.labels else "types from folder and file names")
    _print_work(report)
    skipped = [file for file in report.files if file.skipped]
    used = len(report.files) - len(skipped)
    out.print(f"files: {used} used, {len(skipped)} skipped")
    remarks = stderr_console()
    for file in skipped[:SHOWN_SKIPS]:
        reason = file.skipped
        remarks.print(f"skipped {reason if file.name in reason else f'{file.name}: {reason}'}")
    if len(skipped) > SHOWN_SKIPS:
        remarks.print(f"... and {len(skipped) - SHOWN_SKIPS} more; --json lists all")


def _print_work(report: PreprocessReport) -> None:
    """Print what was mapped and cleaned, counted over the files."""
    from collections import Counter

    used = [file for file in report.files if not file.skipped]
    units = Counter(file.mapping["scale_source"] for file in used)
    missing = Counter(joint for file in used for joint in file.mapping["missing"])
    lead_ins = [file.cleaning["lead_in"] for file in used if file.cleaning["lead_in"]]
    pops = sum(len(file.cleaning["pops"]) for file in used)
    moved = [file for file in used if abs(file.cleaning["floor_shift"]) >= 0.5]
    slopes = [math.hypot(*file.cleaning["tilt"]) for file in used if any(file.cleaning["tilt"])]
    steepest = f" (by up to {100.0 * max(slopes):.1f} cm a metre)" if slopes else ""
    out = stdout_console()
    out.print("units: " + "; ".join(f"{name} ({count})" for name, count in units.most_common()))
    if missing:
        listed = ", ".join(f"{name} ({count})" for name, count in missing.most_common())
        out.print(f"joints missing in the files, kept fixed: {listed}")
    out.print(
        f"cleaned: {len(lead_ins)} lead-ins ({sum(lead_ins)} frames) cut, {pops} pops repaired, "
        f"{sum(file.leaps for file in used)} leaps cut out, floor moved in {len(moved)} files, "
        f"levelled in {len(slopes)}{steepest}"
    )
