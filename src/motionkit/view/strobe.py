"""One picture of a whole motion, like the result figures of papers.

With a path, poses stand at their positions, and the root's track is drawn beside the requested path. Without one, poses
stand in a row from left to right.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.files import atomic_write
from motionkit.view.contact_sheet import load_pillow
from motionkit.view.figure_data import CM, MotionView
from motionkit.view.framing import Camera, frame_at
from motionkit.view.lettering import lettered
from motionkit.view.picture import SHIRTS, ZOOM, Actor, Scenery, grid_step, sunlight
from motionkit.view.surface import Array

LIFT = 0.42  # radians, downward pitch of the camera
TRACK, PATH, INK = (34, 139, 76), (222, 130, 40), (40, 46, 58)
NEAREST, FARTHEST = 4.0, 400.0  # m, range of camera distances to try
STEP = 1.03  # factor between distances
APART = 0.95  # m between bodies in a row
EDGE = 0.05  # free margin on every side, as a share of the picture


class StrobePicture(Scenery):
    """A motion at several times in one picture; bodies are coloured by motion type.

    shown.types gives the types and their seconds, shown.path a requested path in cm.
    """

    def __init__(self, view: MotionView, poses: int = 14, width: int = 1600, height: int = 640) -> None:
        self.pillow = load_pillow()
        self.size = width * ZOOM, height * ZOOM
        self.view = view
        kinds = list(dict.fromkeys(kind for kind, _ in view.types)) or [""]
        self.of_kind = {kind: Actor(view, SHIRTS[n % len(SHIRTS)]) for n, kind in enumerate(kinds)}
        figure = self.of_kind[kinds[0]].figure
        self.times = np.linspace(0.0, (len(figure.positions) - 1) / figure.fps, poses)
        self.actors = [self.of_kind[self._type_at(time, kinds[0])] for time in self.times]
        frames = [frame_at(float(time), figure.fps, len(figure.positions)) for time in self.times]
        floor = 0.0 if figure.floor_is_zero else figure.floor
        self.places = np.zeros((poses, 3))
        self.track, self.path = np.zeros((0, 3)), np.zeros((0, 3))
        bodies = figure.positions[frames] - [0.0, floor, 0.0]
        if view.path is None:
            self.places = _in_a_row(bodies[:, figure.hips])
            direction = np.array([1.0, 0.0, 0.0])
        else:
            self.track = figure.positions[:, figure.hips] * [1.0, 0.0, 1.0]
            self.path = _on_ground(view.path * CM)
            direction = _longer_direction(self.track)
        points = [(bodies + self.places[:, None]).reshape(-1, 3), self.track, self.path]
        self.camera = _camera(np.concatenate(points), direction, self.size)
        self.sun = sunlight(float(np.arctan2(self.camera.axes[2][0], self.camera.axes[2][2])))
        self.step = grid_step(self.camera.distance)

    def _type_at(self, time: float, first: str) -> str:
        ends = np.cumsum([seconds for _, seconds in self.view.types])
        if not len(ends):
            return first
        return self.view.types[min(int(np.searchsorted(ends, time)), len(ends) - 1)][0]

    def draw(self) -> Any:
        """The picture, a PIL image."""
        lines = ((self.path, PATH), (self.track, TRACK))
        picture = self.drawn(self.times.tolist(), self.places, self.camera, lines)
        self._legend(self.pillow[1].Draw(picture))
        return picture

    def _legend(self, pen: Any) -> None:
        """Write the motion's name, and each type in its colour."""
        x, y = 16, 12
        name, font = lettered(self.view.name, 20)
        pen.text((x, y), name, fill=INK, font=font)
        for kind, actor in self.of_kind.items():
            if kind:
                pen.rectangle((x, y + 36, x + 12, y + 48), fill=actor.color)
                kind, font = lettered(kind, 16)
                pen.text((x + 18, y + 32), kind, fill=INK, font=font)
                x += 30 + int(pen.textlength(kind, font=font))


def write_strobe(path: str | Path, view: MotionView, poses: int = 14) -> None:
    """Write the picture of a motion as PNG, atomically. Raises MotionkitError if Pillow is not installed."""
    picture = StrobePicture(view, poses).draw()
    with atomic_write(path, "wb") as file:
        picture.save(file, format="PNG", optimize=True)


def _on_ground(points: Array) -> Array:
    """Points (N, 2) x, z, as (N, 3) at height 0."""
    return np.stack([points[:, 0], np.zeros(len(points)), points[:, 1]], axis=-1)


def _in_a_row(hips: Array) -> Array:
    """Shifts (N, 3) that put bodies with hips (N, 3) side by side along +X."""
    row = np.arange(len(hips))[:, None] * np.array([APART, 0.0, 0.0])
    return row - hips * [1.0, 0.0, 1.0]


def _longer_direction(track: Array) -> Array:
    """The ground direction (3,) in which a track (T, 3) is longest, pointing from its start to its end."""
    flat = track[:, [0, 2]] - track[:, [0, 2]].mean(axis=0)
    _, _, axes = np.linalg.svd(flat, full_matrices=False)
    direction = np.array([axes[0, 0], 0.0, axes[0, 1]])
    return -direction if direction @ (track[-1] - track[0]) < 0.0 else direction


def _camera(points: Array, right: Array, size: Sequence[int]) -> Camera:
    """The nearest camera that sees all points and looks across the ground direction `right`."""
    level = np.cross(right, [0.0, 1.0, 0.0])
    back = np.cos(LIFT) * level + np.sin(LIFT) * np.array([0.0, 1.0, 0.0])
    axes = np.stack([right, np.cross(back, right), back])
    target = (points.min(axis=0) + points.max(axis=0)) / 2
    free, distance = EDGE * np.array(size), NEAREST
    while True:
        camera = Camera(target, np.array([0.0, 0.0, distance]), axes, (size[0], size[1]))
        seen = camera.screen(points)
        inside = (seen[:, :2] > free).all() and (seen[:, :2] < size - free).all()
        if (inside and seen[:, 2].min() > 1.0) or distance > FARTHEST:
            return camera
        distance *= STEP
