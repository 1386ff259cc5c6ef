"""Where motions stand beside each other, and a camera that keeps all of them in the picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motionkit.view.contact_sheet_geometry import Figure
from motionkit.view.surface import Array

FIELD = 0.6  # height of what is seen at a distance of 1
DISTANCE = 4.0  # m from the camera to what it looks at, if nothing is further out
LIFT = 0.17  # radians the camera looks down
EYE = 0.9  # m, what it looks at
GAP = 0.6  # m at least between the joints of bodies side by side
FLESH = 0.09  # statures from a joint to the outside of the body
SIDE_ANGLE = 0.55  # radians between the camera and the front of those it looks at
TRAVEL_ANGLE = 0.95  # and between it and the way of one that travels
_RATE = 30.0  # times a second the camera's way is worked out for
_SMOOTHING = 0.4  # s either side that it is averaged over
_ANGLES = 16  # that are tried
_FACE = 0.3  # how much further away faces may be than backs, as a share
_EDGE = 0.05  # share of the picture left free at the sides and the bottom


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera at one moment.

    Attributes:
        target: (3,) what it looks at if nothing is further out, m.
        shift: (3,) to the right, up and back from the target to where it is, m.
        axes: (3, 3) its directions right, up and back, in rows.
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
    """The places of several motions and the way of a camera.

    The camera goes along with the middle of all, and so far back that nobody leaves the picture. With the
    direction fixed, a point is inside if four linear inequalities hold, one for each edge of the picture:
    so the largest left sides over all points, smoothed over time, give the nearest place for the camera.
    """

    def __init__(self, figures: Sequence[Figure], size: tuple[int, int], top: float = 0.0) -> None:
        """Figures in metres; size is the picture's in pixels, top how many of them to keep free above heads."""
        self.size = size
        self.seconds = max((len(f.positions) - 1) / f.fps for f in figures)
        self._times = np.arange(int(np.ceil(self.seconds * _RATE)) + 1) / _RATE
        self._flesh = FLESH * max(f.stature for f in figures)
        wide = FIELD / 2 * size[0] / size[1]
        sides = wide * (1 - 2 * _EDGE)
        high = FIELD / 2
        # Tangents of what may be seen to the right, left, top and bottom.
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
        """(N, 3) points above the motions' heads at a time, which move gently."""
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
        """(3,) to move each by: they begin in a row across the picture and never walk behind each other."""
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
        """(T, 3) what the camera looks at: the middle of all hips, smooth over time."""
        middle = np.mean([h + p for h, p in zip(hips, places, strict=True)], axis=0)
        way = _smooth(middle)
        # Steps and jumps are left to the room above the head; stairs are not.
        way[:, 1] = EYE + way[:, 1] - np.clip(way[:, 1], -0.5, 1.5)
        return way

    def _shifts(self, bodies: list[Array], places: list[Array], way: Array, angle: float) -> Array:
        """(T, 3) from the target to the camera along its axes."""
        supports = self._supports(bodies, places, way, angle)
        # An average of maxima over as long holds every one of the values.
        return self._fitted(_smooth(_largest_around(supports)))

    def _supports(self, bodies: list[Array], places: list[Array], way: Array, angle: float) -> Array:
        """(T, 4) the largest left side of the inequalities of the right, left, top and bottom edge."""
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
        """(T, 3) the nearest camera for supports (T, 4): p + t z <= c + t z_c for every point and edge."""
        right, left, top, bottom = supports.T
        t_right, t_left, t_top, t_bottom = self._tangents
        back = np.maximum((right + left) / (t_right + t_left), (top + bottom) / (t_top + t_bottom))
        across = ((right - t_right * back) + (t_left * back - left)) / 2
        # Free room goes above the heads: the ground is where a picture begins.
        up = np.clip(0.0, top - t_top * back, t_bottom * back - bottom)
        return np.stack([across, up, back], axis=-1)


def camera_axes(angle: float) -> Array:
    """(3, 3) the directions right, up and back of a camera that stands at an angle from +Z towards +X."""
    sine, cosine = np.sin(angle), np.cos(angle)
    back = np.array([np.cos(LIFT) * sine, np.sin(LIFT), np.cos(LIFT) * cosine])
    right = np.array([cosine, 0.0, -sine])
    return np.stack([right, np.cross(back, right), back])


def frame_at(time: float, fps: float, frames: int) -> int:
    """The frame shown at a time; the last one stays."""
    return min(int(time * fps + 1e-6), frames - 1)


def _at_times(figure: Figure, times: Array) -> Array:
    """(T, N, 3) the figure's points at times, the floor at zero."""
    count = len(figure.positions)
    points = figure.positions[[frame_at(float(t), figure.fps, count) for t in times]]
    return points - [0.0, 0.0 if figure.floor_is_zero else figure.floor, 0.0]


def _front(figure: Figure) -> Array:
    """(2,) x and z of where a figure faces, averaged over time."""
    return np.array([np.cos(figure.facing).mean(), np.sin(figure.facing).mean()])


def _smooth(rows: Array) -> Array:
    """Averages over _SMOOTHING either side; the first and last row go on beyond the ends."""
    reach = round(_SMOOTHING * _RATE)
    padded = np.concatenate(
        [np.repeat(rows[:1], reach + 1, axis=0), rows, np.repeat(rows[-1:], reach, axis=0)]
    )
    sums = np.cumsum(padded, axis=0)
    averages: Array = (sums[2 * reach + 1 :] - sums[: -2 * reach - 1]) / (2 * reach + 1)
    return averages


def _largest_around(rows: Array) -> Array:
    """The largest of each column over _SMOOTHING either side."""
    reach = round(_SMOOTHING * _RATE)
    padded = np.pad(rows, ((reach, reach), (0, 0)), mode="edge")
    largest: Array = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=0).max(axis=-1)
    return largest
