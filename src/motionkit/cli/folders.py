"""Folders for commands that take one clip: every clip below one is written to the same place below another."""

from __future__ import annotations

import functools
import importlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import click

from motionkit.cli.common import Stages, option, print_json, remark, say, together
from motionkit.cli.outputs import FORMATS, STDOUT, checked_ending
from motionkit.errors import MotionkitError, OverwriteError
from motionkit.files import check_outputs, remove_leftovers
from motionkit.names import about
from motionkit.reading import manner, reading

jobs_option = option(
    "--jobs",
    default=0,
    type=click.IntRange(0, 256),
    help="Folders: number of processes; 0 is one for each core.",
)


def _folder_options(forms: tuple[str, ...]) -> Callable:
    return together(
        option(
            "--format",
            "form",
            default=forms[0],
            type=click.Choice(forms),
            help="Folders: format to write.",
        ),
        jobs_option,
    )


class _Job(NamedTuple):
    """One clip: the module of the command, its arguments, and how to read."""

    module: str
    values: dict[str, Any]
    manner: dict[str, Any]


FILES = tuple(
    f".{form}" for form in (*FORMATS, "html", "png", "gif", "mp4")
)  # endings of a file, not a folder


def folders(
    source: str, target: str, forms: tuple[str, ...] = FORMATS, check: Callable[..., Any] = checked_ending
) -> Callable:
    """Let a command take folders; source and target name its arguments. Put this above `gathered`.

    A single target is checked for its ending, by `check`, before any work. A source may be a tuple of clips, of which
    a folder is the only one. forms are the formats that the command writes.
    """

    def decorate(function: Callable) -> Callable:
        @_folder_options(forms)
        @functools.wraps(function)
        def whole(jobs: int, form: str, **values: Any) -> Any:
            given = values[source]
            place = given[0] if isinstance(given, tuple) and len(given) == 1 else given
            if not isinstance(place, Path) or not place.is_dir():
                context = click.get_current_context()
                parameter = next(each for each in context.command.params if each.name == target)
                check(context, parameter, values[target])
                return function(**values)
            return _run_folder(values, place, source, target, form, jobs)

        return whole

    return decorate


def _run_folder(values: dict[str, Any], folder: Path, source: str, target: str, form: str, jobs: int) -> None:
    """Run the command on every clip of a folder; raises MotionkitError at the end if some failed."""
    from motionkit.data.workers import worker_processes
    from motionkit.rig.read_file import motion_files, told_endings

    out = values[target]
    if out is None or out == STDOUT:
        raise click.UsageError(f"{folder} is a folder; give a folder to write to")
    if out.suffix.lower() in FILES and not out.is_dir():
        raise click.UsageError(f"{folder} is a folder; expected a folder to write to, found {out.name!r}")
    if out.resolve().is_relative_to(folder.resolve()):
        raise OverwriteError(f"{out}: is inside the input folder {folder}; choose another output folder")
    found = motion_files(folder)
    if not found:
        raise MotionkitError(f"{folder}: no {told_endings()} files found")
    places = [(out / path.relative_to(folder)).with_suffix(f".{form}") for path in found]
    check_outputs(places, found)
    module = importlib.import_module("motionkit.cli.main").COMMANDS[click.get_current_context().info_name]
    single = values | {"as_json": True, **({"view": False} if "view" in values else {})}
    items = [
        _Job(
            module,
            single
            | {source: (path,) if isinstance(values[source], tuple) else path, target: place}
            | {"jobs": 1, "form": form},
            manner(),
        )
        for path, place in zip(found, places, strict=True)
    ]
    failed: list[dict[str, Any]] = []
    try:
        with Stages() as show, worker_processes(min(jobs or os.cpu_count() or 1, len(items))) as each:
            progress = show.count("working", len(items))
            for done, (path, (error, notes)) in enumerate(zip(found, each(_run_one, items), strict=True), 1):
                for line in (*notes, *([f"failed: {about(str(path), error)}"] if error else ())):
                    remark(line)
                failed += [{"file": path, "error": error}] if error else []
                progress(done)
    except BaseException:
        remove_leftovers(places)  # of processes that were killed
        raise
    wrote = len(found) - len(failed)
    if values["as_json"]:
        print_json({"output": out, "written": wrote, "failed": failed})
    else:
        say(f"{out}: {wrote} of {len(found)} files written")
    if failed:
        raise MotionkitError(f"{len(failed)} of {len(found)} files failed")


def _run_one(job: _Job) -> tuple[str, list[str]]:
    """Run a command on one clip without output; its error, "" if there is none, and the notes on what was read."""
    from contextlib import redirect_stderr, redirect_stdout

    command: click.Command = importlib.import_module(f"motionkit.cli.{job.module}").command
    notes: list[str] = []
    place = next(value for name, value in job.values.items() if name in ("output", "target"))
    with (
        Path(os.devnull).open("w") as nothing,
        redirect_stdout(nothing),
        redirect_stderr(nothing),
        reading(hear=notes.append, **job.manner),
        click.Context(command),
    ):
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            assert command.callback is not None
            command.callback(**job.values)
        except click.ClickException as error:
            return error.format_message(), list(dict.fromkeys(notes))
        except (MotionkitError, OSError) as error:
            return str(error), list(dict.fromkeys(notes))
    return "", list(dict.fromkeys(notes))  # a file may be read twice, such as for its motion and for its rig
