"""Draws names above the heads of figures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from motionkit.view.contact_sheet import load_pillow
from motionkit.view.figure_data import MotionView
from motionkit.view.lettering import lettered
from motionkit.view.surface import Array

if TYPE_CHECKING:
    from PIL import Image

Color = tuple[int, int, int]
SMALLEST = 12  # pixels, smallest font
PAD = 4  # pixels around a name
GAP = 2  # pixels between names
LONGEST = 80  # letters of a name before it is shortened


class Labels:
    """A tag for each motion: its name in a box of its figure's colour."""

    def __init__(self, views: Sequence[MotionView], colors: Sequence[Color], width: int, height: int) -> None:
        image, image_draw, _ = load_pillow()
        size = max(SMALLEST, height // 26)
        most = max(4.0 * size, 0.9 * width / len(views))
        self.width = width
        self.tags = [
            _tag(image, image_draw, size, one.name, color, most)
            for one, color in zip(views, colors, strict=True)
        ]
        self.height = max(tag.height for tag in self.tags) + GAP

    def draw(self, picture: Image.Image, points: Array) -> None:
        """Draw the tags above points (N, 2) in pixels; stack those that overlap."""
        placed: list[tuple[float, float, float, float]] = []
        for n in np.argsort(-points[:, 1], kind="stable"):
            tag = self.tags[n]
            left = float(np.clip(points[n, 0] - tag.width / 2, 0, max(self.width - tag.width, 0)))
            top = float(points[n, 1]) - tag.height
            for box in sorted(placed, key=lambda box: -box[1]):
                if (
                    left < box[2] + GAP
                    and box[0] < left + tag.width + GAP
                    and top < box[3] + GAP
                    and box[1] < top + tag.height + GAP
                ):
                    top = box[1] - GAP - tag.height
            top = float(np.clip(top, 0, picture.height - tag.height))
            placed.append((left, top, left + tag.width, top + tag.height))
            picture.paste(tag, (round(left), round(top)))


def _tag(image: Any, image_draw: Any, size: int, name: str, color: Color, most: float) -> Image.Image:
    pen = image_draw.Draw(image.new("L", (1, 1)))
    words, font = lettered(name or "?", size)
    words, box = _shortened(pen, font, words, most)
    _, line_top, _, line_bottom = _box(pen, font, "Áy")
    tag: Image.Image = image.new(
        "RGB",
        (int(box[2] - box[0]) + 2 * PAD, int(line_bottom - line_top) + PAD),
        tuple(c * 3 // 4 for c in color),
    )
    image_draw.Draw(tag).text((PAD - box[0], PAD // 2 - line_top), words, fill=(255, 255, 255), font=font)
    return tag


def _shortened(pen: Any, font: Any, name: str, most: float) -> tuple[str, tuple[float, ...]]:
    """A name, shortened in the middle to fit, and its bounding box."""
    name = name if len(name) <= LONGEST else f"{name[: LONGEST // 2]}{name[-LONGEST // 2 :]}"
    words, kept = name, len(name)
    while True:
        box = _box(pen, font, words)
        if box[2] - box[0] <= most or kept <= 1:
            return words, box
        kept -= 1
        words = f"{name[: (kept + 1) // 2]}...{name[len(name) - kept // 2 :]}"


def _box(pen: Any, font: Any, words: str) -> tuple[float, ...]:
    box: tuple[float, ...] = pen.textbbox((0, 0), words, font=font)
    return box
