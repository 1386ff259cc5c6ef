"""`motionkit doctor`: checks a folder of clips before training."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from motionkit.cli.common import (
    EXISTING,
    Stages,
    animations_option,
    clip_options,
    json_option,
    labels_option,
    print_json,
    stdout_console,
)
from motionkit.errors import MotionkitError
from motionkit.names import about, counted

if TYPE_CHECKING:
    from motionkit.cli.console import PlainConsole
    from motionkit.data.diagnosis import ClipFacts, Diagnosis

SHOWN_CLIPS, SHOWN_SKIPS, SHOWN_NOTES = 60, 8, 8  # lines of each kind; --json lists all
NO_LIMIT = 1000  # columns, if the output is not a terminal


@click.command("doctor")
@click.argument("data", nargs=-1, required=True, type=EXISTING)
@animations_option
@labels_option("CSV table of segments, as for preprocess; by default labels.csv in or just above the data.")
@clip_options
@json_option
def command(data: tuple[Path, ...], labels: Path | None, as_json: bool) -> None:
    """Look at clips (.bvh, .amc, .npz, .glb, .vrm, .fbx) and folders of them (DATA) before training.

    Prints for each clip its rig, unit, frame rate, up axis, floor, glitches and motion type, and for each type
    how much there is to learn from and what looks wrong: clips that never leave the ground where most of their
    type do, types whose clips fall into two groups, clips that move like another type, types that cannot be learnt.
    Files that a label table does not list are skipped, as by preprocess. The exit code is 1 if a file cannot be used.
    """
    from motionkit.data.diagnosis import diagnose

    with Stages() as show:
        found = diagnose(data, labels, show.count("looking"))
    if as_json:
        from dataclasses import asdict

        print_json(asdict(found))
    else:
        _print(found)
    faults = [clip for clip in found.clips if clip.fault]
    if not found.clips:
        raise MotionkitError(f"{found.labels}: lists none of the {len(found.skipped)} files")
    if faults:
        raise MotionkitError(f"{len(faults)} of {len(found.clips)} files cannot be used")


def _print(found: Diagnosis) -> None:
    from motionkit.cli.console import make_table

    out = stdout_console()
    if not out.is_terminal:
        out.width = NO_LIMIT
    if found.types:
        _print_clips([clip for clip in found.clips[:SHOWN_CLIPS] if not clip.fault], out)
    if len(found.clips) > SHOWN_CLIPS:
        out.print(f"... and {len(found.clips) - SHOWN_CLIPS} more files; --json lists all")
    if found.types:
        rows = [
            (t.name, f"{t.clips}", f"{t.seconds / 60:.2f}", f"{t.speed / 100:.2f}", f"{t.in_the_air:.0%}")
            for t in found.types
        ]
        out.print()
        out.print(make_table(("type", "clips", "minutes", "m/s", "time in jumps"), rows))
        out.print()
    out.print(f"types from {found.labels}" if found.labels else "types from folder and file names")
    for line in _lines(found):
        out.print(line)


def _lines(found: Diagnosis) -> Iterator[str]:
    """The lines below the tables."""
    from motionkit.data.labels import BEYOND_END

    # Label segments beyond the end of a clip are listed among the warnings already.
    notes = Counter(note for clip in found.clips for note in clip.notes if not note.startswith(BEYOND_END))
    for note, count in notes.most_common(SHOWN_NOTES):
        yield f"note: {note} ({counted(count, 'clip')})"
    faults = [clip for clip in found.clips if clip.fault]
    for clip in faults:
        yield f"cannot be used: {about(clip.name, clip.fault)}"
    for line in found.skipped[:SHOWN_SKIPS]:
        yield f"skipped {line}"
    if len(found.skipped) > SHOWN_SKIPS:
        yield f"skipped {len(found.skipped) - SHOWN_SKIPS} more; --json lists all"
    yield from found.lines
    if found.types and not faults and not any(line.startswith("warning: ") for line in found.lines):
        yield "nothing looks wrong"


def _print_clips(clips: list[ClipFacts], out: PlainConsole) -> None:
    """Print a row for each clip, then a summary of the rigs."""
    from motionkit.cli.console import make_table

    rigs = list(dict.fromkeys(map(_rig, clips)))
    several = len(rigs) > 1
    rows = []
    for clip in clips:
        number = [f"{rigs.index(_rig(clip)) + 1}"] if several else []
        measured = (f"{clip.seconds:.1f}", f"{clip.fps:g}", *number, f"{clip.floor:+.1f}", f"{clip.glitches}")
        rows.append((clip.name, ", ".join(clip.types), *measured))
    columns = ("clip", "type", "s", "fps", *(["rig"] if several else []), "floor cm", "glitches")
    out.print(make_table(columns, rows, (0, 1)))
    for place, rig in enumerate(rigs, 1):
        out.print(f"rig {place}: {rig}" if several else f"rig of all clips: {rig}")


def _rig(clip: ClipFacts) -> str:
    return f"{clip.rig}; {clip.unit.replace('detected from leg length: ', '')}; {clip.up} up"
