"""Places motions side by side, and a camera that keeps all of them in the picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motionkit.view.contact_sheet_geometry import Figure
from motionkit.view.surface import Array

FIELD = 0.6  # height of the view at distance 1
DISTANCE = 4.0  # m, smallest distance from the camera to its target
LIFT = 0.17  # radians the camera looks down
EYE = 0.9  # m, height of the target
GAP = 0.6  # m, smallest distance between the joints of two bodies
FLESH = 0.09  # distance from a joint to the body's surface, as a share of the stature
SIDE_ANGLE = 0.55  # radians between the camera and the facing of the bodies
TRAVEL_ANGLE = 0.95  # radians between the camera and the direction of a travelling body
_RATE = 30.0  # samples per second of the camera's path
_SMOOTHING = 0.4  # s on either side over which it is averaged
_ANGLES = 16  # number of camera directions to try
_FACE = 0.3  # how much more distant a view of faces may be than one of backs, as a share
_EDGE = 0.05  # share of the picture kept free at the sides and the bottom


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera at one moment.

    Attributes:
        target: (3,) point it looks at without a shift, m.
        shift: (3,) from the target to the camera, along right, up and back, m.
        axes: (3, 3) the directions right, up and back, in rows.
        size: width and height of the picture.
    """

    target: Array
    shift: Array
    axes: Array
    size: tuple[int, int]

    @property
    def distance(self) -> float:
        """Metres from the target to the camera."""
        return float(self.shift[2])

    def screen(self, points: Array) -> Array:
        """Points (..., 3) as x, y in pixels and depth in metres."""
        away = (points - self.target) @ self.axes.T
        depth = self.distance - away[..., 2]
        scale = self.size[1] / (FIELD * np.maximum(depth, 0.05))
        x = self.size[0] / 2 + (away[..., 0] - self.shift[0]) * scale
        y = self.size[1] / 2 - (away[..., 1] - self.shift[1]) * scale
        return np.stack([x, y, depth], axis=-1)


class Framing:
    """The places of several motions and the path of a camera.

    The camera follows the middle of all bodies, far enough away that none leaves the picture. For a fixed direction a
    point is inside the picture if four linear inequalities hold, one per edge. The largest left sides over all points,
    smoothed over time, therefore give the nearest camera position.
    """

    def __init__(self, figures: Sequence[Figure], size: tuple[int, int], top: float = 0.0) -> None:
        """Figures are in metres; size is the picture's in pixels; top pixels are kept free above heads."""
        self.size = size
        self.seconds = max((len(f.positions) - 1) / f.fps for f in figures)
        self._times = np.arange(int(np.ceil(self.seconds * _RATE)) + 1) / _RATE
        self._flesh = FLESH * max(f.stature for f in figures)
        wide = FIELD / 2 * size[0] / size[1]
        sides = wide * (1 - 2 * _EDGE)
        high = FIELD / 2
        # Tangents of the view angles to the right, left, top and bottom.
        self._tangents = np.array([sides, sides, high * (1 - 2 * top / size[1]), high * (1 - 2 * _EDGE)])
        self._nearest = DISTANCE * max(1.0, 1.2 * size[1] / size[0])
        bodies = [_at_times(f, self._times) for f in figures]
        hips = [body[:, f.hips] for f, body in zip(figures, bodies, strict=True)]
        self.angle = self._choose_angle(figures, bodies, hips)
        self.places = self._side_by_side(bodies, hips, self.angle)
        self._way = self._targets(hips, self.places)
        self._shift = self._shifts(bodies, self.places, self._way, self.angle)
        self.farthest = float(self._shift[:, 2].max())
        self._tops = [self._top(*each) for each in zip(bodies, hips, self.places, strict=True)]

    def camera(self, time: float) -> Camera:
        """The camera at a time in seconds."""
        return Camera(
            self._at(self._way, time), self._at(self._shift, time), camera_axes(self.angle), self.size
        )

    def tops(self, time: float) -> Array:
        """Smoothly moving points (N, 3) above the heads at a time."""
        return np.stack([self._at(top, time) for top in self._tops])

    def _at(self, rows: Array, time: float) -> Array:
        return np.array([np.interp(time, self._times, column) for column in rows.T])

    def _top(self, body: Array, hips: Array, place: Array) -> Array:
        heights = _largest_around(body[..., 1].max(axis=1, keepdims=True)) + self._flesh
        return _smooth(np.concatenate([hips[:, :1], heights, hips[:, 2:]], axis=1)) + place

    def _choose_angle(self, figures: Sequence[Figure], bodies: list[Array], hips: list[Array]) -> float:
        front = np.sum([_front(f) for f in figures], axis=0) / len(figures)
        facing = float(np.arctan2(front[0], front[1])) if np.hypot(*front) > 0.2 else 0.0
        if len(figures) == 1:
            way = hips[0][-1] - hips[0][0]
            travels = np.hypot(way[0], way[2]) > 1.0
            return float(np.arctan2(way[0], way[2])) + TRAVEL_ANGLE if travels else facing + SIDE_ANGLE
        some = np.unique(np.linspace(0, len(self._times) - 1, 60).astype(int))
        bodies, hips = [b[some] for b in bodies], [h[some] for h in hips]

        def cost(angle: float) -> float:
            places = self._side_by_side(bodies, hips, angle)
            way = np.mean([h + p for h, p in zip(hips, places, strict=True)], axis=0) * [1.0, 0.0, 1.0]
            far = self._fitted(self._supports(bodies, places, way, angle))[:, 2].max()
            return float(far) * (1 + _FACE * (1 - np.cos(angle - facing - SIDE_ANGLE)) / 2)

        turns = np.arange(_ANGLES) * 2 * np.pi / _ANGLES
        return float(min((facing + SIDE_ANGLE + turn for turn in turns), key=cost))

    @staticmethod
    def _side_by_side(bodies: list[Array], hips: list[Array], angle: float) -> list[Array]:
        """Translations (3,) that start the motions in a row across the picture, so that none hides another."""
        if len(bodies) == 1:
            return [np.zeros(3)]
        row = np.array([np.cos(angle), 0.0, -np.sin(angle)])
        ahead = np.array([np.sin(angle), 0.0, np.cos(angle)])
        places, reached = (
            [],
            np.zeros(len(bodies[0])),
        )  # where the next may begin along the row, at every time
        for body, hip in zip(bodies, hips, strict=True):
            along = body @ row
            shift = float((reached - along.min(axis=1)).max()) + GAP
            reached = along.max(axis=1) + shift
            places.append(shift * row - (hip[0] @ ahead) * ahead)
        middle = np.mean([h[0] + p for h, p in zip(hips, places, strict=True)], axis=0) * [1.0, 0.0, 1.0]
        return [place - middle for place in places]

    def _targets(self, hips: list[Array], places: list[Array]) -> Array:
        """The target (T, 3) of the camera: the middle of all hips, smoothed over time."""
        middle = np.mean([h + p for h, p in zip(hips, places, strict=True)], axis=0)
        way = _smooth(middle)
        # The camera follows stairs, but not steps and jumps; those use the room above the head.
        way[:, 1] = EYE + way[:, 1] - np.clip(way[:, 1], -0.5, 1.5)
        return way

    def _shifts(self, bodies: list[Array], places: list[Array], way: Array, angle: float) -> Array:
        """The shift (T, 3) from the target to the camera along its axes."""
        supports = self._supports(bodies, places, way, angle)
        # An average of maxima over an equal window is never below the values.
        return self._fitted(_smooth(_largest_around(supports)))

    def _supports(self, bodies: list[Array], places: list[Array], way: Array, angle: float) -> Array:
        """The largest left sides (T, 4) of the inequalities of the right, left, top and bottom edges."""
        axes = camera_axes(angle)
        sides = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        normals = sides @ axes[:2] + self._tangents[:, None] * axes[2]
        thick = self._flesh * np.linalg.norm(normals, axis=1)
        every = [
            (body @ normals.T).max(axis=1) + place @ normals.T
            for body, place in zip(bodies, places, strict=True)
        ]
        found: Array = np.max(every, axis=0) + thick - way @ normals.T
        return np.maximum(found, self._tangents * self._nearest)

    def _fitted(self, supports: Array) -> Array:
        """The nearest camera (T, 3) for supports (T, 4): p + t z <= c + t z_c for every point and edge."""
        right, left, top, bottom = supports.T
        t_right, t_left, t_top, t_bottom = self._tangents
        back = np.maximum((right + left) / (t_right + t_left), (top + bottom) / (t_top + t_bottom))
        across = ((right - t_right * back) + (t_left * back - left)) / 2
        # Spare room goes above the heads; the ground is at the bottom edge.
        up = np.clip(0.0, top - t_top * back, t_bottom * back - bottom)
        return np.stack([across, up, back], axis=-1)


def camera_axes(angle: float) -> Array:
    """The directions right, up and back (3, 3) of a camera at an angle in radians from +Z towards +X."""
    sine, cosine = np.sin(angle), np.cos(angle)
    back = np.array([np.cos(LIFT) * sine, np.sin(LIFT), np.cos(LIFT) * cosine])
    right = np.array([cosine, 0.0, -sine])
    return np.stack([right, np.cross(back, right), back])


def frame_at(time: float, fps: float, frames: int) -> int:
    """The frame shown at a time in seconds; the last frame is held."""
    return min(int(time * fps + 1e-6), frames - 1)


def _at_times(figure: Figure, times: Array) -> Array:
    """The figure's points (T, N, 3) at times (T,), with the floor at zero."""
    count = len(figure.positions)
    points = figure.positions[[frame_at(float(t), figure.fps, count) for t in times]]
    return points - [0.0, 0.0 if figure.floor_is_zero else figure.floor, 0.0]


def _front(figure: Figure) -> Array:
    """The mean facing direction (2,) of a figure, x and z."""
    return np.array([np.cos(figure.facing).mean(), np.sin(figure.facing).mean()])


def _smooth(rows: Array) -> Array:
    """Averages over _SMOOTHING on either side; the first and last row are held beyond the ends."""
    reach = round(_SMOOTHING * _RATE)
    padded = np.concatenate(
        [np.repeat(rows[:1], reach + 1, axis=0), rows, np.repeat(rows[-1:], reach, axis=0)]
    )
    sums = np.cumsum(padded, axis=0)
    averages: Array = (sums[2 * reach + 1 :] - sums[: -2 * reach - 1]) / (2 * reach + 1)
    return averages


def _largest_around(rows: Array) -> Array:
    """The maximum of each column over _SMOOTHING on either side."""
    reach = round(_SMOOTHING * _RATE)
    padded = np.pad(rows, ((reach, reach), (0, 0)), mode="edge")
    largest: Array = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=0).max(axis=-1)
    return largest
