"""The report of an evaluation: tables and goals, written as JSON or Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from motionkit.tables import Cell, Table, show


@dataclass(frozen=True)
class Goal:
    """A measured value and its target.

    Attributes:
        value: the measured value; None if it could not be measured.
        target: the target in words.
        lowest, highest: the target as limits; None for no limit.
        note: what the value leaves out, or why it is missing.
    """

    what: str
    value: float | None
    target: str
    lowest: float | None = None
    highest: float | None = None
    note: str = ""

    @property
    def reached(self) -> bool | None:
        """Whether the value is within the limits; None without a value."""
        if self.value is None:
            return None
        above = self.lowest is None or self.value >= self.lowest
        return above and (self.highest is None or self.value <= self.highest)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        out: dict[str, Any] = {"what": self.what, "value": self.value, "target": self.target}
        return out | {"reached": self.reached} | ({"note": self.note} if self.note else {})


def at_most(what: str, value: float | None, limit: float, note: str = "", number_format: str = "g") -> Goal:
    """Return the goal that a value is at most a limit, which its target shows in a format."""
    return Goal(what, value, f"≤ {limit:{number_format}}", None, limit, note)


def at_least(what: str, value: float | None, limit: float, note: str = "", number_format: str = "g") -> Goal:
    """Return the goal that a value is at least a limit, which its target shows in a format."""
    return Goal(what, value, f"≥ {limit:{number_format}}", limit, None, note)


def all_of(what: str, kinds: Sequence[str], failing: Sequence[str]) -> Goal:
    """Return the goal that all types reach something; its note names those that do not."""
    value = 1.0 - len(failing) / len(kinds) if kinds else None
    return Goal(what, value, "all", 1.0, None, f"failed by: {', '.join(failing)}" if failing else "")


@dataclass(frozen=True)
class Section:
    """One section of the scoreboard.

    Attributes:
        name: the name --only takes.
        notes: definitions and settings behind the numbers, and what was left out.
    """

    name: str
    title: str
    tables: list[Table] = field(default_factory=list)
    goals: list[Goal] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    seconds: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "name": self.name,
            "title": self.title,
            "goals": [goal.as_dict() for goal in self.goals],
            "tables": [table.as_dict() for table in self.tables],
            "notes": self.notes,
            "seconds": round(self.seconds, 1),
        }


@dataclass(frozen=True)
class Scoreboard:
    """All sections of an evaluation. about holds the model, the dataset and the settings."""

    about: dict[str, Any]
    sections: list[Section]

    def summary(self) -> Table:
        """Return every goal in one table."""
        rows: list[tuple[Cell, ...]] = [
            (section.name, goal.what, goal.value, goal.target, verdict(goal), goal.note)
            for section in self.sections
            for goal in section.goals
        ]
        return Table("Targets", ("section", "what", "measured", "target", "result", "note"), rows)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {**self.about, "sections": [section.as_dict() for section in self.sections]}

    def markdown(self) -> str:
        """Return the whole scoreboard as Markdown."""
        lines = ["# Scoreboard", ""]
        lines += [f"- {name}: {show(value)}" for name, value in self.about.items()]
        lines += ["", "## Targets", "", *self.summary().markdown()]
        for section in self.sections:
            lines += ["", f"## {section.title}"]
            for table in section.tables:
                lines += ["", f"**{table.title}**", "", *table.markdown()]
            if section.notes:
                lines += ["", *(f"- {note}" for note in section.notes)]
        return "\n".join(lines) + "\n"


def verdict(goal: Goal) -> str:
    """Return the result of a goal: reached, missed or not measured."""
    return {True: "reached", False: "missed", None: "not measured"}[goal.reached]
