"""Shared by commands that show motions: the --view option, and opening a file in the browser."""

from __future__ import annotations

import os
import sys
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from motionkit.view.figure_data import Shown

view_option = click.option(
    "--view", is_flag=True, help="Also write a web page that plays the motion, and open it."
)


def write_and_open(path: Path, shown: Sequence[Shown], quiet: bool) -> Path:
    """Write a viewer file, open it unless quiet, and return its path."""
    from motionkit.view.viewer import write_viewer

    write_viewer(path, shown)
    if not quiet:
        open_in_browser(path.resolve().as_uri())
    return path


def open_in_browser(address: str) -> bool:
    """Open an address in the user's browser; False without a desktop, in CI, or when there is no browser."""
    if not has_desktop():
        return False
    try:
        return webbrowser.open(address)
    except webbrowser.Error:
        return False


def has_desktop() -> bool:
    """Whether a window can appear: False over plain SSH and in CI."""
    if os.environ.get("CI"):
        return False
    if sys.platform in ("win32", "darwin"):
        return not os.environ.get("SSH_CONNECTION")
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
