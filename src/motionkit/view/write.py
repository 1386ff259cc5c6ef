"""Motions as a page, a picture or a film: the ending of the file says which."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from motionkit.errors import MotionkitError
from motionkit.motion.motion import Motion
from motionkit.view.figure_data import Shown, shown_motions

SHEET_WIDTH = 1800  # pixels


def write_view(
    path: str | Path, *motions: Motion, names: Sequence[str] = (), width: int | None = None
) -> None:
    """Write motions as a page that plays them (.html), a contact sheet (.png), a GIF or a film (.mp4).

    Args:
        path: the file; its ending says what it is.
        motions: of any rig and rate.
        names: captions; "motion 1", "motion 2" ... by default.
        width: in pixels; by default 1800 for a sheet, 480 for a GIF and 960 for a film.

    Raises MotionkitError for another ending, and without Pillow for pictures (`pip install 'motionkit[view]'`).
    """
    write_shown(path, shown_motions(motions, names or ()), width)


def write_shown(
    path: str | Path,
    shown: Sequence[Shown],
    width: int | None = None,
    poses: int = 12,
    every: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """As write_view, with what is shown of each motion.

    Args:
        poses: of each motion on a contact sheet.
        every: one pose every so many frames instead.
        progress: called with the number of frames of a film drawn and of all frames.
    """
    kind = Path(path).suffix.lower()
    if kind == ".html":
        from motionkit.view.viewer import write_viewer

        write_viewer(path, shown)
    elif kind == ".png":
        from motionkit.view.contact_sheet import write_contact_sheet

        sheet = [(one.name, one.motion) for one in shown]
        write_contact_sheet(path, sheet, poses, width or SHEET_WIDTH, every)
    elif kind in (".gif", ".mp4"):
        from motionkit.view.film import write_film

        write_film(path, shown, width, progress)
    else:
        raise MotionkitError(f"{path}: expected a file that ends with .html, .png, .gif or .mp4")
