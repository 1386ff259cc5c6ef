"""Shared parts of the subcommands: options, option records, and output for people and programs."""

from __future__ import annotations

import functools
import inspect
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.finite import FiniteRange
from motionkit.files import plain
from motionkit.names import about, first_lines, visible
from motionkit.reading import reading
from motionkit.seeds import LARGEST_SEED

if TYPE_CHECKING:
    from rich.progress import Progress

    from motionkit.cli.console import PlainConsole

LISTED_LINES = 20  # lines of a kind that are printed; --json lists all
_FEW = 3  # files with the same note that are named one by one
STOPPED = 130  # exit code of a stopped command: 128 plus SIGINT, as in shells

# ---- options ----

PLACE: Any = click.Path(path_type=Path)
EXISTING: Any = click.Path(exists=True, path_type=Path)
EXISTING_FILE: Any = click.Path(exists=True, dir_okay=False, path_type=Path)
EXISTING_FOLDER: Any = click.Path(exists=True, file_okay=False, path_type=Path)
FILE: Any = click.Path(dir_okay=False, path_type=Path)
FOLDER: Any = click.Path(file_okay=False, path_type=Path)


def option(*names: str, **more: Any) -> Callable:
    """A click.option whose help shows the default, if there is one."""
    return click.option(*names, **({"show_default": "default" in more} | more))


def switch(names: str, text: str) -> Callable:
    """An option that is on by default, such as "--ik/--no-ik"."""
    return option(names, default=True, help=text)


def together(*decorators: Callable) -> Callable:
    """One decorator that adds several options, in the order of the help."""

    def decorate(function: Callable) -> Callable:
        for decorator in reversed(decorators):
            function = decorator(function)
        return function

    return decorate


def gathered(name: str, record: Callable[..., Any]) -> Callable:
    """Pass options to the command as one record: those that the record has fields for. Put this below the options.

    A field without an option keeps its default.
    """
    fields = tuple(inspect.signature(record).parameters)

    def decorate(function: Callable) -> Callable:
        @functools.wraps(function)
        def with_record(**values: Any) -> Any:
            mine = {field: values.pop(field) for field in fields if field in values}
            return function(**values, **{name: record(**mine)})

        return with_record

    return decorate


json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
model_option = click.option(
    "--model", "model_path", type=EXISTING_FILE, help="Model file; the bundled model by default."
)


def _choose(context: click.Context, parameter: click.Parameter, value: str | None) -> None:
    """Callback of --clip: read the animation of this name while the command runs."""
    if value is not None:
        context.with_resource(reading(animation=value))


def eager_option(*names: str, callback: Callable[..., Any], **more: Any) -> Callable:
    """An option that its callback carries out, before the command begins."""
    return click.option(*names, is_eager=True, expose_value=False, callback=callback, **more)


def named_animation_option(text: str) -> Callable:
    return eager_option("--clip", "animation", callback=_choose, help=text)


animation_option = named_animation_option("Animation to read from a .glb or .vrm that has several.")
animations_option = named_animation_option(
    "Animation to read from a .glb or .vrm that has several; all takes each of them."
)


def read_strictly(context: click.Context, parameter: click.Parameter, value: bool) -> bool:
    """Callback of --strict: read files strictly while the command runs."""
    if value:
        context.with_resource(reading(strict=True))
    return value


strict_option = eager_option(
    "--strict",
    is_flag=True,
    callback=read_strictly,
    help="Refuse clips with faults that are otherwise repaired and reported, such as a wrong frame count or NaN.",
)


UPS = click.Choice(["X", "Y", "Z", "-X", "-Y", "-Z"], case_sensitive=False)


def parse_up(context: click.Context, parameter: click.Parameter, value: str | None) -> str | None:
    """The up axis that the user gives; prints it."""
    if value:
        remark(f"as given: {value} is up")
    return value


def parse_cm(context: click.Context, parameter: click.Parameter, value: str | None) -> float | None:
    """The cm of the unit that the user names; prints them."""
    if not value:
        return None
    from motionkit.rig.units import UNITS, named_unit

    try:
        cm = named_unit(value)
    except ValueError:
        known = ", ".join(unit.symbol for unit in UNITS)
        raise click.BadParameter(f"expected {known} or the cm per unit, found {value!r}") from None
    remark(f"as given: 1 unit is {cm:.6g} cm")
    return cm


def _read_upright(context: click.Context, parameter: click.Parameter, value: str | None) -> None:
    context.with_resource(reading(up=parse_up(context, parameter, value)))


def _read_unit(context: click.Context, parameter: click.Parameter, value: str | None) -> None:
    context.with_resource(reading(cm=parse_cm(context, parameter, value)))


def _read_mapped(context: click.Context, parameter: click.Parameter, value: Path | None) -> None:
    if value:
        from motionkit.rig.map_file import read_joints

        context.with_resource(reading(joints=read_joints(value)))
        remark(f"as given: the bone map {value}")


# What the user says about clips, in place of what is found in them.
input_options = together(
    eager_option(
        "--up", type=UPS, callback=_read_upright, help="Axis of the clips that points up; found by default."
    ),
    eager_option(
        "--unit",
        callback=_read_unit,
        help="Unit of the clips: cm, m, mm, dm, inches, or the centimetres per unit; found by default.",
    ),
    eager_option(
        "--map",
        type=EXISTING_FILE,
        callback=_read_mapped,
        help="Bone map of the clips (JSON, from `motionkit retarget --save-map`); found by names and shape by default.",
    ),
)
clip_options = together(strict_option, input_options)


seed_option = option(
    "--seed",
    type=click.IntRange(0, LARGEST_SEED),
    default=0,
    help="Random seed; the same seed gives the same result.",
)


def fps_option(text: str) -> Callable:
    """The --fps option of commands that write a motion."""
    return click.option("--fps", type=FiniteRange(1, 480), help=text)


processes_option = option(
    "--jobs",
    default=0,
    type=click.IntRange(0, 256),
    help="Number of processes for a folder; 0 chooses it by cores and files.",
)


def labels_option(text: str) -> Callable:
    """The --labels option: a table of segments."""
    return click.option("--labels", type=EXISTING_FILE, help=text)


# ---- output ----


def print_json(value: Any) -> None:
    """Print a JSON document to stdout; NaN and infinity become null."""
    click.echo(json.dumps(plain(value), indent=2))


def say(text: str) -> None:
    """Print a line of the result to stdout."""
    click.echo(visible(text))


def remark(text: str) -> None:
    """Print a message to stderr."""
    click.echo(visible(text), err=True)


def lines_of_files(notes: Sequence[tuple[str, str]], most: int = LISTED_LINES) -> list[str]:
    """A line for each file name and note; of many files, one line for all with the same note."""
    alike: dict[str, list[tuple[str, str]]] = {}
    for name, text in notes:
        alike.setdefault(text.removeprefix(name) if len(notes) > most else f"{name} {text}", []).append(
            (name, text)
        )
    lines = []
    for files in alike.values():
        listed = [about(*file) for file in files]
        lines += listed if len(files) <= _FEW else [f"{len(files)} files, such as {listed[0]}"]
    return first_lines(lines, most, "files")


def stdout_console() -> PlainConsole:
    """The console for results."""
    from motionkit.cli.console import PlainConsole

    return PlainConsole(sys.stdout)


def stderr_console() -> PlainConsole:
    """The console for progress and messages."""
    from motionkit.cli.console import PlainConsole

    return PlainConsole(sys.stderr)


class Stages:
    """Shows the stages of a job on one progress bar each, on a terminal; a bar disappears as the next begins."""

    def __init__(self) -> None:
        self._stage = ""
        self._bar: Progress | None = None

    def __enter__(self) -> Stages:
        return self

    def __exit__(self, *details: object) -> None:
        self.close()

    def __call__(self, stage: str, done: float, total: float | None = None) -> None:
        """Show progress of a stage; total is None while unknown."""
        if stage != self._stage or self._bar is None:
            from motionkit.cli.console import make_progress

            self.close()
            self._stage, self._bar = stage, make_progress(sys.stderr, disable=not sys.stderr.isatty())
            self._bar.start()
            self._bar.add_task(stage, total=total)
        self._bar.update(self._bar.task_ids[0], completed=done, total=total)

    def count(self, stage: str, total: float | None = None) -> Callable[..., None]:
        """A callback for a stage that counts; it takes the amount done and, optionally, the total."""
        self(stage, 0, total)
        return lambda done, of=total: self(stage, done, of)

    def share(self, stage: str) -> Callable[[float], None]:
        """A callback for a stage that reports the fraction done, 0 to 1."""
        self(stage, 0, 100)
        return lambda share: self(stage, 100 * share, 100)

    def close(self) -> None:
        """Remove the bar, so that text can be printed."""
        if self._bar is not None:
            self._bar.stop()
        self._bar = None
