"""README.md and docs/architecture.md: short, complete, and with figures that scripts have filled in."""

from __future__ import annotations

import ast
import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

import motionkit as mk

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
SOURCE = ROOT / "src" / "motionkit"


def script(name: str) -> ModuleType:
    """A script of docs as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def make_readme() -> ModuleType:
    """docs/make_readme.py as a module."""
    return script("make_readme")


def test_the_readme_is_short() -> None:
    assert len(README.read_text("utf-8").splitlines()) <= 90


def test_the_figures_of_the_readme_are_up_to_date(make_readme: ModuleType) -> None:
    text = README.read_text("utf-8")
    assert make_readme.filled(text) == text, "README.md is out of date: run python docs/make_readme.py"
    marks = re.findall(r"<!-- (\w+) -->", text)
    assert sorted(marks) == sorted(make_readme.figures())


def test_the_table_of_types_is_up_to_date() -> None:
    make_types = script("make_types")
    assert make_types.page_text() == make_types.PAGE.read_text("utf-8"), (
        "the types of docs/model-card.md are out of date: run python docs/make_types.py"
    )


def test_the_speeds_of_gaits_are_those_of_the_model() -> None:
    text = " ".join((ROOT / "docs" / "paths.md").read_text("utf-8").split())
    ranges = (mk.load_model().speed_range(kind) for kind in ("walking", "b-walking", "running"))
    walk, back, run = (f"{low / 100:.2f} to {high / 100:.2f}" for low, high in ranges)  # type: ignore[misc]
    assert f"walks at {walk} m/s, backwards at {back}, and runs at {run}." in text


def test_the_offsets_of_the_skeleton_are_measured(capsys: pytest.CaptureFixture[str]) -> None:
    script("measure_offsets").main([str(ROOT / "examples" / "data")])
    subjects, difference = re.findall(r"[\d.]+", capsys.readouterr().out)
    assert int(subjects) > 5 and float(difference) < 3.0


def test_figures_of_another_scoreboard(make_readme: ModuleType) -> None:
    shares = {"walking": 1.0, "balance": 0.95, "jumping-r": 0.85}
    said = "1 are shown every time, balance 19 times, jumping-r 17 times"
    assert make_readme.shown_words(shares, 20) == said


def test_the_test_command_is_what_ci_runs() -> None:
    text, run = README.read_text("utf-8"), (ROOT / ".ci" / "run").read_text("utf-8")
    found = re.search(r'`pip install -e "(\S+)" && (python -m pytest -n auto)`', text)
    assert found is not None
    assert f'-e "{found[1]}"' in run and re.search(rf"^{found[2]}( \|\| |$)", run, re.MULTILINE)


def rooms() -> dict[str, str]:
    """The table of rooms in docs/architecture.md, from top to bottom."""
    text = (
        (ROOT / "docs" / "architecture.md").read_text("utf-8").split("\n## The rooms\n")[1].split("\n## ")[0]
    )
    return dict(re.findall(r"^\| `(\w+)` \| (.*) \|$", text, re.MULTILINE))


def test_the_table_of_rooms_has_every_package_and_what_it_says_of_itself() -> None:
    packages = {}
    for path in SOURCE.glob("*/__init__.py"):
        said = ast.get_docstring(ast.parse(path.read_text("utf-8")))
        packages[path.parent.name] = " ".join((said or "").split())
    assert rooms() == packages


def test_rooms_import_from_rooms_above_them() -> None:
    order = list(rooms())
    for place, room in enumerate(order):
        for path in (SOURCE / room).rglob("*.py"):
            used = set(re.findall(r"(?:from|import) motionkit\.(\w+)", path.read_text("utf-8")))
            below = used & set(order[place + 1 :])
            assert not below, f"{room}/{path.name} imports from {', '.join(below)}"
    assert order[-1] == "cli"


def test_contributing_names_what_exists() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    code = "\n".join(
        path.read_text("utf-8") for room in (SOURCE, ROOT / "tests") for path in room.rglob("*.py")
    )
    for name in set(re.findall(r"`([^`\s]+)`", text)):
        if "/" in name:
            places = (ROOT / name, SOURCE / name)
            assert any(place.exists() for place in places), f"CONTRIBUTING.md: no {name}"
        elif re.fullmatch(r"[A-Za-z_]\w+", name):
            assert re.search(rf"\b{name}\b", code), f"CONTRIBUTING.md: nothing is called {name}"


def test_the_changelog_says_nothing_twice() -> None:
    points = re.findall(r"^- .*(?:\n  .*)*", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    beginnings = [" ".join(point.split())[:60] for point in points]
    assert len(points) > 50 and len(set(beginnings)) == len(beginnings)
