"""Viewer pages: a self-contained HTML file that plays its motions."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from motionkit.errors import MotionkitError
from motionkit.files import atomic_write
from motionkit.view.character_data import page_bytes
from motionkit.view.figure_data import Shown, figure_data

MAX_MOTIONS = 32  # per page


def viewer_page(shown: Sequence[Shown], title: str = "", bare: bool = False) -> str:
    """The HTML of a page that plays the motions; it opens from disk and needs no network.

    bare omits the controls, for a small frame in another page; a click then plays or pauses.

    Raises:
        MotionkitError: there are no motions, or more than 32.
    """
    if not 0 < len(shown) <= MAX_MOTIONS:
        raise MotionkitError(f"a viewer file shows 1 to {MAX_MOTIONS} motions, found {len(shown)}")
    named = title or " · ".join(one.name for one in shown)
    heroes = [one.hero for one in shown]
    characters = list(dict.fromkeys(hero.tree.file for hero in heroes if hero))
    motions = [figure_data(one) for one in shown]
    for hero, motion in zip(heroes, motions, strict=True):
        if hero is not None:
            motion["hero"]["file"] = characters.index(hero.tree.file)
    data = {
        "title": f"{named} · motionkit",
        "bare": bare,
        "motions": motions,
        "characters": [base64.b64encode(page_bytes(file)).decode() for file in characters],
    }
    return fill_page("view.html", data)


def write_viewer(path: str | Path, shown: Sequence[Shown], title: str = "") -> None:
    """Write a viewer page, atomically."""
    page = viewer_page(shown, title)
    with atomic_write(path) as file:
        file.write(page)


def fill_page(name: str, data: dict[str, Any]) -> str:
    """A built page, filled with its data."""
    # Escape "<", so that no name can close the data's script element.
    text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    return page_asset(name).replace("__DATA__", text)


def page_asset(name: str) -> str:
    """A built page of the package (web/README.md explains how to build it)."""
    return (files("motionkit") / "assets" / "web" / name).read_text("utf-8")
