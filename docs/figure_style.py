"""How the figures of docs/how-it-works.md look, and how they are saved: SVG that follows the page's colours."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from motionkit.arrays import Array
from motionkit.motion.skeleton import Skeleton, canonical_skeleton

matplotlib.use("Agg")

FOLDER = Path(__file__).resolve().parent / "figures"
WIDTH = 7.4  # inches, about the width of a page's text
# Colours that change with the page are written as variables of CSS; each has a stand-in while matplotlib draws.
INK, SOFT, FAINT = "#010203", "#010204", "#010205"
VARIABLES = {INK: "var(--ink)", SOFT: "var(--soft)", FAINT: "var(--faint)"}
STYLE = """<style>
:root { --ink: #1d2126; --soft: #6b727b; --faint: #d5d8dc; }
@media (prefers-color-scheme: dark) { :root { --ink: #e8eaed; --soft: #9aa1a9; --faint: #3c4148; } }
</style>"""
# These are read on light and on dark pages; left and right are the viewer's colours.
LEFT, RIGHT, GREEN, PINK, VIOLET = "#3d8bd9", "#e08433", "#2f9e6e", "#d9558f", "#8b6fd6"
matplotlib.rcParams.update(
    {
        "svg.fonttype": "none",
        "svg.hashsalt": "motionkit",
        "font.family": "DejaVu Sans",
        "font.size": 8.5,
        "text.color": INK,
        "axes.edgecolor": SOFT,
        "axes.labelcolor": INK,
        "axes.titlesize": 9,
        "axes.titlelocation": "left",
        "axes.spines.top": False,
        "axes.spines.right": False,
        "xtick.color": SOFT,
        "ytick.color": SOFT,
        "lines.linewidth": 1.4,
        "legend.frameon": False,
        "figure.constrained_layout.use": True,
    }
)


def new_figure(height: float, rows: int = 1, columns: int = 1, **options: Any) -> tuple[Figure, Any]:
    """A figure of a page's width without a background, and its axes."""
    figure = Figure(figsize=(WIDTH, height), facecolor="none")
    axes = figure.subplots(rows, columns, **options)
    for one in np.atleast_1d(axes).flat:
        one.set_facecolor("none")
    return figure, axes


def save(figure: Figure, name: str, folder: Path = FOLDER) -> Path:
    """Write a figure; one that has not changed is written with the same bytes."""
    text = io.StringIO()
    figure.savefig(text, format="svg", transparent=True, metadata={"Date": None})
    svg = text.getvalue()
    for stand_in, variable in VARIABLES.items():
        svg = svg.replace(stand_in, variable)
    svg = re.sub(r"(<svg [^>]*>)", lambda tag: tag[1] + STYLE, svg, count=1)
    svg = re.sub(r"\d+\.\d{3,}", lambda number: f"{float(number[0]):.2f}", svg)
    ids = dict.fromkeys(re.findall(r"url\(#(p[0-9a-f]{10})\)", svg))  # of clip paths, another one at each run
    for number, name_of in enumerate(ids):
        svg = svg.replace(name_of, f"clip{number}")
    svg = svg.replace("'DejaVu Sans'", "'DejaVu Sans', Verdana, sans-serif")
    path = folder / f"{name}.svg"
    folder.mkdir(exist_ok=True)
    path.write_text(svg, encoding="utf-8")
    return path


def side_color(name: str) -> str:
    """The colour of a joint by its side."""
    return LEFT if name.startswith("Left") else RIGHT if name.startswith("Right") else SOFT


def draw_body(
    axes: Axes,
    places: Array,
    at: float = 0.0,
    color: str | None = None,
    width: float = 1.6,
    alpha: float = 1.0,
    skeleton: Skeleton | None = None,
) -> None:
    """Draw joints (J, 2), across and up, as a stick figure shifted sideways by `at`; sides are coloured by default.

    skeleton is the canonical one by default.
    """
    skeleton = skeleton or canonical_skeleton()
    # The middle of the body is drawn last, over the collar bones.
    for middle in (False, True):
        for joint, parent in enumerate(skeleton.parents):
            own = side_color(skeleton.names[joint])
            if parent >= 0 and (own == SOFT) is middle:
                ends = places[[parent, joint]]
                axes.plot(
                    ends[:, 0] + at,
                    ends[:, 1],
                    color=color or own,
                    lw=width,
                    alpha=alpha,
                    solid_capstyle="round",
                )


def plain(axes: Axes, equal: bool = True) -> None:
    """Leave out frame and ticks, with equal scales by default."""
    axes.set_axis_off()
    if equal:
        axes.set_aspect("equal")


def box(axes: Axes, x: float, y: float, text: str, size: tuple[float, float], color: str = SOFT) -> None:
    """A rounded box around a text, with its centre at x, y."""
    width, height = size
    corner = (x - width / 2, y - height / 2)
    axes.add_patch(
        FancyBboxPatch(corner, width, height, "round,pad=0,rounding_size=0.12", fc="none", ec=color)
    )
    axes.text(x, y, text, ha="center", va="center", linespacing=1.35)


def arrow(
    axes: Axes, start: tuple[float, float], end: tuple[float, float], color: str = SOFT, bend: float = 0.0
) -> None:
    """An arrow from start to end."""
    style = f"arc3,rad={bend}"
    axes.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": color, "connectionstyle": style})
