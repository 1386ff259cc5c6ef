"""Classes and functions stay small enough to hold in the head: at most 12 attributes, at most 8 parameters."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import motionkit

SOURCE = Path(motionkit.__file__).parent
MOST_FIELDS, MOST_PARAMETERS = 12, 8
# Functions of the door whose keywords are those of a command: `mk.synthesize("running:4", seed=3)` reads better than
# one with a record of options (docs/architecture.md).
LONG_CALLS = {"api.synthesize", "api.follow_path"}

# Classes with more than 12 attributes, counting those that __init__ sets. The list may only shrink.
LARGE_CLASSES = {
    "cli.training_monitor.TrainingMonitor",
    "control.drive.Driver",
    "control.follow.PathFollower",
    "control.reference_player.ReferencePlayer",
    "models.htss.TwoStream",
    "play.live.Live",
    "training.sampler.WindowSampler",
    "training.trainer.TrainingRun",
    "view.body._Human",
}

Function = ast.FunctionDef | ast.AsyncFunctionDef


def fields(record: ast.ClassDef) -> int:
    """The number of fields of a dataclass, a NamedTuple or a TypedDict; 0 for other classes."""
    words = " ".join(map(ast.unparse, (*record.decorator_list, *record.bases)))
    known = any(word in words for word in ("dataclass", "NamedTuple", "TypedDict"))
    return sum(isinstance(line, ast.AnnAssign) for line in record.body) if known else 0


def parameters(function: Function) -> int:
    """The number of parameters, without self and cls."""
    asked = function.args
    names = [one.arg for one in (*asked.posonlyargs, *asked.args, *asked.kwonlyargs)]
    names += [one.arg for one in (asked.vararg, asked.kwarg) if one]
    return len([name for name in names if name not in ("self", "cls")])


def attributes(kind: ast.ClassDef) -> int:
    """The number of attributes of a class: those it declares, and those that __init__ sets."""
    names = {
        line.target.id
        for line in kind.body
        if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name)
    }
    for line in kind.body:
        if isinstance(line, ast.FunctionDef) and line.name == "__init__":
            names |= {
                node.attr
                for node in ast.walk(line)
                if isinstance(node, ast.Attribute)
                and isinstance(node.ctx, ast.Store)
                and ast.unparse(node.value) == "self"
            }
    return len(names)


def is_command(function: Function) -> bool:
    """Whether click calls the function, with a parameter for each option."""
    return any("command(" in ast.unparse(line) for line in function.decorator_list)


def too_large(source: Path) -> tuple[set[str], set[str]]:
    """Records with too many fields, and functions with too many parameters, as module.name."""
    records, functions = set(), set()
    for path in source.rglob("*.py"):
        module = ".".join(path.relative_to(source).with_suffix("").parts)
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.ClassDef) and fields(node) > MOST_FIELDS:
                records.add(f"{module}.{node.name}")
            elif isinstance(node, Function) and parameters(node) > MOST_PARAMETERS and not is_command(node):
                functions.add(f"{module}.{node.name}")
    return records, functions


def large_classes(source: Path) -> set[str]:
    """Classes with too many attributes, as module.name."""
    return {
        f"{'.'.join(path.relative_to(source).with_suffix('').parts)}.{node.name}"
        for path in source.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.ClassDef) and attributes(node) > MOST_FIELDS
    }


def test_classes_are_small() -> None:
    assert large_classes(SOURCE) <= LARGE_CLASSES


def test_large_classes_are_found(tmp_path: Path) -> None:
    pairs = "\n".join(f"        self.a{n}, self.b{n} = 0, self.c{n}" for n in range(6))
    text = f"class {{}}:\n    c: int\n    def __init__(self):\n{pairs}\n"
    (tmp_path / "large.py").write_text(
        text.format("Twelve").replace("    c: int\n", "") + text.format("More")
    )
    assert large_classes(tmp_path) == {"large.More"}


def test_records_and_functions_are_small() -> None:
    records, functions = too_large(SOURCE)
    assert not records, f"more than {MOST_FIELDS} fields"
    assert functions == LONG_CALLS, f"more than {MOST_PARAMETERS} parameters"


@pytest.mark.parametrize("decorator", ["@dataclass", "@dataclass(frozen=True)", "@dataclasses.dataclass"])
def test_large_ones_are_found(tmp_path: Path, decorator: str) -> None:
    lines = "\n".join(f"    a{n}: int = 0" for n in range(13))
    (tmp_path / "large.py").write_text(
        f"{decorator}\nclass Large:\n{lines}\n"
        "class Other:\n    def f(self, a, b, c, d, *e, f, g, h, **i): ...\n"
        "    def g(self, a, b, c, d, e, f, g, h): ...\n"
        "@cli.command()\ndef command(a, b, c, d, e, f, g, h, i): ...\n"
    )
    assert too_large(tmp_path) == ({"large.Large"}, {"large.f"})
