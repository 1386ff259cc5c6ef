"""GIFs and videos of motions."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from motionkit.errors import MotionkitError
from motionkit.files import atomic_write
from motionkit.view.contact_sheet import load_pillow
from motionkit.view.figure_data import MotionView
from motionkit.view.picture import Scenery

if TYPE_CHECKING:
    from PIL import Image

GIF_FPS, GIF_WIDTH, GIF_COLORS = 20, 480, 96  # frames per second, pixels, colours of the palette
FILM_FPS, FILM_WIDTH = 30, 960  # frames per second, pixels
MAX_SECONDS = 600.0  # length of a film
MAX_WIDTH = 3840  # pixels
MAX_GIF_PIXELS = 500_000_000  # total of all frames, which Pillow keeps in memory
Progress = Callable[[int, int], None]


def write_film(
    path: str | Path, views: Sequence[MotionView], width: int | None = None, progress: Progress | None = None
) -> None:
    """Write motions side by side as .gif or .mp4, in real time and atomically.

    Args:
        path: file to write; its ending chooses the format.
        views: motions to draw, at least one.
        width: width in pixels, at most 3840; by default 480 for a GIF, 960 for a video. The height is 3/4 of the width.
        progress: called with the number of frames drawn and the number of all frames.

    Raises:
        MotionkitError: another ending; Pillow (or imageio-ffmpeg for .mp4) is not installed; a motion of over ten
            minutes; or a GIF of over 500 million pixels.
    """
    kind = Path(path).suffix.lower()
    if kind not in (".gif", ".mp4"):
        raise MotionkitError(f"{path}: a video is a .gif or .mp4 file, found {kind!r}")
    if not views:
        raise MotionkitError("a video needs at least one motion")
    if kind == ".mp4":
        _ffmpeg()
    wide, fps = (GIF_WIDTH, GIF_FPS) if kind == ".gif" else (FILM_WIDTH, FILM_FPS)
    wide = width or wide
    if wide > MAX_WIDTH:
        raise MotionkitError(f"{path}: a video is at most {MAX_WIDTH} pixels wide, found {wide}")
    wide += wide % 2
    high = wide * 3 // 4 // 2 * 2  # videos need even sizes
    seconds = max((len(one.motion) - 1) / one.motion.fps for one in views)
    if seconds > MAX_SECONDS:
        raise MotionkitError(
            f"{path}: {seconds:.0f} s of motion, expected at most {MAX_SECONDS:.0f} s for a video"
        )
    most = MAX_GIF_PIXELS / (wide * high * fps)
    if kind == ".gif" and seconds > most:
        raise MotionkitError(
            f"{path}: {seconds:.0f} s of motion, expected at most {most:.0f} s for a GIF {wide} pixels wide; "
            "write .mp4 or choose a smaller --width"
        )
    pictures = _pictures(Scenery(views, wide, high), fps, progress)
    if kind == ".gif":
        _write_gif(path, pictures)
    else:
        _write_mp4(path, pictures, (wide, high))


def _pictures(scenery: Scenery, fps: int, progress: Progress | None) -> Iterator[Image.Image]:
    count = int(scenery.seconds * fps + 1e-6) + 1
    for n in range(count):
        yield scenery.frame(n / fps)
        if progress:
            progress(n + 1, count)


def _write_gif(path: str | Path, pictures: Iterator[Image.Image]) -> None:
    image, _, _ = load_pillow()
    with atomic_write(path, "wb") as file:  # opened before drawing, so that a bad path fails at once
        first = next(pictures).quantize(GIF_COLORS)
        # A single palette without dithering keeps files small and avoids flicker.
        rest = (picture.quantize(palette=first, dither=image.Dither.NONE) for picture in pictures)
        first.save(
            file, "GIF", save_all=True, append_images=rest, duration=1000 // GIF_FPS, loop=0, optimize=False
        )


def _write_mp4(path: str | Path, pictures: Iterator[Image.Image], size: tuple[int, int]) -> None:
    with atomic_write(path, "wb") as file, tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "film.mp4"
        try:
            _encode(made, pictures, size)
        except OSError as error:  # ffmpeg's own messages are after the first line
            reason = (str(error).strip() or type(error).__name__).splitlines()[0]
            raise MotionkitError(f"{path}: ffmpeg could not write the video ({reason})") from None
        if not made.exists() or not made.stat().st_size:
            raise MotionkitError(f"{path}: ffmpeg wrote no video")
        with made.open("rb") as film:
            shutil.copyfileobj(film, file)


def _encode(made: Path, pictures: Iterator[Image.Image], size: tuple[int, int]) -> None:
    writer = _ffmpeg().write_frames(str(made), size, fps=FILM_FPS, quality=7, macro_block_size=2)
    writer.send(None)
    try:
        for picture in pictures:
            writer.send(picture.tobytes())
    finally:
        writer.close()


def _ffmpeg() -> Any:
    try:
        import imageio_ffmpeg
    except ImportError:
        raise MotionkitError(
            'writing .mp4 needs imageio-ffmpeg, which is not installed: pip install "motionkit[video]"'
        ) from None
    return imageio_ffmpeg
