"""Places motions side by side, with a camera that keeps them all in the picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motionkit.view.contact_sheet_geometry import Figure
from motionkit.view.surface import Array

FIELD = 0.6  # height of the view at distance 1
DISTANCE = 4.0  # m, least distance from the camera to its target
LIFT = 0.17  # radians, downward pitch of the camera
EYE = 0.9  # m, height of the target
GAP = 0.6  # m, least distance between joints of two bodies
FLESH = 0.09  # distance from joints to the body's surface, as a share of the stature
SIDE_ANGLE = 0.55  # radians between the camera and the bodies' heading
TRAVEL_ANGLE = 0.95  # radians between the camera and the direction of travel
_RATE = 30.0  # samples per second of the camera's path
_SMOOTHING = 0.4  # s on either side over which the camera's path is averaged
_ANGLES = 16  # number of camera directions to try
_FACE = 0.3  # a view of faces may need this much more distance than one of backs, as a share
_EDGE = 0.05  # free margin at the sides and bottom, as a share of the picture


@dataclass(frozen=True, eq=False)
class Camera:
    """The camera at one time.

    Attributes:
        target: (3,) the point it looks at if not shifted, m.
        shift: (3,) from the target to the camera along right, up and back, m.
        axes: (3, 3) the directions right, up and back, as rows.
        size: width and height of the picture in pixels.
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
    """Positions of several motions, and a camera path.

    The camera follows the middle of all bodies at a distance that keeps each in the picture. For a fixed direction, a
    point is in the picture if four linear inequalities hold, one per edge. The nearest camera position therefore
    follows from the maximum of their left sides over all points, smoothed over time.
    """

    def __init__(self, figures: Sequence[Figure], size: tuple[int, int], top: float = 0.0) -> None:
        """Figures are in metres; size is in pixels; `top` pixels stay free above the heads."""
        self.size = size
        self.seconds = max((len(f.positions) - 1) / f.fps for f in figures)
        self._times = np.arange(int(np.ceil(self.seconds * _RATE)) + 1) / _RATE
        self._flesh = FLESH * max(f.stature for f in figures)
        wide = FIELD / 2 * size[0] / size[1]
        sides = wide * (1 - 2 * _EDGE)
        high = FIELD / 2
        # Tangents of the view angles: right, left, top, bottom.
        self._tangents = np.array([sides, sides, high * (1 - 2 * top / size[1]), high * (1 - 2 * _EDGE)])
        self._nearest = DISTANCE * max(1.0, 1.2 * size[1] / size[0])
        bodies = [_at_times(f, self._times) for f in figures]
        hips = [body[:, f.hips] for f, body in zip(figures, bodies, strict=True)]
        self.angle = self._choose_angle(figures, bodies, hips)
        self.places = self._side_by_side(bodies, hips, self.angle)
        self._target = self._targets(hips, self.places)
        self._shift = self._shifts(bodies, self.places, self._target, self.angle)
        self.farthest = float(self._shift[:, 2].max())
        self._tops = [self._top(*each) for each in zip(bodies, hips, self.places, strict=True)]

    def camera(self, time: float) -> Camera:
        """The camera at a time in seconds."""
        return Camera(
            self._at(self._target, time), self._at(self._shift, time), camera_axes(self.angle), self.size
        )

    def tops(self, time: float) -> Array:
        """Points (N, 3) above the heads at a time, smoothed over time."""
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
            travel = hips[0][-1] - hips[0][0]
            travels = np.hypot(travel[0], travel[2]) > 1.0
            return float(np.arctan2(travel[0], travel[2])) + TRAVEL_ANGLE if travels else facing + SIDE_ANGLE
        some = np.unique(np.linspace(0, len(self._times) - 1, 60).astype(int))
        bodies, hips = [b[some] for b in bodies], [h[some] for h in hips]

        def cost(angle: float) -> float:
            places = self._side_by_side(bodies, hips, angle)
            target = np.mean([h + p for h, p in zip(hips, places, strict=True)], axis=0) * [1.0, 0.0, 1.0]
            far = self._fitted(self._supports(bodies, places, target, angle))[:, 2].max()
            return float(far) * (1 + _FACE * (1 - np.cos(angle - facing - SIDE_ANGLE)) / 2)

        turns = np.arange(_ANGLES) * 2 * np.pi / _ANGLES
        return float(min((facing + SIDE_ANGLE + turn for turn in turns), key=cost))

    @staticmethod
    def _side_by_side(bodies: list[Array], hips: list[Array], angle: float) -> list[Array]:
        """Translations (3,) that put the motions in a row across the picture, so that none hides another."""
        if len(bodies) == 1:
            return [np.zeros(3)]
        row = np.array([np.cos(angle), 0.0, -np.sin(angle)])
        ahead = np.array([np.sin(angle), 0.0, np.cos(angle)])
        places, reached = (
            [],
            np.zeros(len(bodies[0])),
        )  # where the previous body ends along the row, at every time
        for body, hip in zip(bodies, hips, strict=True):
            along = body @ row
            shift = float((reached - along.min(axis=1)).max()) + GAP
            reached = along.max(axis=1) + shift
            places.append(shift * row - (hip[0] @ ahead) * ahead)
        middle = np.mean([h[0] + p for h, p in zip(hips, places, strict=True)], axis=0) * [1.0, 0.0, 1.0]
        return [place - middle for place in places]

    def _targets(self, hips: list[Array], places: list[Array]) -> Array:
        """The camera's target (T, 3): the middle of all hips, smoothed over time."""
        middle = np.mean([h + p for h, p in zip(hips, places, strict=True)], axis=0)
        target = _smooth(middle)
        # Follow stairs but not steps and jumps, which use the free room above the head.
        target[:, 1] = EYE + target[:, 1] - np.clip(target[:, 1], -0.5, 1.5)
        return target

    def _shifts(self, bodies: list[Array], places: list[Array], target: Array, angle: float) -> Array:
        """The shift (T, 3) from the target to the camera, along the camera's axes."""
        supports = self._supports(bodies, places, target, angle)
        # An average of maxima over an equally wide window is never below the values.
        return self._fitted(_smooth(_largest_around(supports)))

    def _supports(self, bodies: list[Array], places: list[Array], target: Array, angle: float) -> Array:
        """The largest left sides (T, 4) of the inequalities for the right, left, top and bottom edges."""
        axes = camera_axes(angle)
        sides = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        normals = sides @ axes[:2] + self._tangents[:, None] * axes[2]
        thick = self._flesh * np.linalg.norm(normals, axis=1)
        every = [
            (body @ normals.T).max(axis=1) + place @ normals.T
            for body, place in zip(bodies, places, strict=True)
        ]
        found: Array = np.max(every, axis=0) + thick - target @ normals.T
        return np.maximum(found, self._tangents * self._nearest)

    def _fitted(self, supports: Array) -> Array:
        """The nearest camera (T, 3) for which p + t z <= c + t z_c at every point and edge; supports (T, 4)."""
        right, left, top, bottom = supports.T
        t_right, t_left, t_top, t_bottom = self._tangents
        back = np.maximum((right + left) / (t_right + t_left), (top + bottom) / (t_top + t_bottom))
        across = ((right - t_right * back) + (t_left * back - left)) / 2
        # Free space goes above the heads; the ground touches the bottom edge.
        up = np.clip(0.0, top - t_top * back, t_bottom * back - bottom)
        return np.stack([across, up, back], axis=-1)


def camera_axes(angle: float) -> Array:
    """The camera's right, up and back directions (3, 3) at an angle in radians from +Z towards +X."""
    sine, cosine = np.sin(angle), np.cos(angle)
    back = np.array([np.cos(LIFT) * sine, np.sin(LIFT), np.cos(LIFT) * cosine])
    right = np.array([cosine, 0.0, -sine])
    return np.stack([right, np.cross(back, right), back])


def frame_at(time: float, fps: float, frames: int) -> int:
    """The frame at a time in seconds; the last frame is held."""
    return min(int(time * fps + 1e-6), frames - 1)


def _at_times(figure: Figure, times: Array) -> Array:
    """The figure's points (T, N, 3) at times (T,), on a floor at height zero."""
    count = len(figure.positions)
    points = figure.positions[[frame_at(float(t), figure.fps, count) for t in times]]
    return points - [0.0, 0.0 if figure.floor_is_zero else figure.floor, 0.0]


def _front(figure: Figure) -> Array:
    """The mean heading (2,) of a figure, x and z."""
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
