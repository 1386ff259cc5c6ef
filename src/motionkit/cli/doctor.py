"""`motionkit doctor`: looks at a folder of clips before training."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from motionkit.cli.common import json_option, print_json, progress_bar, stdout_console
from motionkit.errors import MotionkitError

if TYPE_CHECKING:
    from motionkit.data.diagnosis import ClipFacts, Diagnosis

SHOWN_CLIPS = 60


@click.command("doctor")
@click.argument("data", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
@click.option(
    "--labels",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="CSV table of segments, as for preprocess; by default labels.csv in or just above the data.",
)
@json_option
def command(data: tuple[Path, ...], labels: Path | None, as_json: bool) -> None:
    """Look at BVH files and folders of them (DATA) before training.

    Prints for each clip its rig, unit, frame rate, up axis, floor, glitches and motion type, and for each type
    how much there is to learn from and what looks wrong: clips that never leave the ground where most of their
    type do, types whose clips fall into two groups, clips that move like another type. The exit code is 1 if a
    file cannot be used.
    """
    from motionkit.data.diagnosis import diagnose

    with progress_bar() as bar:
        task = bar.add_task("looking", total=None)
        found = diagnose(data, labels, lambda done, total: bar.update(task, completed=done, total=total))
    if as_json:
        from dataclasses import asdict

        print_json(asdict(found) | {"labels": None if found.labels is None else str(found.labels)})
    else:
        _print(found)
    faults = [clip for clip in found.clips if clip.fault]
    if faults:
        raise MotionkitError(f"{len(faults)} of {len(found.clips)} files cannot be used")


def _print(found: Diagnosis) -> None:
    from rich.table import Table

    out = stdout_console()
    table = Table(box=None, header_style="bold", pad_edge=False)
    for name in ("clip", "type", "s", "fps", "rig", "unit", "up", "floor cm", "glitches"):
        table.add_column(name, justify="right" if name in ("s", "fps", "floor cm", "glitches") else "left")
    for clip in found.clips[:SHOWN_CLIPS]:
        if not clip.fault:
            table.add_row(*_cells(clip))
    if found.types:
        out.print(table)
    if len(found.clips) > SHOWN_CLIPS:
        out.print(f"... and {len(found.clips) - SHOWN_CLIPS} more files; --json lists all")
    types = Table(box=None, header_style="bold", pad_edge=False)
    for name in ("type", "clips", "minutes", "m/s", "leave the ground"):
        types.add_column(name, justify="left" if name == "type" else "right")
    for kind in found.types:
        row = (kind.clips, f"{kind.seconds / 60:.2f}", f"{kind.speed / 100:.2f}", f"{kind.flights:.0%}")
        types.add_row(kind.name, *map(str, row))
    if found.types:
        out.print()
        out.print(types)
        out.print()
    out.print(f"types from {found.labels}" if found.labels else "types from folder and file names")
    notes: dict[str, int] = {}
    for clip in found.clips:
        for note in clip.notes:
            notes[note] = notes.get(note, 0) + 1
    for note, count in sorted(notes.items(), key=lambda item: -item[1])[:8]:
        out.print(f"note: {note} ({count} {'clip' if count == 1 else 'clips'})")
    for clip in found.clips:
        if clip.fault:
            out.print(
                f"cannot be used: {clip.fault if clip.name in clip.fault else f'{clip.name}: {clip.fault}'}"
            )
    warnings = [*found.warnings, *(f"{kind.name}: {line}" for kind in found.types for line in kind.warnings)]
    for line in warnings:
        out.print(f"warning: {line}")
    if not warnings and not any(clip.fault for clip in found.clips):
        out.print("nothing looks wrong")


def _cells(clip: ClipFacts) -> tuple[str, ...]:
    return (
        clip.name,
        ", ".join(clip.types),
        f"{clip.seconds:.1f}",
        f"{clip.fps:g}",
        clip.rig,
        clip.unit.replace("detected from leg length: ", ""),
        clip.up,
        f"{clip.floor:+.1f}",
        str(clip.glitches),
    )
