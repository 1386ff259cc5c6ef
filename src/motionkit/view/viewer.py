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
from motionkit.view.figure_data import MotionView, figure_data

MAX_MOTIONS = 32  # per page


def viewer_page(views: Sequence[MotionView], title: str = "", bare: bool = False) -> str:
    """The HTML of a page that plays the motions; it opens from disk and needs no network.

    bare omits the controls, for a small frame in another page; a click then plays or pauses.

    Raises:
        MotionkitError: there are no motions, or more than 32.
    """
    if not 0 < len(views) <= MAX_MOTIONS:
        raise MotionkitError(f"a viewer file shows 1 to {MAX_MOTIONS} motions, found {len(views)}")
    named = title or " · ".join(one.name for one in views)
    skinned = [one.skinned_character for one in views]
    characters = list(dict.fromkeys(character.tree.file for character in skinned if character))
    motions = [figure_data(one) for one in views]
    for character, motion in zip(skinned, motions, strict=True):
        if character is not None:
            motion["hero"]["file"] = characters.index(character.tree.file)
    data = {
        "title": f"{named} · motionkit",
        "bare": bare,
        "motions": motions,
        "characters": [base64.b64encode(page_bytes(file)).decode() for file in characters],
    }
    return fill_page("view.html", data)


def write_viewer(path: str | Path, views: Sequence[MotionView]) -> None:
    """Write a viewer page, atomically."""
    page = viewer_page(views)
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
