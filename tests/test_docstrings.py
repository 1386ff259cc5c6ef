"""Docstrings name attributes and arguments that exist, so that a rename takes its description along."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import motionkit

SOURCE = Path(motionkit.__file__).parent
FILES = sorted(SOURCE.rglob("*.py"))


def described(node: ast.ClassDef | ast.FunctionDef, heading: str) -> list[str]:
    """The names under a heading of a docstring."""
    section = re.search(rf"{heading}:\n(.*?)(?:\n\n|\Z)", ast.get_docstring(node) or "", re.S)
    found = re.findall(r"^ {4}(\w+(?:, \w+)*):", section[1], re.M) if section else []
    return [name for group in found for name in group.split(", ")]


def unknown(source: str) -> Iterator[str]:
    """What docstrings describe that is not there; functions with keywords of any name may describe these."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ClassDef):
            names = {part.id for line in node.body for part in ast.walk(line) if isinstance(part, ast.Name)}
            names |= {part.attr for part in ast.walk(node) if isinstance(part, ast.Attribute)}
            names |= {line.name for line in node.body if isinstance(line, ast.FunctionDef)}
            yield from (f"{node.name}.{name}" for name in described(node, "Attributes") if name not in names)
        elif isinstance(node, ast.FunctionDef) and not node.args.kwarg:
            names = {part.arg for part in ast.walk(node.args) if isinstance(part, ast.arg)}
            yield from (f"{node.name}({name})" for name in described(node, "Args") if name not in names)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_docstrings_name_what_exists(path: Path) -> None:
    assert not list(unknown(path.read_text(encoding="utf-8")))


def test_the_check_sees_old_names() -> None:
    record = (
        'class A:\n    """One.\n\n    Attributes:\n        old: a.\n        b, c: d.\n    """\n    b: int\n'
    )
    record += "    c: int\n"
    function = 'def f(new):\n    """One.\n\n    Args:\n        old: a.\n    """\n'
    assert list(unknown(record + function)) == ["A.old", "f(old)"]
