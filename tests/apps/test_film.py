"""GIFs and films: they show the figure, in real time, and are whole or not there."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from motionkit.apps.figure_data import Shown
from motionkit.apps.film import write_film
from motionkit.apps.picture import Scenery
from motionkit.errors import MotionkitError
from synthetic_motions import make_cartwheel, make_walk


def blue(picture: Image.Image) -> np.ndarray:
    """Where a picture shows the first motion's shirt."""
    pixels = np.array(picture.convert("RGB")).astype(int)
    return pixels[..., 2] - pixels[..., 0] > 60


def test_a_gif_plays_in_real_time(tmp_path: Path) -> None:
    file = tmp_path / "walk.gif"
    done: list[int] = []
    write_film(file, [Shown("walk", make_walk(61))], 200, lambda n, count: done.append(count - n))
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
    scenery = Scenery([Shown("cartwheel", make_cartwheel(60))], 240, 180)
    pictures = [np.array(scenery.frame(t)).astype(int) for t in (0.0, 0.5)]
    shoes = [np.argwhere(p.sum(axis=-1) < 120)[:, 0].mean() for p in pictures]
    shirts = [np.argwhere(p[..., 2] - p[..., 0] > 60)[:, 0].mean() for p in pictures]
    assert shoes[0] > shirts[0] + 20, "the shoes are below the shirt"
    assert shoes[1] < shirts[1] - 20, "and in the middle of a cartwheel above it"


def test_two_motions_stand_side_by_side() -> None:
    picture = Scenery([Shown("a", make_walk(10)), Shown("b", make_walk(10))], 240, 180).frame(0.0)
    pixels = np.array(picture).astype(int)
    left = np.argwhere(blue(picture))[:, 1].mean()
    right = np.argwhere(pixels[..., 0] - pixels[..., 2] > 60)[:, 1].mean()
    assert abs(right - left) > 30


def test_a_film(tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed")
    file = tmp_path / "walk.mp4"
    write_film(file, [Shown("walk", make_walk(31))], 160)
    frames, seconds = ffmpeg.count_frames_and_secs(str(file))
    assert frames == 16 and seconds == pytest.approx(16 / 30, abs=0.05)


def test_without_imageio_ffmpeg_one_line_tells_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(MotionkitError, match=r'pip install "motionkit\[video\]"'):
        write_film(tmp_path / "walk.mp4", [Shown("walk", make_walk(4))])
    assert not (tmp_path / "walk.mp4").exists()


def test_other_endings_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MotionkitError, match=r"\.gif or \.mp4"):
        write_film(tmp_path / "walk.avi", [Shown("walk", make_walk(4))])
