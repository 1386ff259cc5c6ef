"""Pictures of bodies on a ground, drawn with Pillow: what the page shows, without a browser."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from motionkit.apps.body import make_body
from motionkit.apps.contact_sheet import load_pillow
from motionkit.apps.contact_sheet_geometry import motion_figure
from motionkit.apps.figure_data import Shown, in_metres
from motionkit.apps.surface import TINTS, Array
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.rotations import quat_to_matrix

if TYPE_CHECKING:
    from PIL import Image

ZOOM = 2  # drawn so much larger and averaged down
FIELD = 0.6  # tangent of half the angle seen from top to bottom, with DISTANCE
DISTANCE = 4.0  # m from the camera to what it looks at
LIFT = 0.17  # radians the camera looks down
EYE = 0.9  # m, what it looks at
GAP = 0.7  # m between motions side by side
GRID_REACH = 9  # m of lines around the camera's target
SKY, GROUND, LINE = (238, 241, 245), (227, 231, 237), (200, 207, 216)
SHIRTS = ((79, 134, 232), (232, 133, 61), (63, 174, 116), (168, 115, 222), (221, 85, 103), (43, 167, 172))
SUN = np.array([1.7, 5.6, 2.2]) / np.linalg.norm([1.7, 5.6, 2.2])
_SMOOTHING = 0.4  # s either side that the camera's way is averaged over


@dataclass(frozen=True, eq=False)
class _Actor:
    """A motion ready to be drawn: rotations (T, J, 3, 3), places (T, J, 3), hips (T, 3), all in metres."""

    shown: Shown
    color: tuple[int, int, int]

    @cached_property
    def _parts(self) -> tuple[Any, ...]:
        motion, _, _ = in_metres(self.shown.motion)
        figure = motion_figure(motion)
        surface, pose = make_body(motion, [j for _, j in figure.bones if j < len(motion.skeleton)])
        turns, places = motion_kinematics(motion)
        return surface, pose, quat_to_matrix(turns).double().numpy(), places.double().numpy(), figure

    @property
    def fps(self) -> float:
        return self.shown.motion.fps

    @cached_property
    def hips(self) -> Array:
        return self._parts[4].root

    @cached_property
    def shades(self) -> Array:
        """(F, 3) the colour of each triangle in full light."""
        surface = self._parts[0]
        mixes = {"head": ((242, 224, 208), 0.85), "leg": ((42, 48, 64), 0.68), "foot": ((20, 23, 28), 0.82)}
        mixes["hand"] = mixes["head"]
        table = []
        for name in TINTS:
            other, share = mixes.get(name, (self.color, 0.0))
            table.append((1 - share) * np.array(self.color) + share * np.array(other))
        return np.array(table)[surface.tints[surface.triangles[:, 0]]]

    def triangles(self, time: float) -> tuple[Array, Array]:
        """Corners (F, 3, 3) in the world at a time, the floor at zero, and normals (F, 3) of the skin there."""
        surface, pose, turns, places, figure = self._parts
        frame = min(int(time * self.fps + 1e-6), len(turns) - 1)
        points = surface.posed(pose.matrices_from(turns[frame], places[frame]))
        points[:, 1] -= 0.0 if figure.floor_is_zero else figure.floor
        corners = points[surface.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        # Averaged over neighbours, twice: at the points, then back on the triangles.
        spread = [np.bincount(surface.triangles.ravel(), np.repeat(n, 3), len(points)) for n in normals.T]
        skin: Array = np.stack(spread, axis=-1).astype(np.float64)
        skin = skin / np.maximum(np.linalg.norm(skin, axis=-1, keepdims=True), 1e-12)
        return corners, skin[surface.triangles].mean(axis=1)


class Scenery:
    """Motions side by side, and the camera that goes with the first."""

    def __init__(self, shown: Sequence[Shown], width: int, height: int) -> None:
        self.pillow = load_pillow()
        self.size = width * ZOOM, height * ZOOM
        self.actors = [_Actor(one, SHIRTS[n % len(SHIRTS)]) for n, one in enumerate(shown)]
        self.places = self._side_by_side()
        self.seconds = max((len(a.shown.motion) - 1) / a.fps for a in self.actors)
        way = self.actors[0].hips[-1] - self.actors[0].hips[0]
        travels = len(self.actors) == 1 and np.hypot(way[0], way[2]) > 1.0
        self.angle = float(np.arctan2(way[0], way[2])) + 0.95 if travels else 0.55
        self.distance = DISTANCE * (1 + 0.4 * (len(self.actors) - 1)) * max(1.0, 1.2 * height / width)

    def _side_by_side(self) -> list[Array]:
        if len(self.actors) == 1:
            return [np.zeros(3)]
        spans = [(a.hips[:, 0].min(), max(0.9, float(np.ptp(a.hips[:, 0])))) for a in self.actors]
        whole = sum(width for _, width in spans) + GAP * (len(spans) - 1)
        left, places = -whole / 2, []
        for actor, (low, width) in zip(self.actors, spans, strict=True):
            places.append(np.array([left - low, 0.0, -actor.hips[0, 2]]))
            left += width + GAP
        return places

    def frame(self, time: float) -> Image.Image:
        """The picture at a time, seconds from the start."""
        image, image_draw, _ = self.pillow
        from PIL import ImageFilter

        target = self._target(time)
        bodies = [a.triangles(time) for a in self.actors]
        bodies = [(body + place, skin) for (body, skin), place in zip(bodies, self.places, strict=True)]
        picture = image.new("RGB", self.size, SKY)
        self._ground(image_draw.Draw(picture), target)
        shadow = image.new("L", self.size, 0)
        pen = image_draw.Draw(shadow)
        for body, normals in bodies:
            lit = body[normals @ SUN > 0.0]
            flat = lit - lit[..., 1:2] / SUN[1] * SUN
            for corners in self._screen(flat, target)[..., :2]:
                pen.polygon(corners.ravel().tolist(), fill=90)
        shadow = shadow.filter(ImageFilter.GaussianBlur(2.5 * ZOOM))
        picture.paste((40, 46, 58), mask=shadow)
        pen = image_draw.Draw(picture)
        for corners, color in self._shaded(bodies, target):
            pen.polygon(corners, fill=color)
        return picture.resize((self.size[0] // ZOOM, self.size[1] // ZOOM), image.Resampling.BOX)

    def _target(self, time: float) -> Array:
        """Where the camera looks: the first motion's hips, averaged over a while; the middle of several."""
        actor = self.actors[0]
        reach = round(_SMOOTHING * actor.fps)
        frame = min(int(time * actor.fps + 1e-6), len(actor.hips) - 1)
        reach = min(reach, frame, len(actor.hips) - 1 - frame)
        middle = actor.hips[frame - reach : frame + reach + 1].mean(axis=0) + self.places[0]
        if len(self.actors) > 1:
            middle[0] = 0.0
        return np.array([middle[0], EYE, middle[2]])

    def _screen(self, points: Array, target: Array) -> Array:
        """Points (..., 3) as x, y in pixels and depth in metres."""
        sine, cosine = np.sin(self.angle), np.cos(self.angle)
        back = np.array([np.cos(LIFT) * sine, np.sin(LIFT), np.cos(LIFT) * cosine])
        right = np.array([cosine, 0.0, -sine])
        up = np.cross(back, right)
        away = points - target
        depth = self.distance - away @ back
        scale = self.size[1] / (FIELD * np.maximum(depth, 0.05))
        x = self.size[0] / 2 + (away @ right) * scale
        return np.stack([x, self.size[1] / 2 - (away @ up) * scale, depth], axis=-1)

    def _ground(self, pen: Any, target: Array) -> None:
        horizon = self._screen(
            target + np.array([-np.sin(self.angle), 0.0, -np.cos(self.angle)]) * 1e4, target
        )
        pen.rectangle((0, float(horizon[1]), *self.size), fill=GROUND)
        first_x, first_z = np.floor(target[0]) - GRID_REACH, np.floor(target[2]) - GRID_REACH
        steps = np.linspace(0.0, 2 * GRID_REACH, 37)
        for n in range(2 * GRID_REACH + 1):
            for line in (
                np.stack([np.full_like(steps, first_x + n), 0 * steps, first_z + steps], axis=-1),
                np.stack([first_x + steps, 0 * steps, np.full_like(steps, first_z + n)], axis=-1),
            ):
                seen = self._screen(line, target)
                for a, b in pairwise(seen):
                    if min(a[2], b[2]) > 0.3:
                        fade = float(np.clip((a[2] - self.distance) / GRID_REACH, 0.0, 1.0))
                        color = tuple(
                            round((1 - fade) * c + fade * g) for c, g in zip(LINE, GROUND, strict=True)
                        )
                        pen.line((*a[:2].tolist(), *b[:2].tolist()), fill=color, width=ZOOM)

    def _shaded(
        self, bodies: list[tuple[Array, Array]], target: Array
    ) -> list[tuple[list[float], tuple[int, int, int]]]:
        """Triangles that face the camera as corners and colour, from far to near."""
        corners: list[Array] = []
        colors: list[NDArray[np.int64]] = []
        for actor, (body, normals) in zip(self.actors, bodies, strict=True):
            seen = self._screen(body, target)
            sides = np.diff(seen[..., :2], axis=1)
            facing = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0] < 0.0
            light = 0.52 + 0.16 * normals[:, 1] + 0.5 * np.clip(normals @ SUN, 0.0, 1.0)
            colors.append(np.clip(actor.shades * light[:, None], 0, 255).astype(np.int64)[facing])
            corners.append(seen[facing])
        every, shades = np.concatenate(corners), np.concatenate(colors)
        order = np.argsort(-every[..., 2].mean(axis=1), kind="stable")
        flat = every[order][..., :2].reshape(len(order), 6).tolist()
        return [(points, (r, g, b)) for points, (r, g, b) in zip(flat, shades[order].tolist(), strict=True)]
