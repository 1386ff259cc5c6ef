"""The laboratory measures what the other rooms make: none of them imports it."""

from __future__ import annotations

import ast
from pathlib import Path

import motionkit

SOURCE = Path(motionkit.__file__).parent
ALLOWED = {"cli", "lab"}


def imported(path: Path) -> set[str]:
    """The names of modules that a file imports anywhere, those of type checkers included."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{each.name}" for each in node.names)}
        elif isinstance(node, ast.Import):
            names |= {each.name for each in node.names}
    return names


def test_only_the_command_line_imports_the_laboratory() -> None:
    users = {
        path.relative_to(SOURCE).parts[0]
        for path in SOURCE.rglob("*.py")
        if any(f"{name}.".startswith("motionkit.lab.") for name in imported(path))
    }
    assert users == {*ALLOWED, "__init__.py"}, (
        "the door names mk.evaluate, and imports it when it is first used"
    )
