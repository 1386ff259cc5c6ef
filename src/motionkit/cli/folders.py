"""Folders for commands that take one clip: every clip below one is written to the same place below another."""

from __future__ import annotations

import functools
import importlib
import json
import os
from collections import Counter
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import click

from motionkit.cli.common import (
    LISTED_LINES,
    Stages,
    lines_of_files,
    option,
    print_json,
    processes_option,
    remark,
    say,
    together,
)
from motionkit.cli.outputs import FORMATS, READ_AS, STDOUT, checked_ending
from motionkit.errors import MotionkitError, OverwriteError
from motionkit.files import check_outputs, remove_leftovers
from motionkit.names import about, counted, first_lines
from motionkit.reading import reading

Line = tuple[str, str]  # a file, and what is said of it

LISTED_KINDS = 12  # lines of how the clips of a folder were read


def _folder_options(forms: tuple[str, ...]) -> Callable:
    return together(
        option(
            "--format",
            "form",
            default=forms[0],
            type=click.Choice(forms),
            help="Folders: format to write.",
        ),
        processes_option,
    )


class _Job(NamedTuple):
    """One clip: the module of the command, and its arguments."""

    module: str
    values: dict[str, Any]


class _Done(NamedTuple):
    """What became of a clip: the error, or "", the notes and remarks, how clips were read, and what --json tells."""

    error: str
    notes: list[str]
    read_as: list[str]
    facts: Any


FILES = tuple(
    f".{form}" for form in (*FORMATS, "html", "png", "gif", "mp4")
)  # endings of a file, not a folder


def folders(
    source: str,
    target: str,
    forms: tuple[str, ...] = FORMATS,
    check: Callable[..., Any] = checked_ending,
    written: Callable[[Path, Path], list[Path]] = lambda clip, place: [place],
    refuse: Callable[[Path, dict[str, Any]], None] = lambda place, values: None,
) -> Callable:
    """Let a command take folders; source and target name its arguments. Put this above `gathered`.

    A single target is checked for its ending, by `check`, before any work. A source may be a tuple of clips, of which
    a folder is the only one. forms are the formats that the command writes; written gives the files that it writes for
    a clip and its place in the folder; refuse raises UsageError for arguments that a folder, of which it gets a file to
    write, cannot have.
    """

    def decorate(function: Callable) -> Callable:
        @_folder_options(forms)
        @functools.wraps(function)
        def whole(jobs: int, form: str, **values: Any) -> Any:
            sources = values[source]
            place = sources[0] if isinstance(sources, tuple) and len(sources) == 1 else sources
            if not isinstance(place, Path) or not place.is_dir():
                context = click.get_current_context()
                parameter = next(each for each in context.command.params if each.name == target)
                check(context, parameter, values[target])
                return function(**values)
            return _run_folder(values, _Folder(place, source, target, form, written, refuse), jobs)

        return whole

    return decorate


class _Folder(NamedTuple):
    """A folder of clips: its place, names of the arguments for clips and files, the format, `written` and `refuse`."""

    place: Path
    source: str
    target: str
    form: str
    written: Callable[[Path, Path], list[Path]]
    refuse: Callable[[Path, dict[str, Any]], None]


def _run_folder(values: dict[str, Any], whole: _Folder, jobs: int) -> None:
    """Run the command on every clip of a folder; raises MotionkitError at the end if some failed."""
    from motionkit.data.workers import worker_processes
    from motionkit.rig.read_file import clips_of

    folder, source, target, form, written, refuse = whole
    out = values[target]
    refuse(Path(f"{folder.name}.{form}"), values)
    if values.get("view"):
        raise click.UsageError(
            f"--view shows one clip, and {folder} is a folder; motionkit view shows its clips"
        )
    if out is None or out == STDOUT:
        raise click.UsageError(f"{folder} is a folder; give a folder to write to")
    if out.suffix.lower() in FILES and not out.is_dir():
        raise click.UsageError(f"{folder} is a folder; expected a folder to write to, found {out.name!r}")
    if out.resolve().is_relative_to(folder.resolve()):
        raise OverwriteError(f"{out}: is inside the input folder {folder}; choose another output folder")
    found = clips_of(folder)
    places = [(out / path.relative_to(folder)).with_suffix(f".{form}") for path in found]
    counts = Counter(places)
    # Files of one name with different endings keep these.
    places = [
        place.with_name(f"{path.stem}-{path.suffix[1:]}.{form}") if counts[place] > 1 else place
        for path, place in zip(found, places, strict=True)
    ]
    check_outputs((file for pair in zip(found, places, strict=True) for file in written(*pair)), found)
    module = importlib.import_module("motionkit.cli.main").COMMANDS[click.get_current_context().info_name]
    single = values | {"as_json": True}
    items = [
        _Job(
            module,
            single
            | {source: (path,) if isinstance(values[source], tuple) else path, target: place}
            | {"jobs": 1, "form": form},
        )
        for path, place in zip(found, places, strict=True)
    ]
    failed: list[Line] = []
    notes: list[Line] = []
    read_as: list[Line] = []
    facts: list[Any] = []
    try:
        with Stages() as show, worker_processes(min(jobs or os.cpu_count() or 1, len(items))) as each:
            progress = show.count("working", len(items))
            for number, (path, done) in enumerate(zip(found, each(_run_one, items), strict=True), 1):
                if done.error:
                    failed.append((str(path), done.error))
                    if len(failed) <= LISTED_LINES:
                        remark(f"failed: {about(*failed[-1])}")
                notes += [(path.name, note) for note in done.notes]
                read_as += [(path.name, words) for words in done.read_as]
                facts += [done.facts] if done.facts is not None else []
                progress(number)
    except BaseException:
        remove_leftovers(out)  # of processes that were killed
        raise
    _report(out, len(found), failed, notes, read_as, facts if values["as_json"] else None)
    if failed:
        raise MotionkitError(f"{len(failed)} of {len(found)} files failed")


def _report(
    out: Path,
    count: int,
    failed: list[Line],
    notes: list[Line],
    read_as: list[Line],
    facts: list[Any] | None,
) -> None:
    """Print what became of a folder's clips, as JSON if there are facts; a Line is a file and what is said of it."""
    for line in (
        *lines_of_files(notes),
        *(f"failed: {line}" for line in lines_of_files(failed[LISTED_LINES:])),
    ):
        remark(line)
    wrote = count - len(failed)
    if facts is not None:
        summary = {
            "clips": facts,
            "notes": [note for _, note in notes],
            "taken": dict(Counter(words for _, words in read_as)),
        }
        faults = [{"file": path, "error": error} for path, error in failed]
        print_json({"output": out, "written": wrote, "failed": faults} | summary)
    else:
        for line in (f"{out}: {wrote} of {count} files written", *_input_lines(read_as)):
            say(line)


def _input_lines(read_as: list[Line]) -> list[str]:
    """How the clips of a folder were read, in lines; several are counted."""
    files = Counter(words for _, words in read_as)
    first = {words: name for name, words in reversed(read_as)}
    lines = [
        f"  {counted(count, 'file') if count > 1 else first[words]}: {words}"
        for words, count in files.most_common()
    ]
    return first_lines(lines, LISTED_KINDS, "kinds")


def _run_one(job: _Job) -> _Done:
    """Run a command on one clip, and keep what it prints."""
    from contextlib import redirect_stderr, redirect_stdout

    command: click.Command = importlib.import_module(f"motionkit.cli.{job.module}").command
    notes: list[str] = []
    error = ""
    place = next(value for name, value in job.values.items() if name in ("output", "target"))
    results, remarks = StringIO(), StringIO()
    with (
        redirect_stdout(results),
        redirect_stderr(remarks),
        reading(on_note=notes.append),
        click.Context(command) as context,
    ):
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            assert command.callback is not None
            command.callback(**job.values)
        except click.ClickException as fault:
            error = fault.format_message()
        except (MotionkitError, OSError) as fault:
            error = str(fault)
    read_as = dict.fromkeys(
        words.partition("; ")[2] for words in context.meta.get(READ_AS, ())
    )  # without frames
    said = [*notes, *([] if error else remarks.getvalue().splitlines())]
    facts = json.loads(results.getvalue() or "null")
    return _Done(error, list(dict.fromkeys(said)), list(read_as), facts)  # a rig may be read twice
