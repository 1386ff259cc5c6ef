"""Path following: the library call behind `motionkit follow-path` (paper 5.2)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from motionkit.arrays import Array
from motionkit.control.character_start import character_start
from motionkit.control.memory import FirstSteps
from motionkit.control.momentum import trajectory_speed
from motionkit.control.path import Path2D
from motionkit.control.path_place import PathPlace
from motionkit.control.plan import Plan, plan_path
from motionkit.control.reference_player import ReferencePlayer
from motionkit.control.script import TypePart
from motionkit.control.speeds import acceleration_limit
from motionkit.control.synthesize import SynthesisOptions, check_size, finished, unfinished
from motionkit.errors import ControlError, naming
from motionkit.features.control import Controls
from motionkit.finish.finish import Unfinished
from motionkit.inference.noise import default_noise
from motionkit.inference.rollout import RolloutState, run
from motionkit.metrics.trajectory import TrajectoryDistance, trajectory_distance
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind
from motionkit.motion.motion import Motion

PATIENCE = 1.6  # factor on the expected duration (plus 3 s), after which the roll-out stops
# Gaits whose median recording lasts at least LONG_SECONDS guide it on a path, with a share GUIDED of the type's gain.
# Shorter recordings follow one another too quickly for the feet. Chosen by foot sliding and arm swing.
LONG_SECONDS, GUIDED = 2.0, 0.6


@dataclass(frozen=True, eq=False)
class FollowResult:
    """A motion along a path.

    Attributes:
        motion: the finished motion.
        distance: distance to the whole path, on the default body.
        part_distances: mean and largest distance (cm) of the frames on each part; None for a part not reached.
        part_frames: frames at the model's rate on each part, by their places.
        types: the type of each part, and its seconds, with the stop after it.
        finished: whether the character reached the end.
        seconds: duration of the roll-out.
        frames: frames at the model's rate.
        raw: the motion before finishing, if options.raw is set.
        unfinished: the motion before finishing, with its contacts, to finish it on a rig instead.
    """

    motion: Motion
    distance: TrajectoryDistance
    part_distances: tuple[tuple[float, float] | None, ...]
    part_frames: tuple[int, ...]
    types: tuple[TypePart, ...]
    finished: bool
    seconds: float
    frames: int
    raw: Motion | None = None
    unfinished: Unfinished | None = None


class PathFollower:
    """Turns a planned path into the controls of every frame for one character; a Controller.

    Gaits take speed and turns from the path, and their first steps after a stop from recordings. Gaits with long
    recordings also move their arms and trunk as these do. Other types follow recordings; choice picks among these.
    """

    def __init__(self, model: MotionModel, plan: Plan, choice: int = 0, behind: int = 0) -> None:
        """Take a plan from plan_path; behind counts the frames of the first part's performance already shown."""
        assert plan.route is not None
        self.model, self.plan, self.behind = model, plan, behind
        self.route = plan.route
        self.place = PathPlace(plan.route)
        self.player = ReferencePlayer(model, choice, recorded_share=0.0)
        self.first_steps = FirstSteps(model, choice)
        self.guided = {part.type for part in plan.route.path.parts if _guides(model, part.type)}
        self.entered = -1  # the present part
        self.parts: list[int] = []  # of every frame, by its place
        self.shown: list[int] = []  # the same, but a stop belongs to the part before it

    @property
    def finished(self) -> bool:
        """Whether the character has reached the end and no stop is left."""
        return self.place.finished

    def frames_of(self, parts: list[int]) -> tuple[int, ...]:
        """How many frames each part of the path has in parts or shown."""
        return tuple(np.bincount(parts, minlength=len(self.route.path.parts)).tolist())

    def bands(self) -> tuple[TypePart, ...]:
        """The type of each part of the path, and how long it was shown."""
        shown = zip(self.route.path.parts, self.frames_of(self.shown), strict=True)
        return tuple(TypePart(part.type, frames / self.model.fps) for part, frames in shown)

    def __call__(self, frame: int, ground: Array) -> Controls:
        """Controls (1, ...) of a frame for a body at ground (1, 3)."""
        place, path = self.place, self.route.path
        standing = place.move(ground[0])
        trajectory, part = np.array(place.words.trajectory, np.float32), place.words.present
        self.parts.append(part)
        # A body that stands at a stop may be past the end of its part by a few centimetres.
        self.shown.append(place.words.stop if place.words.stood >= 0 else part)
        kind = self.model.kind(path.parts[part].type)
        controls = Controls.of_types(place.weights[None].copy())
        if kind.steered:
            self.entered = part
        if kind.steered or standing:
            goes_on = place.words.goes_on and kind is MotionKind.GAIT
            controls = self._steered(path.parts[part].type, controls, trajectory, standing, goes_on)
        else:
            controls = replace(self._recorded(part, trajectory), type_weights=controls.type_weights)
        # The path comes first: no root-slip correction, and the recorded trajectory does not count.
        free = np.zeros(1, np.float32)
        if self.model.plain:
            ahead = np.stack([place.type_weights(arc) for arc in place.words.ahead])
            controls = replace(controls, types_ahead=ahead[None])
        return replace(controls, trajectory=trajectory[None], slip_correction=free).with_mask(1.0)

    def _steered(
        self, kind: str, controls: Controls, trajectory: Array, standing: float, goes_on: bool
    ) -> Controls:
        """Controls (1, ...) of a gait or of standing; goes_on begins first steps, which follow recordings."""
        if goes_on:
            self.first_steps.begin(kind)
        if not standing and self.first_steps.takes(kind):
            return self.first_steps.reference(controls, trajectory[None])
        return controls if standing or kind not in self.guided else self._guided(kind, controls, trajectory)

    def _guided(self, kind: str, controls: Controls, trajectory: Array) -> Controls:
        """Add reference poses of a gait to its controls (1, ...), more of them the more of the gait is blended in."""
        if self.player.kind != kind:
            self.player.begin(kind, speed=trajectory_speed(trajectory, self.model.fps))
        played = self.player.play(1, trajectory[None])
        share = np.float32(GUIDED) * controls.type_weights[:, self.model.type_id(kind)]
        return replace(controls, reference=played.reference, reference_gain=share * played.reference_gain)

    def _recorded(self, part: int, trajectory: Array) -> Controls:
        """Controls (1, ...) of a part that follows recordings."""
        if part != self.entered:
            behind = self.behind if self.entered < 0 else 0
            speed = trajectory_speed(trajectory, self.model.fps)
            self.player.begin(self.route.path.parts[part].type, behind=behind, speed=speed)
            self.entered = part
        return self.player.play(1, trajectory[None])


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
    plan = plan_path(model, path)
    first = plan.segments[0].type
    weights = model.type_weights(first)[None]
    body = model.moved_skeleton(options.character)
    begin = character_start(model, first, body, options.init)
    follower = PathFollower(model, plan, options.seed, begin.start_state.behind)
    with naming(f"a path of {path.length:.0f} cm", ControlError):
        check_size(plan.seconds, model.fps, options)
    tangent = path.tangents[0]
    heading = math.atan2(*tangent) - follower.route.facings[0]
    place = np.array([[*path.points[0], heading]], np.float32)
    limit = int((PATIENCE * plan.seconds + 3.0) * model.fps)
    state = RolloutState(model, 1, options.noise or default_noise(model), options.seed)
    state.controls.set_skeletons([body])
    state.start(begin.start.features, begin.start.contacts, weights, place, begin.length)

    furthest = 0.0

    def report(frame: int) -> None:
        nonlocal furthest
        furthest = max(furthest, follower.place.arc / path.length)
        if progress:
            progress(min(1.0, furthest))

    began = time.perf_counter()
    rollout = run(state, limit, follower, report, lambda: follower.finished)
    seconds = time.perf_counter() - began
    track = rollout.ground[0, :, :2]
    most = acceleration_limit(model, [part.type for part in path.parts])
    drawn = unfinished(model, rollout, 0, skeleton, most)
    motion, raw = finished(model, drawn, skeleton, options)
    return FollowResult(
        motion,
        trajectory_distance(track, path.points),
        _part_distances(track, np.array(follower.parts), path),
        follower.frames_of(follower.parts),
        follower.bands(),
        follower.finished,
        seconds,
        len(track),
        raw,
        drawn,
    )


def _guides(model: MotionModel, kind: str) -> bool:
    """Whether recordings of a gait last long enough to guide it on a path."""
    clips = model.types[kind].reference_clips if model.uses_references and kind in model.types else ()
    if model.kind(kind) is not MotionKind.GAIT or not clips:
        return False
    return float(np.median([len(clip) for clip in clips])) >= LONG_SECONDS * model.fps


def _part_distances(track: Array, parts: Array, path: Path2D) -> tuple[tuple[float, float] | None, ...]:
    out: list[tuple[float, float] | None] = []
    for index in range(len(path.parts)):
        mine = track[: len(parts)][parts == index]
        if len(mine) == 0:
            out.append(None)
            continue
        distance = trajectory_distance(mine, path.points)
        out.append((distance.mean, distance.max))
    return tuple(out)
