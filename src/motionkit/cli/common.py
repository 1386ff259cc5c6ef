"""Shared by the subcommands: repeated options, and output for people and for programs."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.files import safe_name
from motionkit.names import visible
from motionkit.seeds import LARGEST_SEED

if TYPE_CHECKING:
    from rich.progress import Progress

    from motionkit.cli.console import PlainConsole

STOPPED = 130  # exit code of a stopped command, the shells' convention for SIGINT

json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
model_option = click.option(
    "--model",
    "model_path",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Model file; the bundled model by default.",
)


def seed_option(default: int = 0) -> Callable:
    """The --seed option of every command that draws random numbers."""
    return click.option(
        "--seed",
        type=click.IntRange(0, LARGEST_SEED),
        default=default,
        show_default=True,
        help="Random seed; the same seed gives the same result.",
    )


def default_output(
    name: str, ending: str = ".bvh", files: Callable[[Path], Sequence[Path]] = lambda path: [path]
) -> Path:
    """A name in the current folder that no file has yet.

    Args:
        files: what will be written under a name; by default, one file of that name.
    """
    name = safe_name(name, 120)
    path = Path(f"{name}{ending}")
    number = 2
    while any(file.exists() for file in files(path)):
        path, number = Path(f"{name}-{number}{ending}"), number + 1
    return path


def print_json(value: Any) -> None:
    """Write one JSON document to stdout; NaN and infinity become null."""
    click.echo(json.dumps(plain(value), indent=2))


def plain(value: Any) -> Any:
    """Convert a value for JSON: NaN and infinity become None, tuples become lists."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def say(text: str) -> None:
    """Print one line of the result to stdout."""
    click.echo(visible(text))


def remark(text: str) -> None:
    """Print one message to stderr."""
    click.echo(visible(text), err=True)


def stdout_console() -> PlainConsole:
    """The console for results."""
    from motionkit.cli.console import PlainConsole

    return PlainConsole(sys.stdout)


def stderr_console() -> PlainConsole:
    """The console for progress and messages."""
    from motionkit.cli.console import PlainConsole

    return PlainConsole(sys.stderr)


def progress_bar() -> Progress:
    """A progress bar on stderr that erases itself at the end; it shows only on a terminal."""
    from motionkit.cli.console import make_progress

    return make_progress(sys.stderr, disable=not sys.stderr.isatty())


def stages_on(bar: Progress) -> Callable[[str, int, int], None]:
    """A function that shows stages of work on a bar: show(stage, done, total)."""
    tasks: dict[str, Any] = {}

    def show(stage: str, done: int, total: int) -> None:
        if stage not in tasks:
            tasks[stage] = bar.add_task(stage, total=total)
        bar.update(tasks[stage], completed=done)

    return show
