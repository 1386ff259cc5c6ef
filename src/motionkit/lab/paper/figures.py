"""Results as PNG pictures: training curves, BM against AFS, and the time a frame takes against the number of parts."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from motionkit.errors import MotionkitError
from motionkit.features.control import ControlLayout
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.files import atomic_write
from motionkit.lab.paper.tables import Results, figure_of, in_folder, named, names_of
from motionkit.lab.paper.variants import variant
from motionkit.models.architectures import build
from motionkit.models.presets import preset

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 960, 600, 90, 220, 50, 60
COLOURS = ("#1f5fa8", "#c44e24", "#2e8b57", "#7b4fa3", "#b08900", "#3a9fbf", "#b0305c", "#555555")
PARTS = ("EBTN", "TPTN", "FPTN-R", "5PTN")


@dataclass(frozen=True)
class Series:
    """Points (x, y) with a name; a line if joined, else dots with their names."""

    name: str
    points: tuple[tuple[float, float], ...]
    joined: bool = True


def write_figures(results: Results, folder: Path) -> list[Path]:
    """Draw all figures of every data set and budget into a folder. Raises MotionkitError without Pillow."""
    out = []
    for name in sorted({result["folder"] for result in results}):
        here = in_folder(results, name)
        stem = name.replace("/", "-")
        curves = _curves(here)
        if curves:
            axes = ("training step", "total loss")
            out.append(_chart(folder / f"{stem}-curves.png", f"Training curves, {name}", axes, curves))
        dots = _movement(here)
        if dots:
            axes = ("AFS (cm/frame)", "BM (deg/frame)")
            out.append(
                _chart(folder / f"{stem}-bm-afs.png", f"Body movement against sliding, {name}", axes, dots)
            )
    speed = (Series("TPTN and its partitions", tuple(parts_speed())),)
    axes = ("body parts", "milliseconds a frame")
    out.append(_chart(folder / "speed-parts.png", "Inference, one character, one thread", axes, speed))
    return out


def _curves(results: Results) -> tuple[Series, ...]:
    """The curves of networks with the paper's losses, whose totals mean the same."""
    chosen = [r for r in results if "curve" in r and r["group"] != "baselines" and r["seed"] == 0]
    return tuple(Series(r["name"], tuple((x, y) for x, y in r["curve"])) for r in chosen)


def _movement(results: Results) -> tuple[Series, ...]:
    out = []
    for name in names_of(results):
        mine = named(results, name)
        sliding, moving = figure_of(mine, "afs"), figure_of(mine, "bm-euler")
        if sliding and moving:
            out.append(Series(name, ((sliding.mean, moving.mean),), joined=False))
    sliding, moving = (figure_of(results, metric, recorded=True) for metric in ("afs", "bm-euler"))
    if sliding and moving:
        out.append(Series("recorded", ((sliding.mean, moving.mean),), joined=False))
    return tuple(out)


def parts_speed(frames: int = 20) -> list[tuple[float, float]]:
    """Return number of parts and milliseconds a frame of networks with random weights, all in one run.

    Speed does not depend on what was learnt. Each frame computes the receptive field anew, as the paper's does.
    """
    out = []
    for name in PARTS:
        each = variant(name)
        config = preset(each.preset, **each.config)
        size = ControlLayout(tuple(map(str, range(21))), config.controls).size
        network = build(config, size).eval()
        stream = network.stream(1)
        row = [torch.zeros(1, n) for n in (FEATURE_COUNT, CONTACT_COUNT, size)]
        with torch.inference_mode():
            for _ in range(config.receptive_field):  # fills the window
                stream.step(*row)
            began = time.perf_counter()
            for _ in range(frames):
                stream.step(*row)
        out.append((float(len(network.body.parts)), 1000.0 * (time.perf_counter() - began) / frames))  # type: ignore[arg-type,union-attr]
    return out


def _chart(path: Path, title: str, axes: tuple[str, str], series: Sequence[Series]) -> Path:
    """Draw series into a PNG."""
    try:
        from PIL import Image, ImageDraw
    except ModuleNotFoundError:
        raise MotionkitError("figures need Pillow: pip install 'motionkit[view]'") from None
    xs, ys = zip(*(point for each in series for point in each.points), strict=True)
    spans = [_span(xs), _span(ys)]
    image = Image.new("RGB", (WIDTH, HEIGHT), "white")
    draw = ImageDraw.Draw(image)
    draw.text((LEFT, 16), title, fill="black", font_size=20)

    def place(x: float, y: float) -> tuple[float, float]:
        (x0, x1), (y0, y1) = spans
        across = (x - x0) / (x1 - x0) * (WIDTH - LEFT - RIGHT)
        return LEFT + across, HEIGHT - BOTTOM - (y - y0) / (y1 - y0) * (HEIGHT - TOP - BOTTOM)

    _axes(draw, spans, axes, place)
    for number, each in enumerate(series):
        colour = COLOURS[number % len(COLOURS)]
        points = [place(x, y) for x, y in each.points]
        if each.joined and len(points) > 1:
            draw.line(points, fill=colour, width=2)
        for x, y in points if not each.joined or len(points) < 10 else []:
            draw.ellipse((x - 4, y - 4, x + 4, y + 4), fill=colour)
        y = TOP + 20 * number
        draw.rectangle((WIDTH - RIGHT + 20, y + 4, WIDTH - RIGHT + 32, y + 16), fill=colour)
        draw.text((WIDTH - RIGHT + 40, y), each.name, fill="black", font_size=15)
    with atomic_write(path, "wb") as file:
        image.save(file, format="PNG")
    return path


def _span(values: Sequence[float]) -> tuple[float, float]:
    low, high = min(values), max(values)
    room = 0.06 * (high - low) or 0.5 * abs(high) or 1.0
    return low - room, high + room


def _axes(draw: ImageDraw, spans: list[tuple[float, float]], names: tuple[str, str], place) -> None:
    (x0, x1), (y0, y1) = spans
    for i in range(6):
        x, y = x0 + (x1 - x0) * i / 5, y0 + (y1 - y0) * i / 5
        px, py = place(x, y)
        draw.line((LEFT, py, WIDTH - RIGHT, py), fill="#dddddd")
        draw.text((LEFT - 8, py), f"{y:.3g}", fill="black", anchor="rm", font_size=14)
        draw.text((px, HEIGHT - BOTTOM + 8), f"{x:.3g}", fill="black", anchor="mt", font_size=14)
    draw.line((LEFT, TOP, LEFT, HEIGHT - BOTTOM, WIDTH - RIGHT, HEIGHT - BOTTOM), fill="black")
    draw.text(((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 12), names[0], fill="black", anchor="mb", font_size=15)
    draw.text((LEFT - 70, TOP - 8), names[1], fill="black", anchor="lb", font_size=15)
