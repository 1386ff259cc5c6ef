"""The figures of docs/how-it-works.md: all are drawn, shown, and follow the colours of the page."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

import motionkit as mk

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.fixture
def make_figures(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """docs/make_figures.py as a module."""
    pytest.importorskip("matplotlib")
    monkeypatch.syspath_prepend(str(DOCS))
    import make_figures

    return make_figures


def test_the_page_shows_every_figure(make_figures: ModuleType) -> None:
    shown = re.findall(r"\(figures/([\w-]+)\.svg\)", (DOCS / "how-it-works.md").read_text("utf-8"))
    assert shown == list(make_figures.FIGURES) and len(shown) == 10
    assert {path.stem for path in (DOCS / "figures").glob("*.svg")} == {*shown, *make_figures.OTHERS}


def test_a_figure_takes_its_colours_from_the_page(make_figures: ModuleType, tmp_path: Path) -> None:
    style = sys.modules["figure_style"]
    for name in ("2-rigs", "4-rotations"):
        figure = make_figures.FIGURES[name](mk.load_model())
        texts = [style.save(figure, name, tmp_path).read_text("utf-8") for _ in range(2)]
        assert texts[0] == texts[1] and "prefers-color-scheme: dark" in texts[0]
        assert "var(--ink)" in texts[0] and not any(color in texts[0] for color in style.VARIABLES)
