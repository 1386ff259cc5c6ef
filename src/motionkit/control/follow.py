"""A character along a path: the library call behind `motionkit follow-path` (paper 5.2)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from motionkit.arrays import Array
from motionkit.control.first_steps import FirstSteps
from motionkit.control.momentum import asked_speed
from motionkit.control.opening import opening
from motionkit.control.path import SPACING, Path2D
from motionkit.control.reference_player import ReferencePlayer
from motionkit.control.speeds import acceleration_limit, part_speeds
from motionkit.control.steering import RUN_SPEED, WALK_SPEED, steered_type, usual_gaits
from motionkit.control.synthesize import SynthesisOptions, check_size, finish_motions
from motionkit.errors import ControlError
from motionkit.features.control import TRAJECTORY_OFFSETS, TYPE_BLEND_FRAMES, Controls
from motionkit.inference.noise import default_noise
from motionkit.inference.rollout import RolloutState, run
from motionkit.metrics.trajectory import TrajectoryDistance, trajectory_distance
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import rotate_ground

# The place on the path is sought from a little behind the last one to a little ahead, so that a path
# that crosses itself is not cut short.
SEARCH_BACK, SEARCH_AHEAD = 30.0, 60.0
PATIENCE = 1.6  # times the expected duration, after which the end is given up
BLEND_SAMPLES = 16
# cm/s^2 by which a path's speed changes at most: what 98 % of the frames of recorded runs brake less than.
ACCELERATION = 220.0
CREEP = 10.0  # cm/s, the slowest way to a stop
ARRIVED = 8.0  # cm before a stop at which it has been reached
# Where a path turns back on itself: cosine between the ways there and back, how much further (cm) the body has to go
# along the first to a place beyond the turn, and how far that may be beside it.
BACK, NO_FURTHER, BESIDE = -0.9, 1.0, 15.0
NEARER = 5.0  # cm by which the way back has to be nearer than the way there before the turn
# Cosine between the ways before and after a turn that bodies slow down for, to so many cm/s (faster ones leap around
# it), and how many points of the path to both sides tell.
SHARP, TURN_SPEED, BESIDE_TURN = -0.8, 30.0, 3
TOO_SLOW = 0.99  # of the slowest recorded speed of a run, below which a body walks


@dataclass(frozen=True, eq=False)
class FollowResult:
    """A motion along a path.

    Attributes:
        motion: what to write.
        distance: to the whole path, on the default body.
        part_distances: mean and largest distance (cm) of the frames on each part, None for a part not reached.
        part_frames: frames at the model's rate spent on each part.
        finished: whether the end was reached.
        seconds: how long the roll-out took.
        frames: frames at the model's rate.
        raw: the network's output, with feet not locked, if options.raw asks for it.
    """

    motion: Motion
    distance: TrajectoryDistance
    part_distances: tuple[tuple[float, float] | None, ...]
    part_frames: tuple[int, ...]
    finished: bool
    seconds: float
    frames: int
    raw: Motion | None = None


class PathFollower:
    """Turns a path into the controls of every frame for one character; a Controller.

    Who walks or runs takes the speed and the turns of the path, and the first steps after a stop from recordings; other
    types are moved by recordings, which choice picks among.
    """

    def __init__(self, model: MotionModel, path: Path2D, choice: int = 0, behind: int = 0) -> None:
        """behind: frames of the first part's performance that lie behind already."""
        self.model, self.path, self.fps = model, path, model.fps
        self.player, self.behind = ReferencePlayer(model, choice, own_share=0.0), behind
        self.first_steps = FirstSteps(model, choice)
        self.type_count = len(model.types)
        self.speeds = speed_profile(model, path)
        self.shown = shown_types(model, path, self.speeds)
        gaits = [model.types[part.type].gait for part in path.parts]
        self.stops = list(path.stops)  # those to come
        stand = usual_gaits(model).stand
        self.stand = None if stand is None else model.type_id(stand)
        self.stood: int | None = None  # frames since the stop was reached
        self.facings = np.array([0.0 if gait is None else gait.facing for gait in gaits], np.float32)
        self.entered = -1  # the part the character is on
        self.arc = self.least = (
            0.0  # on the path, and the least to be sought from: what lies before is behind
        )
        self.arcs: list[float] = []

    @property
    def expected_seconds(self) -> float:
        """How long the path takes at the asked speeds."""
        return _seconds_along(self.path, self.speeds)

    @property
    def finished(self) -> bool:
        """Whether the end has been reached, and no stop is to come."""
        return self.arc >= self.path.length - SPACING and not self.stops

    def __call__(self, frame: int, ground: Array) -> Controls:
        self.arc = self._project(ground[0, :2])
        self.arcs.append(self.arc)
        stood = self.stood
        standing = self._standing()
        goes_on = stood is not None and self.stood is None
        ahead = self._arcs_ahead(TRAJECTORY_OFFSETS, self.arc)
        points, tangents = self.path.at(ahead)
        heading = ground[0, 2]
        positions = rotate_ground(-heading, points - ground[0, :2])
        facing = self.facings[self.path.part_at(ahead)]
        directions = rotate_ground(-heading - facing, tangents)
        trajectory = np.concatenate([positions.reshape(-1), directions.reshape(-1)])
        part = int(self.path.part_at(self.arc))
        kind = self.path.parts[part].type
        if self.model.types[kind].steered:
            self.entered = part
        if self.model.types[kind].steered or standing:
            asked = Controls.of_types(self._type_weights(standing=standing)[None])
            if goes_on and self.model.types[kind].goes:
                self.first_steps.begin(kind)
            if not standing and self.first_steps.takes(kind):
                asked = self.first_steps.reference(asked, trajectory[None])
        else:
            if part != self.entered:
                behind = self.behind if self.entered < 0 else 0
                self.player.begin(kind, behind=behind, speed=asked_speed(trajectory, self.fps))
                self.entered = part
            asked = replace(self.player.play(1, trajectory[None]), type_weights=self._type_weights()[None])
        # On a path the trajectory comes first, wherever the feet stand and whatever the recording's trajectory was.
        free = np.zeros(1, np.float32)
        if self.model.plain:
            asked = replace(asked, types_ahead=np.stack([self._type_weights(arc) for arc in ahead])[None])
        return replace(asked, trajectory=trajectory[None], slip_correction=free).with_mask(1.0)

    def _standing(self) -> float:
        """Share of standing still in this frame's type: it comes and goes over half a blend around a stop."""
        if not self.stops:
            return 0.0
        place, seconds = self.stops[0]
        if self.stood is None:
            if self.arc < place - ARRIVED:
                return 0.0
            self.stood = 0
        self.stood += 1
        left, half = round(seconds * self.fps) - self.stood, TYPE_BLEND_FRAMES // 2
        if left < 0:
            self.stood = None
            del self.stops[0]
            return 0.0
        return min(self.stood, left, half) / half

    def _project(self, point: Array) -> float:
        arc = self._nearest(point)
        # Where a path turns back on itself, the way there is as near as the way back: who has no further to go to a
        # place beyond the turn is on the way back, and stays there.
        beyond = self._arcs_ahead(TRAJECTORY_OFFSETS[:1], arc)
        (there,), (way_back,) = self.path.at(beyond)
        way = self.path.tangents[self.path.nearest(arc)]
        if float(way_back @ way) < BACK and float((there - point) @ way) < NO_FURTHER:
            if float(np.linalg.norm(there - point)) < BESIDE:
                self.least = arc = float(beyond[0])
        return arc

    def _nearest(self, point: Array) -> float:
        first = max(0, int(max(self.arc - SEARCH_BACK, self.least) / SPACING))
        last = min(len(self.path.points), int((self.arc + SEARCH_AHEAD) / SPACING) + 2)
        away = np.linalg.norm(self.path.points[first:last] - point, axis=-1)
        nearest = first + int(away.argmin())
        # The way back is no better than the way there for being nearer by a little.
        ways = self.path.tangents[first:last] @ self.path.tangents[self.path.nearest(self.arc)]
        if float(ways[nearest - first]) < BACK:
            there = np.flatnonzero((ways > 0.0) & (away < away.min() + NEARER))
            nearest = first + int(there[away[there].argmin()]) if len(there) else nearest
        # Past the last point the way on is counted along its direction, so that the end can be reached.
        beyond = float(((point - self.path.points[-1]) * self.path.tangents[-1]).sum())
        arc = nearest * SPACING
        return arc + max(0.0, beyond) if nearest == len(self.path.points) - 1 else arc

    def _arcs_ahead(self, frames: Sequence[int], start: float) -> Array:
        """Arc lengths frames (sorted, from 1) ahead of an arc at the wanted speeds, part by part."""
        out, arc, frame = [], start, 0
        end = self.stops[0][0] if self.stops else math.inf
        for wanted in frames:
            while frame < wanted:
                step = min(5, wanted - frame)
                arc = min(arc + self._speed_at(arc) * step / self.fps, max(end, start))
                frame += step
            out.append(arc)
        return np.array(out, np.float32)

    def _speed_at(self, arc: float) -> float:
        """Speed in cm/s at an arc length."""
        return float(self.speeds[self.path.nearest(arc)])

    def _type_weights(self, arc: float | None = None, standing: float = 0.0) -> Array:
        """Type weights (N,), here or at an arc: the mean over half a blend behind and ahead, 40 frames in all.

        standing: the share of standing still.
        """
        arc = self.arc if arc is None else arc
        half = TYPE_BLEND_FRAMES // 2
        reach = self._speed_at(arc) * half / self.fps
        arcs = np.linspace(arc - reach, arc + reach, BLEND_SAMPLES)
        kinds = self.shown[self.path.nearest(arcs)]
        weights = np.eye(self.type_count, dtype=np.float32)[kinds].mean(axis=0)
        if standing and self.stand is not None:
            weights *= 1.0 - standing
            weights[self.stand] += standing
        return weights


def speed_profile(model: MotionModel, path: Path2D) -> Array:
    """Speed (N,) in cm/s at each point of the path, which changes no faster than bodies brake and start, to each stop.

    The beginning is as fast as its part: start poses are in motion.
    """
    speeds = part_speeds(model, path)[path.part].astype(np.float64)
    sharp = _sharp_turns(path)
    speeds[sharp] = np.minimum(speeds[sharp], TURN_SPEED)
    for place, _ in path.stops:
        speeds[path.nearest(place)] = CREEP
    # The square of the speed changes evenly along the way: no point's is more than so much above another's.
    slope = 2.0 * ACCELERATION * SPACING * np.arange(len(speeds))
    squares = np.minimum.accumulate(speeds * speeds - slope) + slope
    squares = np.minimum.accumulate((squares + slope)[::-1])[::-1] - slope
    return np.sqrt(squares).astype(np.float32)


def shown_types(model: MotionModel, path: Path2D, speeds: Array) -> Array:
    """The number (N,) of the type shown at each point: who runs walks where the path is slower than any recorded run.

    Args:
        speeds: (N,) speed_profile. It is slow around stops and sharp turns.
    """
    shown = np.array([model.type_id(part.type) for part in path.parts])[path.part]
    walk = steered_type(model, (0.0, WALK_SPEED), 0.0)
    slower = model.speed_range(walk)
    for number, part in enumerate(path.parts):
        gait, span = model.types[part.type].gait, model.speed_range(part.type)
        if gait and span and slower and gait.speed > RUN_SPEED and slower[0] < span[0]:
            shown[(path.part == number) & (speeds < TOO_SLOW * span[0])] = model.type_id(walk)
    return shown


def _sharp_turns(path: Path2D) -> Array:
    """Whether the path turns sharply at each point (N,)."""
    before, after = path.tangents[: -2 * BESIDE_TURN], path.tangents[2 * BESIDE_TURN :]
    sharp = np.zeros(len(path.points), bool)
    sharp[BESIDE_TURN : len(sharp) - BESIDE_TURN] = (before * after).sum(axis=-1) < SHARP
    return sharp


def expected_seconds(model: MotionModel, path: Path2D) -> float:
    """How long the path takes at the asked speeds."""
    return _seconds_along(path, speed_profile(model, path))


def _seconds_along(path: Path2D, speeds: Array) -> float:
    return float((SPACING / speeds).sum()) + sum(seconds for _, seconds in path.stops)


def follow_path(
    model: MotionModel,
    path: Path2D,
    options: SynthesisOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> FollowResult:
    """Synthesize a motion along a path; the same seed gives the same motion.

    Raises:
        ControlError: for an unknown type or character, or a path that takes too long.
    """
    options = options or SynthesisOptions()
    skeleton = model.character(options.character)
    if options.count != 1:
        raise ControlError("a path is followed by one character at a time")
    first = path.parts[0].type
    weights = np.zeros((1, len(model.types)), np.float32)
    weights[0, model.type_id(first)] = 1.0
    body = model.moved_skeleton(options.character)
    begin = opening(model, first, body, options.init)
    follower = PathFollower(model, path, options.seed, begin.behind)
    check_size(follower.expected_seconds, model.fps, options)
    tangent = path.tangents[0]
    heading = math.atan2(*tangent) - follower.facings[0]
    place = np.array([[*path.points[0], heading]], np.float32)
    limit = int((PATIENCE * follower.expected_seconds + 3.0) * model.fps)
    state = RolloutState(model, 1, options.noise or default_noise(model), options.seed)
    state.controls.set_skeletons([body])
    state.start(begin.start.features, begin.start.contacts, weights, place, begin.length)

    furthest = 0.0

    def report(frame: int) -> None:
        nonlocal furthest
        furthest = max(furthest, follower.arc / path.length)
        if progress:
            progress(min(1.0, furthest))

    def finished() -> bool:
        return follower.finished

    began = time.perf_counter()
    rollout = run(state, limit, follower, report, finished)
    seconds = time.perf_counter() - began
    track = rollout.ground[0, :, :2]
    most = acceleration_limit(model, [part.type for part in path.parts])
    motion, raw = finish_motions(model, rollout, 0, skeleton, options, most)
    return FollowResult(
        motion,
        trajectory_distance(track, path.points),
        _part_distances(track, follower.arcs, path),
        tuple(np.bincount(path.part_at(np.array(follower.arcs)), minlength=len(path.parts)).tolist()),
        finished(),
        seconds,
        len(track),
        raw,
    )


def _part_distances(track: Array, arcs: list[float], path: Path2D) -> tuple[tuple[float, float] | None, ...]:
    parts = path.part_at(np.array(arcs))
    out: list[tuple[float, float] | None] = []
    for index in range(len(path.parts)):
        mine = track[: len(parts)][parts == index]
        if len(mine) == 0:
            out.append(None)
            continue
        distance = trajectory_distance(mine, path.points)
        out.append((distance.mean, distance.max))
    return tuple(out)
