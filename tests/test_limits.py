"""Classes and functions stay small enough to hold in the head: 12 attributes, 8 parameters, 60 lines at most."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import motionkit

SOURCE = Path(motionkit.__file__).parent
MOST_ATTRIBUTES, MOST_PARAMETERS, MOST_LINES = 12, 8, 60

# What is still larger, and what it has. This table shrinks only: what has become small leaves it, and nothing enters.
SHRINKS_ONLY: dict[str, str] = {}

Function = ast.FunctionDef | ast.AsyncFunctionDef


def attributes(record: ast.ClassDef) -> int:
    """The number of fields of a dataclass, a NamedTuple or a TypedDict, and of attributes that __init__ sets."""
    words = " ".join(map(ast.unparse, (*record.decorator_list, *record.bases)))
    names: set[str] = set()
    if any(word in words for word in ("dataclass", "NamedTuple", "TypedDict")):
        names |= {ast.unparse(line.target) for line in record.body if isinstance(line, ast.AnnAssign)}
    for function in record.body:
        if isinstance(function, Function) and function.name == "__init__":
            stored = [node for node in ast.walk(function) if isinstance(node, ast.Attribute)]
            own = [node for node in stored if isinstance(node.ctx, ast.Store)]
            names |= {node.attr for node in own if ast.unparse(node.value) == "self"}
    return len(names)


def parameters(function: Function) -> int:
    """The number of parameters, without self and cls."""
    asked = function.args
    names = [one.arg for one in (*asked.posonlyargs, *asked.args, *asked.kwonlyargs)]
    names += [one.arg for one in (asked.vararg, asked.kwarg) if one]
    return len([name for name in names if name not in ("self", "cls")])


def lines(function: Function) -> int:
    """The number of lines, without decorators: those of a command are its options."""
    assert function.end_lineno is not None
    return function.end_lineno - function.lineno + 1


def too_large(source: Path) -> dict[str, str]:
    """What is too large, as module.name or module.Class.name, and what it has."""
    found: dict[str, str] = {}

    def look(node: ast.AST, place: str) -> None:
        for child in ast.iter_child_nodes(node):
            name = f"{place}.{child.name}" if isinstance(child, (ast.ClassDef, Function)) else place
            if isinstance(child, ast.ClassDef) and attributes(child) > MOST_ATTRIBUTES:
                found[name] = f"{attributes(child)} attributes"
            elif isinstance(child, Function):
                counts = []
                if parameters(child) > MOST_PARAMETERS:
                    counts.append(f"{parameters(child)} parameters")
                if lines(child) > MOST_LINES:
                    counts.append(f"{lines(child)} lines")
                if counts:
                    found[name] = ", ".join(counts)
            look(child, name)

    for path in sorted(source.rglob("*.py")):
        look(ast.parse(path.read_text("utf-8")), ".".join(path.relative_to(source).with_suffix("").parts))
    return found


def test_classes_and_functions_are_small() -> None:
    found = too_large(SOURCE)
    grown = {name: has for name, has in found.items() if SHRINKS_ONLY.get(name) != has}
    assert not grown, "too large, or larger or smaller than the table says"
    assert not SHRINKS_ONLY.keys() - found.keys(), "these are small now: take them out of SHRINKS_ONLY"


@pytest.mark.parametrize("decorator", ["@dataclass", "@dataclass(frozen=True)", "@dataclasses.dataclass"])
def test_large_ones_are_found(tmp_path: Path, decorator: str) -> None:
    many = "\n".join(f"    a{n}: int = 0" for n in range(13))
    set_ones = "\n".join(f"        self.a{n}, self.b{n} = 0, a" for n in range(7))
    long = "\n".join("    a = 0" for _ in range(60))
    (tmp_path / "large.py").write_text(
        f"{decorator}\nclass Large:\n{many}\n"
        f"class Set:\n    def __init__(self, a):\n{set_ones}\n        a.c = self.a1\n"
        "class Other:\n    def f(self, a, b, c, d, *e, f, g, h, **i): ...\n"
        "    def g(self, a, b, c, d, e, f, g, h): ...\n"
        "@cli.command()\ndef command(a, b, c, d, e, f, g, h, i): ...\n"
        f"@option(\n'-o'\n)\ndef long(a):\n{long}\n"
        f"def short():\n{long.removesuffix('    a = 0')}\n"
    )
    assert too_large(tmp_path) == {
        "large.Large": "13 attributes",
        "large.Set": "14 attributes",
        "large.Other.f": "9 parameters",
        "large.command": "9 parameters",
        "large.long": "61 lines",
    }
