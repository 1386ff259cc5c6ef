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
    lines_of_files,
    print_json,
    processes_option,
    stdout_console,
)
from motionkit.errors import MotionkitError
from motionkit.names import counted, first_lines

if TYPE_CHECKING:
    from motionkit.cli.console import PlainConsole
    from motionkit.data.diagnosis import ClipFacts, Diagnosis

LISTED_CLIPS, LISTED_SKIPS, LISTED_NOTES, LISTED_RIGS = 60, 8, 8, 12  # lines of each kind; --json lists all
NO_LIMIT = 1000  # columns, if the output is not a terminal


@click.command("doctor")
@click.argument("data", nargs=-1, required=True, type=EXISTING)
@animations_option
@labels_option("CSV table of segments, as for preprocess; by default labels.csv in or just above the data.")
@clip_options
@click.option(
    "--verbose", is_flag=True, help="Also print every clip, every type, and notes of how files were read."
)
@processes_option
@json_option
def command(data: tuple[Path, ...], labels: Path | None, verbose: bool, jobs: int, as_json: bool) -> None:
    """Look at clips (.bvh, .amc, .npz, .glb, .vrm, .fbx) and folders of them (DATA) before training.

    Prints whether they can be used, their rigs with unit and up axis, and what looks wrong: clips that never leave the
    ground where most of their type do, types whose clips fall into two groups, clips that move like another type,
    types that cannot be learnt. --verbose adds rate, floor, glitches and type of each clip, and how much there is of
    each type.
    Files that a label table does not list are skipped, as by preprocess. The exit code is 1 if a file cannot be used.
    """
    from motionkit.data.diagnosis import diagnose

    with Stages() as show:
        found = diagnose(data, labels, show.count("looking"), jobs)
    if as_json:
        from dataclasses import asdict

        print_json(asdict(found))
    else:
        _print(found, verbose)
    faults = [clip for clip in found.clips if clip.fault]
    if not found.clips and not found.labels:
        raise MotionkitError("there is no motion to look at; `motionkit retarget --rig FILE` looks at a rig")
    if not found.clips:
        raise MotionkitError(f"{found.labels}: lists none of the files that were found")
    if faults:
        raise MotionkitError(f"{len(faults)} of {len(found.clips)} files cannot be used")


def _print(found: Diagnosis, verbose: bool) -> None:
    """Print the verdict and what needs doing; with verbose, every clip, type and note before that."""
    out = stdout_console()
    if not out.is_terminal:
        out.width = NO_LIMIT
    out.print(_verdict(found))
    usable = [clip for clip in found.clips if not clip.fault and clip.rig]
    if verbose and found.types:
        _print_tables(found, out)
    elif usable:
        _print_rigs(usable, out)
    for line in _lines(found, verbose):
        out.print(line)
    if not verbose and usable:
        out.print("--verbose shows every clip, type and note", style="dim")


def _verdict(found: Diagnosis) -> str:
    """Whether the files can be used, in one line."""
    from motionkit.data.diagnosis import POSE  # slow to import

    usable, count = sum(not clip.fault for clip in found.clips), len(found.clips)
    if not count:
        return "no file is listed" if found.labels else "no file has a motion"
    if usable < count:
        files = f"{usable} of {counted(count, 'file')}" if usable else "none of the files"
        verdict = f"{files} can be used" if count > 1 else "the file cannot be used"
    else:
        verdict = f"all {count} files can be used" if count > 1 else "the file can be used"
    poses = sum(POSE in clip.notes for clip in found.clips)
    if poses == count:
        what = "it is a pose" if count == 1 else "all are poses"
        return f"{verdict}, but {what}, too short to train on: for --rig, --keys, view and convert"
    seconds = sum(clip.seconds for clip in found.clips)
    long = f"{seconds / 60:.1f} minutes" if seconds >= 60 else f"{seconds:.1f} s"
    warned = sum(line.startswith("warning: ") for line in found.lines)
    wrong = f"; {counted(warned, 'warning')}" if warned else "; nothing looks wrong"
    return verdict + (f"; {long} of motion" if usable else "") + (wrong if usable == count else "")


def _print_tables(found: Diagnosis, out: PlainConsole) -> None:
    """Print a row for each clip, the rigs, and a row for each type."""
    from motionkit.cli.console import make_table

    _print_clips([clip for clip in found.clips[:LISTED_CLIPS] if not clip.fault], out)
    if len(found.clips) > LISTED_CLIPS:
        out.print(f"... and {len(found.clips) - LISTED_CLIPS} more files; --json lists all")
    rows = [
        (t.name, f"{t.clips}", f"{t.seconds / 60:.2f}", f"{t.speed / 100:.2f}", f"{t.in_the_air:.0%}")
        for t in found.types
    ]
    out.print()
    out.print(make_table(("type", "clips", "minutes", "m/s", "time in jumps"), rows))
    out.print()


def _lines(found: Diagnosis, verbose: bool) -> Iterator[str]:
    """What needs doing; with verbose, notes too."""
    from motionkit.data.labels import BEYOND_END

    for line in lines_of_files([(clip.name, clip.fault) for clip in found.clips if clip.fault]):
        yield f"cannot be used: {line}"
    yield from first_lines([f"skipped {line}" for line in found.skipped], LISTED_SKIPS, "skipped files")
    lines = [line for line in found.lines if verbose or line.startswith("warning: ")]
    yield from first_lines(lines, LISTED_CLIPS, "lines")
    if found.types:
        yield f"types from {found.labels}" if found.labels else "types from folder and file names"
    # Label segments beyond the end of a clip are listed among the warnings already.
    notes = Counter(note for clip in found.clips for note in clip.notes if not note.startswith(BEYOND_END))
    if verbose:
        for note, count in notes.most_common(LISTED_NOTES):
            yield f"note: {note} ({counted(count, 'clip')})"


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
    columns = ("clip", "type", "s", "fps", *(["rig"] if several else []), "raised cm", "glitches")
    out.print(make_table(columns, rows, (0, 1)))
    _print_rigs(clips, out)


def _print_rigs(clips: list[ClipFacts], out: PlainConsole) -> None:
    """Print a line for each rig."""
    rigs = Counter(map(_rig, clips))
    if len(rigs) == 1:
        out.print(f"{'rig of all clips' if len(clips) > 1 else 'rig'}: {next(iter(rigs))}")
        return
    lines = [f"rig {n}: {rig} ({counted(count, 'clip')})" for n, (rig, count) in enumerate(rigs.items(), 1)]
    for line in first_lines(lines, LISTED_RIGS, "rigs"):
        out.print(line)


def _rig(clip: ClipFacts) -> str:
    return f"{clip.rig}; {clip.unit.replace('detected from leg length: ', '')}; {clip.up} up"
