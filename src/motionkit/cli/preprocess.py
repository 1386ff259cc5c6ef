"""`motionkit preprocess`: makes a dataset folder from folders of BVH files."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from motionkit.cli.common import (
    EXISTING,
    FOLDER,
    Stages,
    animations_option,
    input_options,
    json_option,
    labels_option,
    lines_of_files,
    option,
    print_json,
    processes_option,
    remark,
    stdout_console,
    switch,
)
from motionkit.cli.finite import FiniteRange
from motionkit.errors import MotionkitError
from motionkit.reading import user_cm

if TYPE_CHECKING:
    from motionkit.data.preprocess import PreprocessReport

LAYOUT_CHOICES = ("sixd-root-1", "expmap-root-1")


@click.command("preprocess")
@click.argument("data", nargs=-1, required=True, type=EXISTING)
@option("-o", "--output", default="datasets/motion", type=FOLDER, help="Dataset folder to write.")
@labels_option(
    "CSV table of segments: file,start_frame,end_frame,type[,subject,fps,split,note]. "
    "By default labels.csv in or just above the data."
)
@click.option(
    "--fps",
    type=FiniteRange(1, 1000),
    help="Frame rate of the files, if their headers are wrong; a label table's column fps comes first.",
)
@click.option("--scale", type=FiniteRange(1e-4, 1e4), help="Centimetres per file unit; detected by default.")
@processes_option
@switch("--mirror/--no-mirror", "Add the mirror image of each clip.")
@click.option(
    "--own-bodies", is_flag=True, help="Keep each performer's bone lengths instead of one body for all."
)
@option(
    "--layout",
    default=LAYOUT_CHOICES[0],
    type=click.Choice(LAYOUT_CHOICES),
    help="Version of the 276 features; the preset tptn-paper needs expmap-root-1.",
)
@animations_option
@input_options
@switch("--smooth/--raw", "Filter out marker jitter (7 Hz low-pass), or keep the recorded rotations.")
@switch(
    "--level/--no-level",
    "Level the floor where the standing feet of a performer's clips show a tilt, up to 4 cm a metre; "
    "--raw leaves it.",
)
@option(
    "--references",
    default="bundled",
    metavar="MODEL|own",
    help="Model file whose reference rotations the features use, so that training can start from it; own uses the "
    "mean rotations of the data.",
)
@click.option(
    "--strict", is_flag=True, help="Stop at the first file that cannot be used; repair no fault of a file."
)
@switch(
    "--validation/--no-validation",
    "Hold out a tenth of the training files for choosing settings, for types with at least four files.",
)
@switch(
    "--test/--no-test",
    "Hold out 15 % of the files of each type for testing, at least one; of a single file, its mirror image.",
)
@json_option
def command(
    data: tuple[Path, ...],
    output: Path,
    references: str,
    validation: bool,
    test: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Turn clips (.bvh, .amc, .npz, .glb, .vrm, .fbx) and folders of them (DATA) into a dataset for training.

    Every skeleton is mapped onto 23 joints, scaled to cm, resampled to 60 fps, cleaned, and written as
    276 features per frame, with mirror images and a split into training, validation and test clips. Links to
    folders are followed.
    Unusable files are skipped and listed; the dataset then holds the others and the exit code is 1.
    """
    if options["scale"] and user_cm():
        raise click.UsageError("--unit and --scale both give the unit of the files; give one of them")
    given = click.get_current_context().get_parameter_source("references")
    if options["layout"] == "expmap-root-1" and given is not ParameterSource.DEFAULT:
        raise click.UsageError(
            "--references is for the other layout; that of the paper is relative to the identity"
        )
    from motionkit.api import preprocess
    from motionkit.data.options import PreprocessOptions

    held_out = tuple(name for name, held in (("validation", validation), ("test", test)) if held)
    with Stages() as show:
        chosen = PreprocessOptions(**options, held_out=held_out)
        report = preprocess(data, output, chosen, show, references=references)
    for note in report.notes:
        remark(note)
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
        "dataset": report.folder,
        "labels": report.labels,
        "clips": report.clips,
        "seconds": round(report.seconds, 3),
        "types": report.types,
        "files": [asdict(file) for file in report.files],
        "notes": report.notes,
    }


def _print(report: PreprocessReport) -> None:
    from motionkit.cli.console import make_table

    columns = ("type", "clips", "mirrored", "train min", "val. min", "test clips", "test min")
    rows = [
        (
            kind,
            f"{row['clips']:.0f}",
            f"{row['mirrored']:.0f}",
            f"{row['train_seconds'] / 60:.2f}",
            f"{row['validation_seconds'] / 60:.2f}",
            f"{row['test_clips']:.0f}",
            f"{row['test_seconds'] / 60:.2f}",
        )
        for kind, row in report.types.items()
    ]
    out = stdout_console()
    out.print(
        make_table(columns, rows, title=f"{report.folder}: {report.seconds / 60:.1f} minutes at 60 fps")
    )
    for line in _lines(report):
        out.print(line)
    for line in lines_of_files([(file.name, file.skipped) for file in report.files if file.skipped]):
        remark(f"skipped {line}")


def _lines(report: PreprocessReport) -> Iterator[str]:
    """What was mapped and cleaned, counted over all files."""
    yield f"types from {report.labels}" if report.labels else "types from folder and file names"
    used = [file for file in report.files if not file.skipped]
    units = Counter(file.mapping["scale_source"] for file in used)
    yield "units: " + "; ".join(f"{name} ({count})" for name, count in units.most_common())
    missing = Counter(joint for file in used for joint in file.mapping["missing"])
    if missing:
        listed = ", ".join(f"{name} ({count})" for name, count in missing.most_common())
        yield f"joints missing in the files, kept fixed: {listed}"
    lead_ins = [file.cleaning["lead_in"] for file in used if file.cleaning["lead_in"]]
    pops = sum(len(file.cleaning["pops"]) for file in used)
    moved = [file for file in used if abs(file.cleaning["floor_shift"]) >= 0.5]
    slopes = [math.hypot(*file.cleaning["tilt"]) for file in used if any(file.cleaning["tilt"])]
    steepest = f" (by up to {100.0 * max(slopes):.1f} cm a metre)" if slopes else ""
    yield (
        f"cleaned: {len(lead_ins)} lead-ins ({sum(lead_ins)} frames) cut, {pops} pops repaired, "
        f"{sum(file.leaps for file in used)} leaps cut out, floor moved in {len(moved)} files, "
        f"levelled in {len(slopes)}{steepest}"
    )
    yield from lines_of_files([(file.name, note) for file in used for note in file.notes])
    yield f"files: {len(used)} used, {len(report.files) - len(used)} skipped"
