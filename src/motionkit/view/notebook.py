"""Shows motions in a notebook: the viewer in an HTML cell."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass

from motionkit.errors import MotionkitError
from motionkit.motion.motion import Motion
from motionkit.view.figure_data import motion_views
from motionkit.view.viewer import viewer_page

MOST_HEIGHT = 2000  # pixels


@dataclass(frozen=True)
class Player:
    """A page that plays motions; a notebook shows it as the result of a cell.

    Attributes:
        page: the HTML document; needs no network.
        height: height of the frame in pixels.
    """

    page: str
    height: int

    def _repr_html_(self) -> str:
        """The page for Jupyter, in an iframe, so that neither can disturb the other."""
        return (
            f'<iframe srcdoc="{html.escape(self.page, quote=True)}" title="motionkit player" '
            f'style="width: 100%; height: {self.height}px; border: 0" sandbox="allow-scripts"></iframe>'
        )


def show(*motions: Motion, names: Sequence[str] = (), height: int = 420, controls: bool = False) -> Player:
    """Play motions in a notebook cell, side by side.

    Args:
        motions: motions of any rig, unit and frame rate; 1 to 32.
        names: titles; by default "motion 1", "motion 2" ...
        height: height of the cell in pixels.
        controls: show the timeline and buttons of `motionkit view`; without them, a click plays and pauses.

    Raises:
        MotionkitError: no motions or more than 32, a wrong number of names, or a height out of range.
    """
    views = motion_views(motions, names)
    if not 50 <= height <= MOST_HEIGHT:
        raise MotionkitError(f"expected a height of 50 to {MOST_HEIGHT} pixels, found {height}")
    return Player(viewer_page(views, bare=not controls), height)
