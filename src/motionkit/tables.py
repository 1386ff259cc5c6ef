"""Tables of plain values, for display and for JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

Cell = str | int | float | bool | None


@dataclass(frozen=True)
class Table:
    """A title, column headings and rows of plain values."""

    title: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[Cell, ...]]

    def as_dict(self) -> dict[str, Any]:
        """The table as plain values for JSON; each row is an object."""
        rows = [dict(zip(self.columns, row, strict=True)) for row in self.rows]
        return {"title": self.title, "rows": rows}

    def texts(self) -> list[tuple[str, ...]]:
        """The rows as text, formatted by show()."""
        return [tuple(map(show, row)) for row in self.rows]

    def markdown(self) -> list[str]:
        """The lines of the table in Markdown, without its title."""
        return list(map(_line, (self.columns, ["---"] * len(self.columns), *self.texts())))


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def show(value: Cell) -> str:
    """Format a value for display: three significant digits; an empty string for None."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"
    return str(value)
