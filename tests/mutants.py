"""Changes one thing of the source at a time, and counts how many of these mutants the tests see.

A mutant is judged by the tests that call the function it is in; one outside of functions by all tests of its room.

python tests/mutants.py [--count 40] [--seed 0] [ROOM ...]     rooms: metrics, files, editing, export
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

ROOT = Path(__file__).resolve().parents[1]
# Room -> its source, below src/motionkit, and its tests.
ROOMS = {
    "metrics": ("metrics/*.py", ["tests/metrics"]),
    "files": ("files.py", ["tests/test_files.py"]),
    "editing": ("editing/*.py", ["tests/editing", "tests/cli/test_trim.py"]),
    # The tests of graphs and pages take minutes.
    "export": ("export/[!op]*.py", ["tests/export/test_golden.py", "tests/export/test_formats.py"]),
}
PATIENCE = 900.0  # s; a mutant that runs for longer is seen
SWAPS: dict[type, type] = {
    **{
        ast.Lt: ast.LtE,
        ast.LtE: ast.Lt,
        ast.Gt: ast.GtE,
        ast.GtE: ast.Gt,
        ast.Eq: ast.NotEq,
        ast.NotEq: ast.Eq,
    },
    **{
        ast.Add: ast.Sub,
        ast.Sub: ast.Add,
        ast.Mult: ast.Div,
        ast.Div: ast.Mult,
        ast.And: ast.Or,
        ast.Or: ast.And,
    },
    **{ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is},
}


def mutants(tree: ast.Module) -> Iterator[tuple[int, str, ast.AST, str, object]]:
    """Line, words, and the node, field and new value of every change."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare) and type(node.ops[0]) in SWAPS:
            new = SWAPS[type(node.ops[0])]()
            yield node.lineno, f"{ast.unparse(node)}: {type(new).__name__}", node, "ops", [new, *node.ops[1:]]
        elif isinstance(node, (ast.BinOp, ast.BoolOp)) and type(node.op) in SWAPS:
            text = isinstance(node, ast.BinOp) and any(
                isinstance(side, (ast.JoinedStr, ast.List, ast.Tuple))
                or isinstance(getattr(side, "value", None), str)
                for side in (node.left, node.right)
            )
            new = SWAPS[type(node.op)]()
            if not text:
                yield node.lineno, f"{ast.unparse(node)}: {type(new).__name__}", node, "op", new
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
            new = node.value + 1 if isinstance(node.value, int) else 1.25 * node.value + 0.001
            yield node.lineno, f"{node.value} is {new}", node, "value", new
        elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
            yield node.lineno, f"{node.value} is {not node.value}", node, "value", not node.value
        elif isinstance(node, ast.If):
            yield (
                node.lineno,
                f"not: {ast.unparse(node.test)}",
                node,
                "test",
                ast.UnaryOp(ast.Not(), node.test),
            )


def seen(copy: Path, tests: list[str], **words: str) -> bool:
    """Whether the tests fail with a copy of the source."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", *tests]
    if words:
        command += ["-p", "mutants"]
    paths = {"PYTHONPATH": os.pathsep.join([str(copy), str(ROOT / "tests")]), "PYTHONDONTWRITEBYTECODE": "1"}
    paths |= words
    try:
        done = subprocess.run(
            command, cwd=ROOT, env=os.environ | paths, capture_output=True, timeout=PATIENCE
        )
    except subprocess.TimeoutExpired:
        return True
    return done.returncode != 0


# ---- which tests call a function: this file as a plugin of pytest ----

CALLS = os.environ.get("MOTIONKIT_CALLS")  # file to write, a line for each test and function
if CALLS:
    import pytest

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
        found: set[tuple[str, int]] = set()

        def note(frame: FrameType, event: str, argument: object) -> None:
            if event == "call":
                found.add((frame.f_code.co_filename, frame.f_code.co_firstlineno))

        threading.setprofile(note)
        sys.setprofile(note)
        try:
            return (yield)
        finally:
            sys.setprofile(None)
            threading.setprofile(None)  # type: ignore[arg-type]
            with open(str(CALLS), "a", encoding="utf-8") as file:
                file.writelines(
                    f"{name}\t{line}\t{item.nodeid}\n" for name, line in found if "motionkit" in name
                )


def callers(copy: Path, room: str) -> dict[tuple[str, int], list[str]]:
    """File below the copy and first line of each function that the tests of a room call, and these tests."""
    calls = copy.parent / f"{room}.calls"
    assert not seen(copy, ROOMS[room][1], MOTIONKIT_CALLS=str(calls)), f"{room}: fails without a mutant"
    found: dict[tuple[str, int], list[str]] = {}
    for line in calls.read_text("utf-8").splitlines():
        name, first, test = line.split("\t")
        found.setdefault((os.path.relpath(name, copy), int(first)), []).append(test)
    return found


def first_line(tree: ast.Module, line: int) -> int | None:
    """First line of the innermost function around a line, its decorators included; None outside of functions."""
    around = [
        min([node.lineno, *(each.lineno for each in node.decorator_list)])
        for node in ast.walk(tree)
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
        and node.lineno <= line <= (node.end_lineno or node.lineno)
    ]
    return max(around, default=None)


def main() -> None:
    words = argparse.ArgumentParser()
    words.add_argument("rooms", nargs="*", default=list(ROOMS))
    words.add_argument("--count", type=int, default=40)
    words.add_argument("--seed", type=int, default=0)
    asked = words.parse_args()
    every = []
    for room in asked.rooms:
        for path in sorted((ROOT / "src/motionkit").glob(ROOMS[room][0])):
            every += [(room, path, n) for n, _ in enumerate(mutants(ast.parse(path.read_text("utf-8"))))]
    chosen = random.Random(asked.seed).sample(every, min(asked.count, len(every)))
    killed = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(shutil.copytree(ROOT / "src", Path(folder) / "src"))
        called = {room: callers(copy, room) for room in sorted({room for room, _, _ in chosen})}
        for number, (room, path, which) in enumerate(sorted(chosen), 1):
            text, place = path.read_text("utf-8"), copy / path.relative_to(ROOT / "src")
            tree = ast.parse(text)
            line, said, node, field, value = list(mutants(tree))[which]
            setattr(node, field, value)
            place.write_text(ast.unparse(ast.fix_missing_locations(tree)), "utf-8")
            function = first_line(ast.parse(text), line)
            tests = called[room].get((str(place.relative_to(copy)), function or 0), [])
            began = time.monotonic()
            dead = (
                seen(copy, ROOMS[room][1] if function is None else tests)
                if function is None or tests
                else False
            )
            place.write_text(text, "utf-8")
            killed += dead
            where = f"{path.relative_to(ROOT)}:{line}"
            print(
                f"{'killed' if dead else 'LIVES '} {time.monotonic() - began:4.0f} s  {where}  {said[:100]}",
                flush=True,
            )
            print(f"{killed} of {number} killed, {100 * killed / number:.0f} %", file=sys.stderr, flush=True)
    print(f"{killed} of {len(chosen)} killed, {100 * killed / len(chosen):.0f} % (of {len(every)} possible)")


if __name__ == "__main__":
    main()
