"""Tables and progress bars on a terminal; text from users is never read as markup or control codes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import IO, Any

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from motionkit.names import visible

_BESIDE_THE_BAR = 40  # columns reserved for description, count and time
_WIDEST_BAR = 40  # columns
BARE: dict[str, Any] = {"box": None, "header_style": "bold", "pad_edge": False}  # a table without rules


class PlainConsole(Console):
    """A console that prints every string literally: no markup, no emoji names, no control characters."""

    def __init__(self, file: IO[str], soft_wrap: bool = True) -> None:
        super().__init__(file=file, highlight=False, markup=False, emoji=False, soft_wrap=soft_wrap)

    def render_str(self, text: str, **options: Any) -> Text:
        """Make a string printable; rich calls this for every line, cell and heading."""
        return super().render_str(visible(text), **options)


def make_table(
    columns: Sequence[str], rows: Iterable[Sequence[str]], left: Iterable[int] = (0,), **style: Any
) -> Table:
    """A table of text; without a title it has no rules.

    Columns are right-aligned, for numbers, but those of index `left`.
    """
    usual = {} if "title" in style else BARE
    table = Table(**(usual | style))
    left = set(left)
    for number, name in enumerate(columns):
        table.add_column(name, justify="left" if number in left else "right", overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table


class _Count(ProgressColumn):
    """Steps done, and the total if known."""

    def render(self, task: Task) -> Text:
        total = "" if task.total is None else f"/{task.total:.0f}"
        return Text(f"{task.completed:.0f}{total}")


def make_progress(file: IO[str], disable: bool) -> Progress:
    """A progress bar with count and remaining time; it fits the terminal and erases itself at the end."""
    console = PlainConsole(file, soft_wrap=False)  # lines that the terminal wraps could not be erased
    width = max(4, min(_WIDEST_BAR, console.width - _BESIDE_THE_BAR))
    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(width),
        _Count(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=disable,
    )
