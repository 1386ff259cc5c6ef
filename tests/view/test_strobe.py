from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from motionkit.motion.bvh import bvh_to_motion, read_bvh
from motionkit.view.figure_data import MotionView

pytest.importorskip("PIL")
from motionkit.view.picture import SHIRTS
from motionkit.view.strobe import PATH, TRACK, StrobePicture

CLIP = Path(__file__).resolve().parents[2] / "examples" / "data" / "127_07.bvh"


def near(picture: np.ndarray, color: tuple[int, int, int], apart: int = 40) -> int:
    """Number of pixels close to a colour."""
    return int((np.abs(picture.astype(int) - color).max(axis=-1) < apart).sum())


def shown(path: np.ndarray | None) -> MotionView:
    motion = bvh_to_motion(read_bvh(CLIP))
    half = motion.seconds / 2
    return MotionView("a run", motion, [("running", half), ("walking", half)], path)


def test_poses_along_a_path_with_track_and_path() -> None:
    motion = shown(None).motion
    start, end = motion.root_positions[[0, -1]][:, [0, 2]].astype(np.float64)
    side = start + (end - start) * [1.0, 0.4]
    scene = StrobePicture(shown(np.stack([start, side])), poses=4, width=800, height=320)
    picture = np.array(scene.draw())
    assert picture.shape == (320, 800, 3)
    assert near(picture, TRACK) > 50 and near(picture, PATH) > 50
    assert [scene.actors.index(each) for each in scene.actors] == [0, 0, 2, 2]  # two of each type
    assert near(picture, SHIRTS[0]) > 50 and near(picture, SHIRTS[1]) > 50


def test_without_a_path_poses_stand_in_a_row() -> None:
    scene = StrobePicture(shown(None), poses=5, width=800, height=320)
    hips = [
        points.mean(axis=0)
        for points, _ in (a.body(float(t)) for a, t in zip(scene.actors, scene.times, strict=True))
    ]
    across = scene.camera.screen(np.stack(hips) + scene.places)
    assert (np.diff(across[:, 0]) > 50).all()
    assert np.ptp(across[:, 2]) < 0.5  # equally far from the camera
    picture = np.array(scene.draw())
    assert near(picture, TRACK, 20) == 0
