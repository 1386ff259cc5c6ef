"""The pages in docs/: the command reference is up to date, everything has help, links and examples work."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import click
import pytest

from motionkit.cli.main import COMMANDS
from motionkit.control.path import read_path
from motionkit.features.control import ControlLayout
from motionkit.features.layout import LAYOUTS, feature_layout
from motionkit.models.network import PartTransformer, parameter_count
from motionkit.models.presets import PRESETS, preset

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(
    [*DOCS.glob("*.md"), *ROOT.glob("*.md"), *ROOT.glob("benchmarks/*.md"), *ROOT.glob("examples/**/*.md")]
)
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
CODE = re.compile(r"```.*?```|`[^`\n]*`", re.DOTALL)


@pytest.fixture(scope="module")
def make_commands() -> ModuleType:
    """docs/make_commands.py as a module."""
    spec = importlib.util.spec_from_file_location("make_commands", DOCS / "make_commands.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def anchor(heading: str) -> str:
    """The anchor that GitHub gives a heading."""
    words = re.sub(r"[^\w\- ]", "", heading.strip().lower())
    return words.replace(" ", "-")


def anchors(page: Path) -> set[str]:
    """The anchors of all headings of a page."""
    return {anchor(line.lstrip("#")) for line in page.read_text("utf-8").splitlines() if line.startswith("#")}


def test_the_command_reference_is_up_to_date(make_commands: ModuleType) -> None:
    assert make_commands.PAGE.read_text("utf-8") == make_commands.page_text(), (
        "docs/commands.md is out of date: run python docs/make_commands.py"
    )


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_and_option_has_help(make_commands: ModuleType, name: str) -> None:
    command = make_commands.subcommand(name)
    assert command.help and command.name == name
    for parameter in command.params:
        if isinstance(parameter, click.Option):
            assert parameter.help and parameter.help.endswith("."), f"{name} {parameter.opts[0]} has no help"
        else:
            # click gives arguments no help of their own; the command's help speaks of them by name.
            assert parameter.human_readable_name.upper() in command.help, f"{name}: {parameter.name}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_relative_links_resolve(page: Path) -> None:
    for target in LINK.findall(CODE.sub("", page.read_text("utf-8"))):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, fragment = target.partition("#")
        place = (page.parent / name).resolve() if name else page
        assert place.exists(), f"{page.name}: {target} leads nowhere"
        if fragment and place.suffix == ".md":
            assert fragment in anchors(place), f"{page.name}: no heading for {target}"


def test_every_page_in_docs_is_linked() -> None:
    linked = set()
    for page in PAGES:
        targets = (target.partition("#")[0] for target in LINK.findall(page.read_text("utf-8")))
        linked |= {(page.parent / name).resolve() for name in targets if name and ":" not in name}
    lonely = [page.name for page in DOCS.glob("[a-z]*.md") if page not in linked]
    assert not lonely, f"no page links to {', '.join(lonely)}"


def blocks(page: Path, language: str) -> list[str]:
    """The fenced blocks of a page in one language."""
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text("utf-8"), re.DOTALL | re.MULTILINE)


def test_the_path_examples_are_paths(tmp_path: Path) -> None:
    (json_text,), (csv_text,) = (blocks(DOCS / "paths.md", language) for language in ("json", "csv"))
    for name, text in (("path.json", json_text), ("path.csv", csv_text)):
        (tmp_path / name).write_text(text, "utf-8")
        types = [part.type for part in read_path(tmp_path / name).parts]
        assert types == ["walking", "cartwheel", "running"]


def test_the_network_page_counts_parameters_right() -> None:
    text = (DOCS / "network.md").read_text("utf-8")
    types = tuple(f"type-{i}" for i in range(21))
    for name in PRESETS:
        config = preset(name)
        count = parameter_count(PartTransformer(config, ControlLayout(types, config.controls).size))
        row = next(line for line in text.splitlines() if line.startswith(f"| `{name}` |"))
        assert f" {count:,} " in row, f"{name} has {count:,} parameters"


def test_the_network_page_counts_columns_right() -> None:
    text = (DOCS / "network.md").read_text("utf-8")
    layouts = [feature_layout(version).blocks for version in LAYOUTS]
    for block in layouts[0]:
        sizes = [layout[block].stop - layout[block].start for layout in layouts]
        assert f"| `{block}` | {sizes[0]} | {sizes[1]} |" in text
