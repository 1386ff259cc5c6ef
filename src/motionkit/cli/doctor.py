"""`motionkit doctor`: looks at a folder of clips before training."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from motionkit.cli.common import json_option, print_json, progress_bar, stdout_console
from motionkit.errors import MotionkitError
from motionkit.names import counted

if TYPE_CHECKING:
    from motionkit.cli.console import PlainConsole
    from motionkit.data.diagnosis import ClipFacts, Diagnosis

SHOWN_CLIPS, SHOWN_SKIPS = 60, 8
NO_LIMIT = 1000  # columns where nothing is shown to people, such as in a pipe


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
    type do, types whose clips fall into two groups, clips that move like another type, types that cannot be learnt.
    Files that a label table does not list are skipped, as by preprocess. The exit code is 1 if a file cannot be used.
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
    if not found.clips:
        raise MotionkitError(f"{found.labels}: lists none of the {len(found.skipped)} files")
    if faults:
        raise MotionkitError(f"{len(faults)} of {len(found.clips)} files cannot be used")


def _print(found: Diagnosis) -> None:
    from rich.table import Table

    from motionkit.data.labels import BEYOND_END

    out = stdout_console()
    if not out.is_terminal:
        out.width = NO_LIMIT
    if found.types:
        _print_clips([clip for clip in found.clips[:SHOWN_CLIPS] if not clip.fault], out)
    if len(found.clips) > SHOWN_CLIPS:
        out.print(f"... and {len(found.clips) - SHOWN_CLIPS} more files; --json lists all")
    types = Table(box=None, header_style="bold", pad_edge=False)
    for name in ("type", "clips", "minutes", "m/s", "time in jumps"):
        types.add_column(name, justify="left" if name == "type" else "right")
    for kind in found.types:
        row = (kind.clips, f"{kind.seconds / 60:.2f}", f"{kind.speed / 100:.2f}", f"{kind.in_the_air:.0%}")
        types.add_row(kind.name, *map(str, row))
    if found.types:
        out.print()
        out.print(types)
        out.print()
    out.print(f"types from {found.labels}" if found.labels else "types from folder and file names")
    notes: dict[str, int] = {}
    for clip in found.clips:
        for note in (each for each in clip.notes if not each.startswith(BEYOND_END)):  # a warning, below
            notes[note] = notes.get(note, 0) + 1
    for note, count in sorted(notes.items(), key=lambda item: -item[1])[:8]:
        out.print(f"note: {note} ({counted(count, 'clip')})")
    for clip in found.clips:
        if clip.fault:
            out.print(
                f"cannot be used: {clip.fault if clip.name in clip.fault else f'{clip.name}: {clip.fault}'}"
            )
    for line in found.skipped[:SHOWN_SKIPS]:
        out.print(f"skipped {line}")
    if len(found.skipped) > SHOWN_SKIPS:
        out.print(f"skipped {len(found.skipped) - SHOWN_SKIPS} more; --json lists all")
    for line in found.lines:
        out.print(line)
    warned = any(line.startswith("warning: ") for line in found.lines)
    if found.types and not warned and not any(clip.fault for clip in found.clips):
        out.print("nothing looks wrong")


def _print_clips(clips: list[ClipFacts], out: PlainConsole) -> None:
    """Print a row for each clip, and below what rigs there are."""
    from rich.table import Table

    rigs = list(dict.fromkeys(map(_rig, clips)))
    table = Table(box=None, header_style="bold", pad_edge=False)
    columns = ("clip", "type", "s", "fps", *(("rig",) if len(rigs) > 1 else ()), "floor cm", "glitches")
    for name in columns:
        table.add_column(name, justify="left" if name in ("clip", "type") else "right", overflow="fold")
    for clip in clips:
        number = (str(rigs.index(_rig(clip)) + 1),) if len(rigs) > 1 else ()
        measured = (f"{clip.seconds:.1f}", f"{clip.fps:g}", *number, f"{clip.floor:+.1f}", str(clip.glitches))
        table.add_row(clip.name, ", ".join(clip.types), *measured)
    out.print(table)
    for place, rig in enumerate(rigs, 1):
        out.print(f"rig {place}: {rig}" if len(rigs) > 1 else f"rig of all clips: {rig}")


def _rig(clip: ClipFacts) -> str:
    return f"{clip.rig}; {clip.unit.replace('detected from leg length: ', '')}; {clip.up} up"
