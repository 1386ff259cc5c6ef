"""Changes one thing of the source at a time, and counts how many of these mutants the tests see.

A mutant is judged by the tests that call the function it is in; one that only the import runs by all of its room.
The tests are collected once: for each mutant a fork of this process takes the changed code and runs some of them.

python tests/mutants.py [--count 40] [--seed 0] [ROOM ...]     rooms: metrics, files, editing, finish, export
"""

from __future__ import annotations

import argparse
import ast
import gc
import multiprocessing
import os
import random
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, FrameType, FunctionType
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
# Room -> its source, below src/motionkit, and its tests.
ROOMS = {
    "metrics": ("metrics/*.py", ["tests/metrics"]),
    "files": ("files.py", ["tests/test_files.py"]),
    "editing": ("editing/*.py", ["tests/editing", "tests/cli/test_trim.py"]),
    "finish": ("finish/*.py", ["tests/finish"]),
    # The tests of graphs and pages take minutes.
    "export": (
        "export/[!op]*.py",
        ["tests/export/test_golden.py", "tests/export/test_formats.py", "tests/rig/test_character.py"],
    ),
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
    flags = {  # of dataclasses: they declare, and do nothing
        word.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "dataclass"
        for word in node.keywords
    }
    for node in ast.walk(tree):
        if node in flags:
            continue
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


OPTIONS = ["-x", "-q", "-s", "-n", "0", "-p", "no:cacheprovider", "-m", "not slow and not formats"]


def forked(work: Callable[[], Any], seconds: float | None = PATIENCE) -> Any:
    """What a fork of this process answers; None if it dies or runs out of time."""
    answer, end = multiprocessing.Pipe(duplex=False)

    def run() -> None:
        for stream in (1, 2):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
        end.send(work())

    child = multiprocessing.get_context("fork").Process(target=run)
    child.start()
    end.close()
    try:
        return answer.recv() if answer.poll(seconds) else None
    except EOFError:
        return None
    finally:
        child.kill()
        child.join()


def passes(items: list[pytest.Item]) -> bool:
    """Whether tests pass, run in this process."""
    for item, following in zip(items, [*items[1:], None], strict=True):
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        if item.session.testsfailed:
            return False
    return True


def calls(items: list[pytest.Item]) -> tuple[list[float], list[set[tuple[str, int]]]]:
    """Seconds of each test, and file and first line of the functions that it calls."""
    seconds, called = [], []
    for item, following in zip(items, [*items[1:], None], strict=True):
        found: set[tuple[str, int]] = set()

        def note(frame: FrameType, event: str, argument: object, found: set[tuple[str, int]] = found) -> None:
            if event == "call":
                found.add((frame.f_code.co_filename, frame.f_code.co_firstlineno))

        began = time.process_time()
        threading.settrace(note)
        sys.settrace(note)
        try:
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        finally:
            sys.settrace(None)
            threading.settrace(None)  # type: ignore[arg-type]
        assert not item.session.testsfailed, f"{item.nodeid}: fails without a mutant"
        seconds.append(time.process_time() - began)
        called.append({each for each in found if "motionkit" in each[0]})
    return seconds, called


def codes(code: CodeType) -> Iterator[CodeType]:
    """A code and all within it, in the order of the source."""
    yield code
    for each in code.co_consts:
        if isinstance(each, CodeType):
            yield from codes(each)


def changed(place: Path, before: ast.Module, after: ast.Module) -> list[tuple[FunctionType, CodeType]]:
    """The functions of this process that a change gives other code, and this code."""
    pairs = zip(*(codes(compile(tree, place, "exec")) for tree in (before, after)), strict=True)
    new = {(old.co_firstlineno, old): code for old, code in pairs if old != code}
    return [
        (each, new[each.__code__.co_firstlineno, each.__code__])
        for each in gc.get_objects()
        if isinstance(each, FunctionType)
        and each.__code__.co_filename == str(place)
        and (each.__code__.co_firstlineno, each.__code__) in new
    ]


class Judge:
    """A plugin of pytest: where tests would run, runs mutants instead."""

    def __init__(self, copy: Path, chosen: list[tuple[str, Path, int]]) -> None:
        self.copy, self.chosen = copy, chosen

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Judge every mutant."""
        found = forked(lambda: calls(session.items), None)
        assert found, "the tests fail without a mutant"
        self.seconds, self.called = found
        killed = 0
        for room, path, which in self.chosen:  # in chance order: what is judged so far is a sample too
            place = self.copy / path.relative_to(ROOT / "src")
            text = place.read_text("utf-8")
            before, after = ast.parse(text), ast.parse(text)
            line, said, node, field, value = list(mutants(after))[which]
            setattr(node, field, value)
            ast.fix_missing_locations(after)
            place.write_text(ast.unparse(after), "utf-8")
            began = time.monotonic()
            dead = not self.lives(session.items, room, place, changed(place, before, after))
            place.write_text(text, "utf-8")
            killed += dead
            print(
                f"{'killed' if dead else 'LIVES '} {time.monotonic() - began:4.0f} s  "
                f"{path.relative_to(ROOT)}:{line}  {said[:100]}",
                flush=True,
            )
        print(f"{killed} of {len(self.chosen)} killed, {100 * killed / len(self.chosen):.0f} %")
        return True

    def lives(
        self, items: list[pytest.Item], room: str, place: Path, functions: list[tuple[FunctionType, CodeType]]
    ) -> bool:
        """Whether the tests pass with a changed file."""
        lines = {(str(place), each.__code__.co_firstlineno) for each, _ in functions}
        order = sorted(range(len(items)), key=self.seconds.__getitem__)
        tests = [items[n] for n in order if self.called[n] & lines]

        def run() -> bool:
            for function, code in functions:
                function.__code__ = code
            return passes(tests)

        if tests:
            return bool(forked(run))
        of_room = [items[n].nodeid for n in order if items[n].nodeid.startswith(tuple(ROOMS[room][1]))]
        command = [sys.executable, "-m", "pytest", *OPTIONS, *of_room]
        try:
            return not subprocess.run(command, capture_output=True, timeout=PATIENCE).returncode
        except subprocess.TimeoutExpired:
            return False


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
    print(f"{len(chosen)} of {len(every)} possible")
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(shutil.copytree(ROOT / "src", Path(folder) / "src"))
        paths = [str(copy), str(ROOT / "tests")]
        sys.path[:0] = paths
        os.environ |= {"PYTHONPATH": os.pathsep.join(paths), "PYTHONDONTWRITEBYTECODE": "1"}
        sys.dont_write_bytecode = True
        os.chdir(ROOT)
        tests = [test for room in sorted({room for room, _, _ in chosen}) for test in ROOMS[room][1]]
        pytest.main([*OPTIONS, f"--basetemp={folder}/tests", *tests], [Judge(copy, chosen)])


if __name__ == "__main__":
    main()
