"""Writes motions as a page, a picture or a film, depending on the file's ending."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from motionkit.errors import MotionkitError
from motionkit.motion.motion import Motion
from motionkit.view.figure_data import MotionView, motion_views

SHEET_WIDTH = 1800  # pixels, default width of a contact sheet


def write_view(
    path: str | Path, *motions: Motion, names: Sequence[str] = (), width: int | None = None
) -> None:
    """Write motions as a page that plays them (.html), a contact sheet (.png), a GIF or a film (.mp4).

    Args:
        path: file to write; its ending chooses the kind.
        motions: motions of any rig and frame rate.
        names: titles; by default "motion 1", "motion 2" ...
        width: in pixels; by default 1800 for a sheet, 480 for a GIF and 960 for a film.

    Raises MotionkitError for other endings, and for pictures without Pillow (`pip install 'motionkit[view]'`).
    """
    write_views(path, motion_views(motions, names or ()), width)


def write_views(
    path: str | Path,
    views: Sequence[MotionView],
    width: int | None = None,
    poses: int = 12,
    every: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Like write_view, for motions with names, types and paths; poses and every as for contact_sheet.

    progress is called with the number of film frames drawn and the number of all frames.
    """
    kind = Path(path).suffix.lower()
    if kind == ".html":
        from motionkit.view.viewer import write_viewer

        write_viewer(path, views)
    elif kind == ".png":
        from motionkit.view.contact_sheet import write_contact_sheet

        sheet = [(one.name, one.motion) for one in views]
        write_contact_sheet(path, sheet, poses, width or SHEET_WIDTH, every)
    elif kind in (".gif", ".mp4"):
        from motionkit.view.film import write_film

        write_film(path, views, width, progress)
    else:
        raise MotionkitError(f"{path}: expected a file that ends with .html, .png, .gif or .mp4")
