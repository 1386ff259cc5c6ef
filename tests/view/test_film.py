"""GIFs and films: they show the figure, in real time, and are whole or not there."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from motionkit.errors import MotionkitError
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_multiply, quat_rotate
from motionkit.view.figure_data import MotionView
from motionkit.view.film import write_film
from motionkit.view.picture import Scenery
from motionkit.view.raster import fill_triangles
from synthetic_motions import make_cartwheel, make_walk

pytestmark = pytest.mark.thorough


def blue(picture: Image.Image) -> np.ndarray:
    """Where a picture shows the first motion's shirt."""
    pixels = np.array(picture.convert("RGB")).astype(int)
    return pixels[..., 2] - pixels[..., 0] > 60


def test_a_gif_plays_in_real_time(tmp_path: Path) -> None:
    file = tmp_path / "walk.gif"
    done: list[int] = []
    write_film(file, [MotionView("walk", make_walk(61))], 200, lambda n, count: done.append(count - n))
    with Image.open(file) as gif:
        assert gif.size == (200, 150) and gif.n_frames == 21 and done[-1] == 0
        assert gif.info["duration"] * gif.n_frames == pytest.approx(1050)
        shirts = []
        for frame in (0, 10, 20):
            gif.seek(frame)
            shirts.append(blue(gif))
    assert all(100 < shirt.sum() < 3000 for shirt in shirts)
    assert (shirts[0] != shirts[1]).sum() > 20


def test_the_figure_stands_upright_in_the_picture_and_turns_over() -> None:
    scenery = Scenery([MotionView("cartwheel", make_cartwheel(60))], 240, 180)
    pictures = [np.array(scenery.frame(t)).astype(int) for t in (0.0, 0.5)]
    trousers = [
        np.argwhere((p[..., 2] - p[..., 0] > 15) & (p.sum(axis=-1) < 260))[:, 0].mean() for p in pictures
    ]
    shirts = [np.argwhere(p[..., 2] - p[..., 0] > 60)[:, 0].mean() for p in pictures]
    assert trousers[0] > shirts[0] + 20, "the trousers are below the shirt"
    assert trousers[1] < shirts[1] - 20, "and in the middle of a cartwheel above it"


def test_two_motions_stand_side_by_side() -> None:
    picture = Scenery([MotionView("a", make_walk(10)), MotionView("b", make_walk(10))], 240, 180).frame(0.0)
    pixels = np.array(picture).astype(int)
    left = np.argwhere(blue(picture))[:, 1].mean()
    right = np.argwhere(pixels[..., 0] - pixels[..., 2] > 60)[:, 1].mean()
    assert abs(right - left) > 30


SHIRTS = ((79, 134, 232), (232, 133, 61), (63, 174, 116))  # of the first three


def turned(motion: Motion, degrees: float) -> Motion:
    """The motion turned about the vertical axis through the origin."""
    half = math.radians(degrees) / 2
    turn = np.broadcast_to(np.array([math.cos(half), 0.0, math.sin(half), 0.0], np.float32), (len(motion), 4))
    rotations = motion.local_rotations.copy()
    rotations[:, 0] = quat_multiply(turn, rotations[:, 0])
    return replace(motion, local_rotations=rotations, root_positions=quat_rotate(turn, motion.root_positions))


def shirt(picture: Image.Image, color: tuple[int, int, int]) -> np.ndarray:
    """Where a picture shows a shirt in whatever light: the colour's direction, not its length."""
    pixels = np.array(picture).astype(float)
    wanted = np.array(color) / np.linalg.norm(color)
    return (pixels @ wanted) / np.maximum(np.linalg.norm(pixels, axis=-1), 1.0) > 0.998


@pytest.mark.parametrize("directions", [(0, 180), (0, 120, 240), (0, 0, 0), (90, 90, 200)])
def test_nobody_walks_out_of_the_picture(directions: tuple[int, ...]) -> None:
    walk = make_walk(481)
    scenery = Scenery([MotionView(str(d), turned(walk, d)) for d in directions], 320, 240)
    for time in (0.0, 2.0, 5.0, 8.0):
        picture = scenery.frame(time)
        for color in SHIRTS[: len(directions)]:
            assert shirt(picture, color).sum() > 8, f"{color} is not there after {time} s"
        camera = scenery.framing.camera(time)
        for actor, place in zip(scenery.actors, scenery.framing.places, strict=True):
            corners = camera.screen(actor.body(time)[0] + place)
            low, high = corners.min(axis=0), corners.max(axis=0)
            assert (low > 0.0).all() and (high[:2] < scenery.size).all()


def test_a_single_figure_stays_in_the_picture_too() -> None:
    leap = make_walk(121)
    leap.root_positions[:, 1] += 200.0 * np.sin(np.linspace(0.0, math.pi, 121, dtype=np.float32))
    scenery = Scenery([MotionView("leap", leap)], 240, 180)
    for time in (0.0, 0.5, 1.0, 2.0):
        corners = scenery.framing.camera(time).screen(scenery.actors[0].body(time)[0])
        assert (corners > 0.0).all() and (corners[:, :2] < scenery.size).all()


def test_several_figures_are_named() -> None:
    walk = make_walk(61)
    picture = np.array(Scenery([MotionView("gt", walk), MotionView("made", walk)], 320, 240).frame(0.5))
    for color in SHIRTS[:2]:
        tag = (picture == [part * 3 // 4 for part in color]).all(axis=-1)
        rows, columns = np.nonzero(tag)
        assert (
            tag.sum() > 100 and rows.max() < np.argwhere(shirt(Image.fromarray(picture), color))[:, 0].max()
        )
        inside = picture[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
        assert (inside > 240).all(axis=-1).sum() > 10, "white letters"


@pytest.mark.parametrize(
    "name", ["</script>\"'&", "\U0001f483 \u821e", "x" * 10_000, "a\nb\x1b[31m\udcff", ""]
)
def test_any_name_fits_into_the_picture(name: str) -> None:
    walk = make_walk(4)
    scenery = Scenery([MotionView(name, walk)] * 12, 160, 120)
    assert scenery.labels is not None
    assert all(tag.width < 80 and tag.height < 30 for tag in scenery.labels.tags)
    assert scenery.frame(0.0).size == (160, 120)


def test_triangles_cover_the_middles_of_their_pixels() -> None:
    random = np.random.default_rng(0)
    corners = random.uniform(-8.0, 40.0, (60, 1, 2)) + random.uniform(-6.0, 6.0, (60, 3, 2))
    corners[3] = corners[3, 0]  # a point
    corners[4, 1] = np.nan
    corners[5, :, 1] = 10.5  # a line
    colors = random.integers(1, 255, (60, 3)).astype(np.uint8)
    canvas = np.zeros((24, 32, 3), np.uint8)
    fill_triangles(canvas, corners, colors)
    wanted = np.zeros_like(canvas)
    y, x = np.mgrid[:24, :32] + 0.5
    for (a, b, c), color in zip(corners, colors, strict=True):
        sides = [(q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) for p, q in ((a, b), (b, c), (c, a))]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if abs(area) > 1e-9:
            wanted[np.all(np.array(sides) * np.sign(area) >= 0.0, axis=0)] = color
    assert (canvas == wanted).all() and canvas.any()


def test_a_film(tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed")
    file = tmp_path / "walk.mp4"
    write_film(file, [MotionView("walk", make_walk(31))], 160)
    frames, seconds = ffmpeg.count_frames_and_secs(str(file))
    # Older ffmpeg tells when the last frame it wrote begins, up to three frames early.
    assert frames == 16 and seconds == pytest.approx(16 / 30, abs=3.5 / 30)


def test_without_imageio_ffmpeg_one_line_tells_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(MotionkitError, match=r'pip install "motionkit\[video\]"'):
        write_film(tmp_path / "walk.mp4", [MotionView("walk", make_walk(4))])
    assert not (tmp_path / "walk.mp4").exists()


def test_other_endings_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MotionkitError, match=r"\.gif or \.mp4"):
        write_film(tmp_path / "walk.avi", [MotionView("walk", make_walk(4))])


@pytest.mark.parametrize(("name", "width"), [("a.mp4", 4000), ("a.gif", 3840)])
def test_what_would_fill_the_memory_is_refused_at_once(tmp_path: Path, name: str, width: int) -> None:
    pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed")
    with pytest.raises(MotionkitError, match=r"at most (3840 pixels|2 s for a GIF)"):
        write_film(tmp_path / name, [MotionView("walk", make_walk(200))], width)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("ending", ["gif", "mp4"])
def test_a_place_that_cannot_be_written_is_told_before_the_first_picture(tmp_path: Path, ending: str) -> None:
    pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed")
    drawn: list[int] = []
    (tmp_path / "none").touch()
    with pytest.raises(MotionkitError, match="cannot be written"):
        write_film(
            tmp_path / "none" / f"a.{ending}",
            [MotionView("a", make_walk(4))],
            160,
            lambda n, _: drawn.append(n),
        )
    assert not drawn


def test_an_ffmpeg_that_fails_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed")

    def broken(*_: object, **__: object) -> None:
        raise OSError("broken pipe\nand much more")

    monkeypatch.setattr(ffmpeg, "write_frames", broken)
    with pytest.raises(MotionkitError, match=r"could not write the video \(broken pipe\)$"):
        write_film(tmp_path / "a.mp4", [MotionView("a", make_walk(4))], 160)
    assert not list(tmp_path.iterdir())
