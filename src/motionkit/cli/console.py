"""What is drawn on a terminal, tables and bars: text of users stays text there."""

from __future__ import annotations

from typing import IO, Any

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from motionkit.names import visible

_BESIDE_THE_BAR = 40  # columns for description, count and time
_WIDEST_BAR = 40


class PlainConsole(Console):
    """A console to which every string is text: no markup, no names of emoji, no control characters."""

    def __init__(self, file: IO[str], soft_wrap: bool = True) -> None:
        super().__init__(file=file, highlight=False, markup=False, emoji=False, soft_wrap=soft_wrap)

    def render_str(self, text: str, **options: Any) -> Text:
        """The text for rich, which asks here for every string: a line, a cell, a heading."""
        return super().render_str(visible(text), **options)


class _Count(ProgressColumn):
    """How much is done of how much, where that is known."""

    def render(self, task: Task) -> Text:
        total = "" if task.total is None else f"/{task.total:.0f}"
        return Text(f"{task.completed:.0f}{total}")


def make_progress(file: IO[str], disable: bool) -> Progress:
    """A bar with a count and the time left, which fits into the terminal and is gone when it is done."""
    console = PlainConsole(file, soft_wrap=False)  # lines that the terminal would wrap cannot be erased
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
