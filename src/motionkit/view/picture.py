"""Draws bodies on a ground with Pillow, like the page but without a browser."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.rotations import quat_to_matrix
from motionkit.rig.upright import in_metres
from motionkit.view.body import make_body
from motionkit.view.contact_sheet import load_pillow
from motionkit.view.contact_sheet_geometry import motion_figure
from motionkit.view.figure_data import MotionView
from motionkit.view.framing import DISTANCE, SIDE_ANGLE, Camera, Framing, frame_at
from motionkit.view.picture_labels import Labels
from motionkit.view.raster import fill_triangles
from motionkit.view.surface import Array

if TYPE_CHECKING:
    from PIL import Image

ZOOM = 2  # drawing scale before the picture is reduced
LINE_WIDTH = 4  # pixels
GRID_REACH = 9  # lines on each side of the camera's target
SKY, GROUND, LINE = (238, 241, 245), (227, 231, 237), (200, 207, 216)  # RGB, 0 to 255
SHIRTS = ((79, 134, 232), (232, 133, 61), (63, 174, 116), (168, 115, 222), (221, 85, 103), (43, 167, 172))
SUN = np.array([1.7, 5.6, 2.2]) / np.linalg.norm(
    [1.7, 5.6, 2.2]
)  # direction of the light, for a camera at SIDE_ANGLE


# Points (N, 3) of a line on the ground, and its colour.
Line = tuple[Array, tuple[int, int, int]]


class Actor:
    """A motion prepared for drawing, in metres.

    Attributes:
        color: of the figure, 0 to 255.
        figure: its points and bones.
        corners: (F, 3) points of each triangle.
        shades: (F, 3) colour of each triangle in full light.
    """

    def __init__(self, view: MotionView, color: tuple[int, int, int]) -> None:
        motion = in_metres(view.motion).motion
        self.color, self.figure = color, motion_figure(motion)
        self._surface, self._pose = make_body(motion, self.figure, view.body)
        turns, places = motion_kinematics(motion)
        self._turns, self._places = quat_to_matrix(turns).astype(np.float64), places.astype(np.float64)
        self.corners = self._surface.triangles
        shades = self._surface.shades(np.array(color, np.float64))
        self.shades: Array = shades[self._surface.regions[self.corners[:, 0]]]

    def body(self, time: float) -> tuple[Array, Array]:
        """Points (V, 3) in the world at a time, with the floor at zero, and the triangles' smoothed normals (F, 3)."""
        surface, figure = self._surface, self.figure
        frame = frame_at(time, figure.fps, len(self._turns))
        moves = self._pose.matrices_from(self._turns[frame], self._places[frame])
        points, normals = surface.moved(moves, surface.normals)
        points[:, 1] -= 0.0 if figure.floor_is_zero else figure.floor
        return points, normals[surface.triangles].mean(axis=1)


class Scenery:
    """Motions side by side, and their camera."""

    def __init__(self, views: Sequence[MotionView], width: int, height: int) -> None:
        self.pillow = load_pillow()
        self.size = width * ZOOM, height * ZOOM
        self.actors = [Actor(one, SHIRTS[n % len(SHIRTS)]) for n, one in enumerate(views)]
        self.labels = Labels(views, [a.color for a in self.actors], width, height) if len(views) > 1 else None
        top = 0 if self.labels is None else self.labels.height * ZOOM
        self.framing = Framing([a.figure for a in self.actors], self.size, top)
        self.seconds = self.framing.seconds
        self.sun = sunlight(self.framing.angle)
        self.step = grid_step(self.framing.farthest)

    def frame(self, time: float) -> Image.Image:
        """The picture at a time in seconds."""
        camera = self.framing.camera(time)
        picture = self.drawn([time] * len(self.actors), self.framing.places, camera)
        if self.labels is not None:
            self.labels.draw(picture, camera.screen(self.framing.tops(time))[:, :2] / ZOOM)
        return picture

    def drawn(
        self, times: Sequence[float], places: Iterable[Array], camera: Camera, lines: Sequence[Line] = ()
    ) -> Image.Image:
        """The actors, each at its time and moved to its place (3,), over lines on the ground."""
        image, image_draw, _ = self.pillow
        bodies = []
        for actor, time, place in zip(self.actors, times, places, strict=True):
            points, normals = actor.body(float(time))
            bodies.append((points + place, normals))
        picture = image.new("RGB", self.size, SKY)
        self.ground(image_draw.Draw(picture), camera)
        self.shadows(picture, bodies, camera)
        pen = image_draw.Draw(picture)
        for track, color in lines:
            if len(track) > 1:
                seen = [tuple(point) for point in camera.screen(track)[:, :2].tolist()]
                pen.line(seen, fill=color, width=LINE_WIDTH * ZOOM, joint="curve")
        pixels = np.array(picture)
        fill_triangles(pixels, *self.shaded(bodies, camera))
        return image.fromarray(pixels).reduce(ZOOM)

    def shadows(self, picture: Image.Image, bodies: list[tuple[Array, Array]], camera: Camera) -> None:
        """Draw soft shadows on the ground, at low resolution because they are blurred."""
        image, _, _ = self.pillow
        from PIL import ImageFilter

        width, height = self.size[0] // ZOOM, self.size[1] // ZOOM
        shadow = np.zeros((height, width, 1), np.uint8)
        for actor, (body, normals) in zip(self.actors, bodies, strict=True):
            flat = body - body[:, 1:2] / self.sun[1] * self.sun
            seen = camera.screen(flat)[:, :2] / ZOOM
            corners = seen[actor.corners[normals @ self.sun > 0.0]]
            fill_triangles(shadow, corners, np.full((len(corners), 1), 90, np.uint8))
        soft = image.fromarray(shadow[..., 0]).filter(ImageFilter.GaussianBlur(2.5))
        box = soft.getbbox()
        if box is not None:
            large = tuple(ZOOM * edge for edge in box)
            mask = soft.crop(box).resize(
                (large[2] - large[0], large[3] - large[1]), image.Resampling.BILINEAR
            )
            picture.paste((40, 46, 58), large, mask)

    def ground(self, pen: Any, camera: Camera) -> None:
        """Draw the floor with lines that fade into the distance."""
        width, height = self.size
        away = -camera.axes[2] * [1.0, 0.0, 1.0]
        horizon = camera.screen(camera.target * [1.0, 0.0, 1.0] + 1e5 * away)
        pen.rectangle((0, float(np.clip(horizon[1], 0, height)), width, height), fill=GROUND)
        reach = GRID_REACH * self.step
        first_x, first_z = (np.floor(camera.target[axis] / self.step) * self.step - reach for axis in (0, 2))
        across = np.arange(2 * GRID_REACH + 1)[:, None] * self.step
        along = np.linspace(0.0, 2.0 * reach, 4 * GRID_REACH + 1)[None]
        x, z = np.broadcast_arrays(first_x + across, first_z + along)
        x_too, z_too = np.broadcast_arrays(first_x + along, first_z + across)
        lines = np.concatenate([np.stack([x, 0 * x, z], -1), np.stack([x_too, 0 * x_too, z_too], -1)])
        seen = camera.screen(lines)
        starts, ends = seen[:, :-1].reshape(-1, 3), seen[:, 1:].reshape(-1, 3)
        low, high = np.minimum(starts, ends), np.maximum(starts, ends)
        inside = (low[:, 2] > 0.3) & (high[:, :2] >= 0.0).all(axis=1) & (low[:, :2] <= self.size).all(axis=1)
        starts, ends = starts[inside], ends[inside]
        fades = np.clip((starts[:, 2] - camera.distance) / reach, 0.0, 1.0)[:, None]
        colors = ((1 - fades) * LINE + fades * GROUND).round().astype(int).tolist()
        segments = np.concatenate([starts[:, :2], ends[:, :2]], axis=1).tolist()
        for segment, color in zip(segments, colors, strict=True):
            pen.line(segment, fill=tuple(color), width=ZOOM)

    def shaded(self, bodies: list[tuple[Array, Array]], camera: Camera) -> tuple[Array, NDArray[np.uint8]]:
        """Corners (F, 3, 2) and colours (F, 3) of triangles that face the camera, from far to near."""
        corners: list[Array] = []
        colors: list[NDArray[np.uint8]] = []
        for actor, (body, normals) in zip(self.actors, bodies, strict=True):
            seen = camera.screen(body)[actor.corners]
            sides = np.diff(seen[..., :2], axis=1)
            facing = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0] < 0.0
            skin = normals[facing]
            # Ambient light, sun, and some light from the camera, so that no side is dark.
            light = 0.5 + 0.13 * skin[:, 1] + 0.42 * np.clip(skin @ self.sun, 0.0, 1.0)
            light += 0.16 * np.clip(skin @ camera.axes[2], 0.0, 1.0)
            colors.append(np.clip(actor.shades[facing] * light[:, None], 0, 255).astype(np.uint8))
            corners.append(seen[facing])
        every, shades = np.concatenate(corners), np.concatenate(colors)
        order = np.argsort(-every[..., 2].mean(axis=1), kind="stable")
        return every[order][..., :2], shades[order]


def sunlight(angle: float) -> Array:
    """Direction (3,) of the light for a camera angle: from over the camera's shoulder."""
    sine, cosine = np.sin(angle - SIDE_ANGLE), np.cos(angle - SIDE_ANGLE)
    return np.array([SUN[0] * cosine + SUN[2] * sine, SUN[1], SUN[2] * cosine - SUN[0] * sine])


def grid_step(distance: float) -> float:
    """Distance in metres between grid lines: 1, 2, 5, 10 ..., depending on the camera's distance."""
    length = max(1.0, distance / (2 * DISTANCE))
    ten = 10.0 ** np.floor(np.log10(length))
    return float(next(ten * step for step in (1.0, 2.0, 5.0, 10.0) if ten * step >= length))
