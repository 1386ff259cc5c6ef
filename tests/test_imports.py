"""Modules import each other in one direction: no circles, nothing imports the command line, only it imports the lab."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import motionkit

SOURCE = Path(motionkit.__file__).parent
# Circles that are known, each as the set of its modules with what opens it. The list may only shrink.
KNOWN_CIRCLES: dict[frozenset[str], str] = {}

Graph = dict[str, set[str]]


def import_graph(package: Path) -> Graph:
    """Which modules of a package each of its modules imports, at any depth: in functions and for type checkers too."""
    names = {}
    for path in package.rglob("*.py"):
        name = ".".join((package.name, *path.relative_to(package).with_suffix("").parts))
        names[name.removesuffix(".__init__")] = path
    return {name: _imports(path, name, set(names)) - {name} for name, path in names.items()}


def _imports(path: Path, name: str, known: set[str]) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: a relative import"
            whole = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= whole & known
            found |= {node.module} if whole - known else set()
    return found & known


def circles(graph: Graph) -> set[frozenset[str]]:
    """The sets of modules that reach each other (Tarjan's strongly connected components of more than one)."""
    order: dict[str, int] = {}
    lowest: dict[str, int] = {}
    waiting: list[str] = []
    found = set()

    def visit(name: str) -> None:
        order[name] = lowest[name] = len(order)
        waiting.append(name)
        for other in graph[name]:
            if other not in order:
                visit(other)
            if other in waiting:
                lowest[name] = min(lowest[name], lowest[other])
        if lowest[name] == order[name]:
            place = waiting.index(name)
            if len(waiting) > place + 1:
                found.add(frozenset(waiting[place:]))
            del waiting[place:]

    for name in graph:
        if name not in order:
            visit(name)
    return found


def room(name: str) -> str:
    """The room of a module: cli for motionkit.cli.experiment.runs."""
    return [*name.split("."), ""][1]


def wrong_ways(graph: Graph) -> set[tuple[str, str]]:
    """Imports that the rooms forbid, as pairs of modules."""
    return {
        (name, other)
        for name, others in graph.items()
        for other in others
        if (room(other) == "cli" and room(name) not in ("cli", "__main__"))
        or (room(other) == "lab" and room(name) not in ("cli", "lab"))
    }


def test_no_modules_import_each_other() -> None:
    found = circles(import_graph(SOURCE))
    assert found == set(KNOWN_CIRCLES), "a new circle, or one of KNOWN_CIRCLES that is open by now"


def test_nothing_imports_the_command_line_and_only_it_the_lab() -> None:
    assert not wrong_ways(import_graph(SOURCE))


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({"a": "import p.b", "b": "from p.c import x", "c": ""}, set()),
        ({"a": "import p.b", "b": "from p import c", "c": "def f():\n    import p.a"}, {"p.a p.b p.c"}),
        ({"a": "if TYPE_CHECKING:\n    from p.b import B", "b": "from p.a import A"}, {"p.a p.b"}),
        ({"__init__": "from p.a import A", "a": "from p import x"}, {"p p.a"}),
        (
            {"a": "import p.b", "b": "import p.a", "c": "import p.d", "d": "import p.c"},
            {"p.a p.b", "p.c p.d"},
        ),
    ],
)
def test_circles_are_found(tmp_path: Path, files: dict[str, str], expected: set[str]) -> None:
    package = tmp_path / "p"
    package.mkdir()
    for name, text in files.items():
        (package / f"{name}.py").write_text(text)
    assert circles(import_graph(package)) == {frozenset(names.split()) for names in expected}


def test_wrong_ways_are_found() -> None:
    graph = {
        "m.__main__": {"m.cli.main"},
        "m.cli.main": {"m.lab.table", "m.cli.view"},
        "m.api": {"m.cli.main", "m.models.config"},
        "m.lab.table": {"m.lab.trial"},
        "m.training.trainer": {"m.lab.trial"},
    }
    assert wrong_ways(graph) == {("m.api", "m.cli.main"), ("m.training.trainer", "m.lab.trial")}
