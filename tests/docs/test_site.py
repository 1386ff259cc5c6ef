"""The site of docs/: it builds without warnings, and its generated pages have what they should."""

from __future__ import annotations

import importlib.util
import re
import shlex
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import click
import pytest

import motionkit
from motionkit.cli.main import cli
from motionkit.models.bundled import load_bundled_model
from synthetic_motions import make_walk

pytestmark = pytest.mark.thorough

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"


def module(name: str) -> ModuleType:
    """A script of docs as a module."""
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    assert spec is not None and spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    sys.modules[name] = loaded
    spec.loader.exec_module(loaded)
    return loaded


def pages() -> list[Path]:
    """The pages of the site that are not generated."""
    return [path for path in DOCS.glob("[a-z]*.md") if path.name not in module("conf").REPOSITORY_PAGES]


def test_the_menu_has_every_page_once() -> None:
    pytest.importorskip("latex2mathml")
    conf = module("conf")
    menu = conf.menu(conf.site_links((DOCS / "index.md").read_text("utf-8")))
    listed = re.findall(r"^[\w/-]+$", menu, re.MULTILINE)
    generated = [f"_generated/{name.removesuffix('.md')}" for name in conf.MADE_BY.values()]
    assert sorted(listed) == sorted([*generated, *(path.stem for path in pages() if path.stem != "index")])
    assert menu.count(":caption: ") == 6


def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    for needed in ("sphinx", "myst_parser", "furo", "latex2mathml"):
        pytest.importorskip(needed)
    words = [
        "-m",
        "sphinx",
        "-W",
        "--keep-going",
        "-q",
        "-D",
        "motionkit_gallery=0",
        str(DOCS),
        str(tmp_path),
    ]
    done = subprocess.run(
        [sys.executable, *words, "-d", str(tmp_path / "trees")], capture_output=True, text=True, timeout=170
    )
    assert done.returncode == 0, done.stderr
    written = {path.stem for path in tmp_path.glob("*.html")} - {"genindex", "search", "py-modindex"}
    assert written == {path.stem for path in pages()}
    api = (tmp_path / "_generated" / "api.html").read_text("utf-8")
    assert all(f'id="motionkit.{name}"' in api for name in motionkit.__all__ if name != "__version__")
    assert "http://" not in (tmp_path / "_static" / "site.css").read_text("utf-8")


def test_the_site_has_the_demo_itself_in_place_of_its_picture() -> None:
    pytest.importorskip("latex2mathml")
    conf = module("conf")
    text = (DOCS / "demo.md").read_text("utf-8")
    assert conf.DEMO_PICTURE in text
    for shown in (True, False):
        source = [text]
        conf.read_page(SimpleNamespace(config=SimpleNamespace(motionkit_gallery=shown)), "demo", source)
        assert ("<iframe" in source[0]) is shown and ("demo.png" in source[0]) is not shown


def test_links_of_the_site(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("latex2mathml")
    conf = module("conf")
    monkeypatch.setattr(conf, "REPOSITORY", "")
    kept = "[c](live.md#safety) ![e](live.png)"
    text = f"[a](../CONTRIBUTING.md) [api.py](../src/motionkit/api.py) [b](scoreboard.md) {kept}"
    assert conf.site_links(text) == f"a `src/motionkit/api.py` b {kept}"
    assert (
        conf.site_links("[live.md](live.md) [d](https://x.org)")
        == "[Steer it live](live.md) [d](https://x.org)"
    )
    monkeypatch.setattr(conf, "REPOSITORY", "https://example.org/m")
    there = "https://example.org/m/blob/main"
    assert conf.site_links(text) == (
        f"[a]({there}/CONTRIBUTING.md) [`src/motionkit/api.py`]({there}/src/motionkit/api.py) "
        f"[b]({there}/docs/scoreboard.md) {kept}"
    )


def test_the_gallery_has_a_command_for_every_type(monkeypatch: pytest.MonkeyPatch) -> None:
    gallery = module("make_gallery")
    loops = gallery.loops()
    types = [loop.name for loop in loops if loop.section == "Types"]
    assert types == list(load_bundled_model().types)
    assert len({loop.key for loop in loops}) == len(loops)
    monkeypatch.chdir(ROOT)  # rigs are named from there
    for loop in loops:
        name, *words = shlex.split(loop.words)
        command = cli.get_command(click.Context(cli), name)
        assert command is not None
        command.make_context(name, words)
    page = gallery._page(loops)
    assert all(f"motionkit {loop.words}</pre>" in page for loop in loops)


def test_the_gallery_is_written(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    gallery = module("make_gallery")
    made = [gallery.Loop("Walk", "Types", "synthesize --types walking:0.5"), gallery.loops()[-1]]
    monkeypatch.setattr(gallery, "loops", lambda: made)
    monkeypatch.setattr(gallery, "_make", lambda loop: gallery.MotionView(loop.name, make_walk(20)))
    gallery.make_gallery(tmp_path)
    scripts = tmp_path / "static" / "gallery"
    assert all(f'data-loop="{loop.key}"' in (tmp_path / "gallery.md").read_text("utf-8") for loop in made)
    assert "loopData(" in (scripts / f"{made[1].key}.js").read_text("utf-8")
    assert '"joints":["Hips"' in (scripts / "player.js").read_text("utf-8").split("RIG = ")[1]


def test_a_loop_is_what_its_command_makes() -> None:
    gallery = module("make_gallery")
    shown = gallery._make(gallery.Loop("Walk", "Types", "synthesize --types walking:0.5"))
    assert shown.name == "Walk" and len(shown.motion) == 30
