"""Draws contact sheets: one picture that sums up a motion.

Each clip has stick figures over time, the root's path and footprints from above, and curves of foot and root heights.
Pillow draws at twice the size, and the picture is then reduced for smooth lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import spans
from motionkit.errors import MotionkitError
from motionkit.files import atomic_write
from motionkit.metrics.report import sliding_words
from motionkit.motion.motion import Motion
from motionkit.names import counted
from motionkit.view.contact_sheet_geometry import (
    HEAD_RADIUS,
    Figure,
    camera_angle,
    low_frames,
    motion_figure,
    screen_points,
    sliding_frames,
)
from motionkit.view.lettering import lettered

if TYPE_CHECKING:
    from PIL import Image

ZOOM = 2  # drawing scale before the picture is reduced
MARGIN = 16  # pixels, like the following sizes
TITLE_HEIGHT = 30
FIGURE_HEIGHT = 240
PLOT_HEIGHT = 240
PATH_WIDTH = 380
WORDS_APART = 40  # between the places of start and end that have a word each
POSES_PER_ROW = 16
MAX_POSES = 480  # stick figures per clip; more would make the picture too large
OVERLAP = 1.6  # width of the widest pose as a share of its cell; neighbours are usually narrower

Color = tuple[int, int, int]
SIDE_COLORS: dict[str, Color] = {"left": (31, 99, 214), "right": (219, 84, 20), "": (60, 60, 66)}
SLIDE_COLOR: Color = (214, 0, 90)
ROOT_COLOR: Color = (40, 140, 70)
INK: Color = (30, 30, 34)
FAINT: Color = (150, 150, 156)
GRID: Color = (224, 224, 228)
GROUND: Color = (120, 100, 80)
WHITE: Color = (255, 255, 255)


@dataclass(frozen=True)
class _Box:
    """A rectangle on the sheet, in final pixels."""

    left: float
    top: float
    width: float
    height: float


class _Canvas:
    """Draws lines, dots and text in final pixels, ZOOM times enlarged."""

    def __init__(self, width: int, height: int) -> None:
        image, image_draw, _ = load_pillow()
        self.image: Image.Image = image.new("RGB", (width * ZOOM, height * ZOOM), WHITE)
        self._draw = image_draw.Draw(self.image)

    def line(self, points: Sequence[Sequence[float]], color: Color, width: float = 1.0) -> None:
        scaled = [(float(p[0]) * ZOOM, float(p[1]) * ZOOM) for p in points]
        self._draw.line(scaled, fill=color, width=max(1, round(width * ZOOM)), joint="curve")

    def dot(
        self, x: float, y: float, radius: float, fill: Color | None = None, outline: Color | None = None
    ) -> None:
        box = ((x - radius) * ZOOM, (y - radius) * ZOOM, (x + radius) * ZOOM, (y + radius) * ZOOM)
        self._draw.ellipse(box, fill=fill, outline=outline, width=round(1.6 * ZOOM))

    def box(self, box: _Box, fill: Color | None = None, outline: Color | None = None) -> None:
        corners = (box.left, box.top, box.left + box.width, box.top + box.height)
        self._draw.rectangle(tuple(c * ZOOM for c in corners), fill=fill, outline=outline, width=ZOOM)

    def text(
        self, x: float, y: float, words: str, color: Color = INK, size: float = 12, anchor: str = "la"
    ) -> None:
        """Draw text at (x, y), aligned by its anchor ("la" left top, "ma" middle top, "rm" right middle ...)."""
        words, font = lettered(words, size * ZOOM)
        try:
            self._draw.text((x * ZOOM, y * ZOOM), words, fill=color, font=font, anchor=anchor)
        except ValueError:  # without FreeType, Pillow has only a small font without anchors
            self._draw.text((x * ZOOM, y * ZOOM), words, fill=color, font=font)

    def finished(self) -> Image.Image:
        image, _, _ = load_pillow()
        size = (self.image.width // ZOOM, self.image.height // ZOOM)
        return self.image.resize(size, image.Resampling.BOX)


def load_pillow() -> tuple[Any, Any, Any]:
    """Import Pillow's Image, ImageDraw and ImageFont; raises MotionkitError if Pillow is not installed."""
    try:
        from PIL import Image, ImageDraw, ImageFont
    except ImportError:
        raise MotionkitError(
            'drawing needs Pillow, which is not installed: pip install "motionkit[view]"'
        ) from None
    return Image, ImageDraw, ImageFont


def pose_frames(frames: int, poses: int = 12, every: int | None = None) -> list[int]:
    """The frames to draw: `poses` frames evenly spaced from first to last, or one in `every` frames.

    Raises:
        MotionkitError: poses or every is below 1, or there are more than 480 poses.
    """
    if (every is not None and every < 1) or poses < 1:
        raise MotionkitError("a contact sheet needs poses and every of at least 1")
    if every is not None:
        chosen = list(range(0, frames, every))
    else:
        chosen = sorted({int(f) for f in np.linspace(0, frames - 1, min(poses, frames)).round()})
    if len(chosen) > MAX_POSES:
        raise MotionkitError(
            f"{len(chosen)} poses of one clip do not fit on a sheet, expected at most {MAX_POSES}"
        )
    return chosen


def contact_sheet(
    motions: Sequence[tuple[str, Motion]], poses: int = 12, width: int = 1800, every: int | None = None
) -> Image.Image:
    """Draw a contact sheet with a block for each motion, of any rig and unit.

    Args:
        motions: titles and motions; at least one.
        poses: stick figures per clip, evenly spaced in time.
        width: width of the picture in pixels, at least 600.
        every: frames between stick figures; replaces poses.

    Returns:
        A PIL image.

    Raises:
        MotionkitError: Pillow is not installed, there are no motions, or the poses do not fit.
    """
    if not motions:
        raise MotionkitError("a contact sheet needs at least one motion")
    if width < 600:
        raise MotionkitError(f"a contact sheet {width} pixels wide is unreadable, expected at least 600")
    load_pillow()
    chosen = [pose_frames(len(motion), poses, every) for _, motion in motions]
    heights = [_block_height(len(frames)) for frames in chosen]
    canvas = _Canvas(width, sum(heights) + MARGIN)
    top = float(MARGIN)
    for (title, motion), frames, height in zip(motions, chosen, heights, strict=True):
        box = _Box(MARGIN, top, width - 2 * MARGIN, height)
        _draw_block(canvas, title, motion_figure(motion), sliding_words(motion), frames, box)
        top += height
    return canvas.finished()


def write_contact_sheet(
    path: str | Path,
    motions: Sequence[tuple[str, Motion]],
    poses: int = 12,
    width: int = 1800,
    every: int | None = None,
) -> None:
    """Write a contact sheet as PNG, atomically; arguments and errors as for contact_sheet."""
    if Path(path).suffix.lower() != ".png":
        raise MotionkitError(f"{path}: a contact sheet is a .png file, found {Path(path).suffix!r}")
    picture = contact_sheet(motions, poses, width, every)
    from PIL.PngImagePlugin import PngInfo

    facts = PngInfo()
    facts.add_text("Software", "motionkit")
    with atomic_write(path, "wb") as file:
        picture.save(file, format="PNG", pnginfo=facts)


def _pose_rows(poses: int) -> int:
    return -(-poses // POSES_PER_ROW)


def _block_height(poses: int) -> int:
    return TITLE_HEIGHT + _pose_rows(poses) * FIGURE_HEIGHT + PLOT_HEIGHT + 2 * MARGIN


def _draw_block(
    canvas: _Canvas, title: str, figure: Figure, slides: str, frames: list[int], box: _Box
) -> None:
    unit, cm = figure.unit()
    count = len(figure.positions)
    facts = f"{counted(count, 'frame')}, {figure.fps:g} fps, {count / figure.fps:.1f} s, lengths in {unit}"
    canvas.box(_Box(box.left, box.top, box.width, TITLE_HEIGHT - 6), fill=(238, 240, 244))
    canvas.text(box.left + 8, box.top + 3, title, size=15)
    _draw_legend(canvas, box.left + box.width - 8, box.top + 5, facts)
    rows = _pose_rows(len(frames))
    per_row = -(-len(frames) // rows)
    angle = camera_angle(figure)
    top = box.top + TITLE_HEIGHT
    for row in range(rows):
        chosen = frames[row * per_row : (row + 1) * per_row]
        _draw_poses(
            canvas, figure, chosen, frames, per_row, angle, _Box(box.left, top, box.width, FIGURE_HEIGHT)
        )
        top += FIGURE_HEIGHT
    top += MARGIN / 2
    path_width = min(PATH_WIDTH, 0.4 * box.width)
    _draw_path(canvas, figure, frames, angle, cm, _Box(box.left, top, path_width, PLOT_HEIGHT))
    rest = _Box(box.left + path_width + 54, top, box.width - path_width - 60, PLOT_HEIGHT)
    _draw_heights(canvas, figure, frames, cm, rest)
    canvas.text(rest.left + rest.width, top, slides, SLIDE_COLOR, size=11, anchor="ra")


def _draw_legend(canvas: _Canvas, right: float, top: float, facts: str) -> None:
    canvas.text(right, top, facts, size=12, anchor="ra")
    x = right - 400
    for words, color in (
        ("spine", SIDE_COLORS[""]),
        ("right", SIDE_COLORS["right"]),
        ("left", SIDE_COLORS["left"]),
    ):
        canvas.text(x, top, words, color, size=12, anchor="ra")
        x -= 45


def _lighter(color: Color, share: float) -> Color:
    r, g, b = (round(c + (255 - c) * share) for c in color)
    return r, g, b


def _draw_poses(
    canvas: _Canvas,
    figure: Figure,
    frames: list[int],
    all_frames: list[int],
    per_row: int,
    angle: float,
    box: _Box,
) -> None:
    """Draw figures side by side, each centred on its root, on a common ground line and scale."""
    screen = screen_points(figure.positions[all_frames], angle)
    roots = screen_points(figure.root[all_frames], angle)
    drawn = sorted({point for bone in figure.bones for point in bone} | {figure.hips})
    half = max(float(np.abs(screen[:, drawn, 0] - roots[:, None, 0]).max()), 1e-6)
    top = max(float(screen[..., 1].max()), figure.floor + 0.5 * figure.stature)
    bottom = min(float(screen[..., 1].min()), figure.floor)
    cell = box.width / (per_row + OVERLAP - 1.0)
    first = box.left + cell * OVERLAP / 2
    room = box.height - 40
    scale = min(OVERLAP * cell / (2 * half), room / (top - bottom))
    ground = box.top + 10 + room - (figure.floor - bottom) * scale
    canvas.line([(box.left, ground), (box.left + box.width, ground)], GROUND, 1.2)
    for slot, frame in enumerate(frames):
        centre = first + slot * cell
        n = all_frames.index(frame)
        x = centre + (screen[n, :, 0] - roots[n, 0]) * scale
        y = ground - (screen[n, :, 1] - figure.floor) * scale
        _draw_figure(canvas, figure, np.stack([x, y, screen[n, :, 2]], axis=-1), scale)
        label = f"{frame}  {frame / figure.fps:.2f} s"
        canvas.text(centre, box.top + box.height - 16, label, FAINT, size=11, anchor="ma")


def _draw_figure(canvas: _Canvas, figure: Figure, points: NDArray[np.float64], scale: float) -> None:
    """Draw one pose from back to front, with distant bones paler."""
    if not figure.bones:
        canvas.dot(points[0, 0], points[0, 1], 3.0, SIDE_COLORS[""])
        return
    depth = {bone: float(points[list(bone), 2].mean()) for bone in figure.bones}
    near, far = max(depth.values()), min(depth.values())
    head = max(3.0, HEAD_RADIUS * figure.stature * scale)
    order: list[tuple[float, tuple[int, int] | None]] = [(d, bone) for bone, d in depth.items()]
    if figure.skull is not None:
        order.append((float(points[figure.skull, 2]) + 1e-6, None))
    for where, bone in sorted(order, key=lambda item: item[0]):
        pale = 0.45 * (near - where) / max(near - far, 1e-9)
        if bone is None:
            assert figure.skull is not None
            canvas.dot(
                points[figure.skull, 0],
                points[figure.skull, 1],
                head,
                _lighter(SIDE_COLORS[""], 0.7),
                SIDE_COLORS[""],
            )
            continue
        side = figure.sides[bone[1]]
        canvas.line(points[list(bone), :2].tolist(), _lighter(SIDE_COLORS[side], pale), 3.2 if side else 4.0)


def _round_length(value: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above value."""
    power = 10.0 ** np.floor(np.log10(max(value, 1e-9)))
    return float(power * max(m for m in (1, 2, 5) if m * power <= value * (1 + 1e-9)))


def _draw_path(
    canvas: _Canvas, figure: Figure, frames: list[int], angle: float, cm: float, box: _Box
) -> None:
    """Draw the root's path from above, with ticks for its heading, and each foot's low positions."""
    canvas.box(box, outline=GRID)
    canvas.text(box.left + 6, box.top + 4, "from above: root, facing, footprints", FAINT, size=11)
    tracks = [figure.root, *(figure.positions[:, foot] for foot in figure.feet.values())]
    flat = [screen_points(track, angle)[:, [0, 2]] for track in tracks]
    everything = np.concatenate(flat)
    low, high = everything.min(axis=0), everything.max(axis=0)
    span = np.maximum(high - low, 0.6 * figure.stature)
    scale = float(min((box.width - 40) / span[0], (box.height - 66) / span[1]))
    middle = (low + high) / 2

    def place(points: NDArray[np.float64]) -> NDArray[np.float64]:
        centre = np.array([box.left + box.width / 2, box.top + box.height / 2 - 4])
        return centre + (points - middle) * scale

    for (side, foot), track in zip(figure.feet.items(), flat[1:], strict=True):
        _draw_footprints(canvas, figure, place(track), foot, SIDE_COLORS[side])
    root = place(flat[0])
    canvas.line(root.tolist(), ROOT_COLOR, 2.0)
    for frame in frames:
        turn = figure.facing[frame] - angle
        tip = root[frame] + 13 * np.array([np.cos(turn), np.sin(turn)])
        canvas.line([root[frame].tolist(), tip.tolist()], INK, 1.2)
        canvas.dot(root[frame][0], root[frame][1], 2.0, INK)
    canvas.dot(root[0][0], root[0][1], 5.0, WHITE, ROOT_COLOR)
    canvas.dot(root[-1][0], root[-1][1], 5.0, ROOT_COLOR)
    apart = len(root) > 1 and float(np.abs(root[-1] - root[0]).max()) > WORDS_APART
    words = "start" if apart or len(root) == 1 else "start, end"
    canvas.text(root[0][0] + 8, root[0][1] - 16, words, ROOT_COLOR, size=11)
    if apart:
        canvas.text(root[-1][0] + 8, root[-1][1] + 4, "end", ROOT_COLOR, size=11)
    bar = _round_length(0.4 * (box.width - 40) / scale * cm) / cm
    words = f"{bar * cm / 100:g} m"
    y = box.top + box.height - 12
    canvas.line([(box.left + 10, y), (box.left + 10 + bar * scale, y)], INK, 2.0)
    canvas.text(box.left + 16 + bar * scale, y, words, size=11, anchor="lm")


def _draw_footprints(
    canvas: _Canvas, figure: Figure, track: NDArray[np.float64], foot: int, color: Color
) -> None:
    """Draw footprints: a dot where a foot stands, a streak in the sliding colour where it slides."""
    low, slides = low_frames(figure, foot), sliding_frames(figure, foot)
    for frame in np.flatnonzero(low):
        canvas.dot(
            track[frame][0], track[frame][1], 2.2, SLIDE_COLOR if slides[frame] else _lighter(color, 0.45)
        )


def _draw_heights(canvas: _Canvas, figure: Figure, frames: list[int], cm: float, box: _Box) -> None:
    """Draw heights of feet and root over time, and mark frames in which a low foot slides."""
    named = [(side or "foot", foot) for side, foot in figure.feet.items()]
    curves = [(figure.root[:, 1] - figure.floor, ROOT_COLOR)]
    curves += [(figure.positions[:, f, 1] - figure.floor, SIDE_COLORS.get(n, INK)) for n, f in named]
    low = min(0.0, *(float(c.min()) for c, _ in curves))
    high = max(0.6 * figure.stature, *(float(c.max()) for c, _ in curves))
    bands = 12 * len(named) + 6
    plot = _Box(box.left, box.top + 18, box.width, box.height - 40 - bands)
    count = len(figure.positions)

    def x_of(frame: NDArray[np.float64] | float) -> Any:
        return plot.left + plot.width * (frame / max(count - 1, 1))

    def y_of(height: NDArray[np.float64] | float) -> Any:
        return plot.top + plot.height * (1 - (height - low) / (high - low))

    floor = "floor = 0" if figure.floor_is_zero else f"floor = lowest, {figure.floor * cm:.0f} cm"
    canvas.text(box.left, box.top, f"heights in cm, {floor}:", FAINT, size=11)
    canvas.text(box.left + 190, box.top, "root", ROOT_COLOR, size=11)
    for n, (name, _) in enumerate(named):
        canvas.text(
            box.left + 230 + 70 * n,
            box.top,
            f"{name} foot" if name != "foot" else name,
            SIDE_COLORS.get(name, INK),
            size=11,
        )
    step = _round_length((high - low) * cm / 4) / cm
    for k in range(int(np.ceil(low / step)), int(high / step) + 1):
        y = y_of(k * step)
        canvas.line(
            [(plot.left, y), (plot.left + plot.width, y)], GROUND if k == 0 else GRID, 1.2 if k == 0 else 1
        )
        canvas.text(plot.left - 6, y, f"{k * step * cm:g}", FAINT, size=11, anchor="rm")
    for frame in frames:
        canvas.line([(x_of(frame), plot.top), (x_of(frame), plot.top + plot.height)], GRID)
        canvas.text(x_of(frame), plot.top + plot.height + 4, str(frame), FAINT, size=11, anchor="ma")
    times = np.arange(count, dtype=np.float64)
    for heights, color in curves:
        canvas.line(np.stack([x_of(times), y_of(heights)], axis=-1).tolist(), color, 1.8)
    for n, (name, foot) in enumerate(named):
        y = plot.top + plot.height + 24 + 12 * n
        _draw_band(canvas, figure, foot, SIDE_COLORS.get(name, INK), x_of, y)


def _draw_band(canvas: _Canvas, figure: Figure, foot: int, color: Color, x_of: Any, y: float) -> None:
    """Draw a bar over time: pale while the foot is low, strong while it slides."""
    slides = sliding_frames(figure, foot)
    low = low_frames(figure, foot)
    for mask, shade in ((low, _lighter(color, 0.7)), (slides, SLIDE_COLOR)):
        for start, end in spans(mask):
            left, right = x_of(float(start)), x_of(float(end - 1))
            canvas.box(_Box(left, y, max(right - left, 1.0), 7), fill=shade)
