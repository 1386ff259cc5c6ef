"""A user's wishes, which change at any moment, as the controls of every frame: what live control needs."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from motionkit.arrays import Array
from motionkit.control.first_steps import FirstSteps
from motionkit.control.follow import PathFollower
from motionkit.control.gait_limits import GaitLimits
from motionkit.control.path import SPACING, Path2D
from motionkit.control.reference_player import ReferencePlayer
from motionkit.control.speed_trim import SpeedTrim
from motionkit.control.steering import (
    STANDS_BELOW,
    Steering,
    SteeringOptions,
    steered_type,
)
from motionkit.errors import ControlError
from motionkit.features.control import Controls
from motionkit.models.model import MotionModel
from motionkit.names import nfc

DEFAULT_SECONDS = 2.0  # of a performance of a type that has no length of its own
PATH = ""  # stands for a type where a path names the types
_TRAJECTORY = ("trajectory", "trajectory_mask")
AFTER_EVENT = 10  # frames of the recording that follow a strike or jump


FASTEST_WISH = 1000.0  # cm/s


@dataclass(frozen=True)
class Wish:
    """What a user wants of one character from now on.

    Attributes:
        velocity: over the ground, x and z in cm/s; (0, 0) stands still, None leaves the path to the type.
        facing: heading in radians; None takes the type's own facing on its path, or keeps the present heading.
        type: a motion type; None chooses by velocity and facing (steered_type).
        path: a path to follow instead; its parts name the types. At its end the character stands.
    """

    velocity: tuple[float, float] | None = (0.0, 0.0)
    facing: float | None = None
    type: str | None = None
    path: Path2D | None = None


@dataclass(frozen=True)
class DriveOptions:
    """How wishes turn into controls; blend_frames is what a change of type takes.

    The paper's 40 frames suit changes that are known beforehand. Here the blend begins with the wish, so
    its length is delay: with 8 and with 20 frames as many flips were turned as with 40.
    """

    steering: SteeringOptions = field(default_factory=SteeringOptions)
    blend_frames: int = 12


@dataclass(frozen=True)
class _Performance:
    """A type shown once; its first frame is due at frame begins."""

    type: str
    begins: int
    controls: Controls

    @property
    def frames(self) -> int:
        """How long it takes."""
        return len(self.controls.phase)


class Driver:
    """Turns the wishes of one character into its controls, frame by frame: a Controller for a batch of one.

    set_wish and perform may be called between any two frames. The same calls at the same frames give the
    same controls to the same body.
    """

    def __init__(
        self,
        model: MotionModel,
        kind: str | None = None,
        options: DriveOptions | None = None,
        choice: int = 0,
    ) -> None:
        """kind is the type of the frames the character starts from; by default that of one who stands.

        choice picks among the recordings of what is wished for: two characters with the same one dance alike.
        """
        self.model, self.options, self.choice = model, options or DriveOptions(), choice
        self.wish = Wish()
        self.type = kind or steered_type(model, (0.0, 0.0), None)
        self.steering = Steering(model.fps, self.options.steering)
        self._limits = GaitLimits(model)
        self._trim = SpeedTrim(self._limits)
        self._player, self._played = ReferencePlayer(model, choice), ""
        self._first_steps = FirstSteps(model, choice)
        self._follower: PathFollower | None = None
        self._performance: _Performance | None = None
        self._waiting: tuple[str, float, int] | None = None
        self._weights = self._one(self.type)
        self._from, self._target, self._blended = self._weights, self.type, self.options.blend_frames

    def set_wish(self, wish: Wish) -> None:
        """Follow another wish from the next frame on; raises ControlError for an unknown type or an unlikely number."""
        numbers = (*(wish.velocity or ()), *(() if wish.facing is None else (wish.facing,)))
        if not all(math.isfinite(number) for number in numbers):
            raise ControlError(f"expected finite numbers for velocity and facing, found {numbers}")
        if wish.velocity is not None and math.hypot(*wish.velocity) > FASTEST_WISH * (1.0 + 1e-6):
            raise ControlError(f"expected a velocity of at most {FASTEST_WISH:g} cm/s, found {wish.velocity}")
        if wish.type is not None:
            kind = nfc(wish.type)
            self.model.type_id(kind)
            wish = replace(wish, type=kind)
        if wish.path is not self.wish.path:
            path = wish.path
            self._follower = None if path is None else PathFollower(self.model, path, self.choice)
        self.wish = wish

    def perform(self, kind: str, seconds: float = DEFAULT_SECONDS, choice: int = 0) -> None:
        """Show a type once, then go back to the wish. A performance waits until the one before it is over.

        Args:
            seconds: length, for types other than strikes, jumps and flips, which take their own time.
            choice: picks among the recordings of the type.

        Raises:
            ControlError: for an unknown type.
        """
        kind = nfc(kind)
        self.model.type_id(kind)
        self._waiting = (kind, seconds, choice)

    @property
    def performing(self) -> str | None:
        """The type that is being shown once, if any."""
        return None if self._performance is None else self._performance.type

    @property
    def following(self) -> float | None:
        """The share of the path that lies behind, None where none is followed."""
        if self._follower is None:
            return None
        return min(1.0, self._follower.arc / max(self._follower.path.length - SPACING, SPACING))

    def __call__(self, frame: int, ground: Array) -> Controls:
        """Controls (1, ...) of a frame; frame counts up by one at each call, ground (1, 3) is where the body is."""
        self._take_turns(frame)
        shown = self._performance
        free = self.wish.velocity is None or self._follower is not None or shown is not None
        x, z, heading = ground[0].tolist()
        self.steering.observe(x, z, heading, free)
        kind, asked = self._steer() if self._follower is None else self._follow(self._follower, frame, ground)
        if shown is not None:
            kind, asked = self._show(shown, frame, kind, asked)
        return replace(asked, type_weights=self._blend(kind, asked.type_weights[0])[None])

    def _take_turns(self, frame: int) -> None:
        """End a performance that is over, begin the one that waits, and repeat one the wish holds on to."""
        over = self._performance
        if over is not None and frame < over.begins + over.frames:
            return
        self._performance = None
        held = self.wish.type
        if self._waiting is None and self._follower is None and held and self.model.phase_seconds(held):
            self._waiting = (held, DEFAULT_SECONDS, self.choice)
        if self._waiting is None:
            return
        kind, seconds, choice = self._waiting
        self._waiting = None
        length = round(self.model.phase_seconds(kind) * self.model.fps)
        player = ReferencePlayer(self.model, choice)
        player.begin(kind, speed=math.hypot(*self.steering.velocity))
        if not self.model.types[kind].performed:
            event = player.event_frames()
            length = event + AFTER_EVENT if event else 0
        # Weights cross the middle of their blend as the first frame is due, as they do in training.
        begins = frame if over is not None and over.type == kind else frame + self.options.blend_frames // 2
        controls = player.play(max(1, length or round(seconds * self.model.fps)))
        self._performance = _Performance(kind, begins, controls)

    def _steer(self) -> tuple[str, Controls]:
        """The type and the controls of the wish."""
        wish = self.wish
        if wish.velocity is None:
            return self._with_reference(wish.type or steered_type(self.model, (0.0, 0.0), None), None)
        kind = wish.type or steered_type(self.model, wish.velocity, wish.facing)
        facing = wish.facing
        if facing is None and math.hypot(*wish.velocity) >= STANDS_BELOW:
            gait = self.model.types[kind].gait
            facing = math.atan2(*wish.velocity) - (0.0 if gait is None else gait.facing)
        velocity, facing = self._limits.nearest(kind, wish.velocity, facing)
        velocity = self._trim(kind, velocity, self.steering.measured)
        settled = np.array([self.steering.settled(velocity)], np.float32)
        trajectory = np.array([self.steering.trajectory(velocity, facing)], np.float32)
        if self.model.types[kind].steered:
            self._played = ""
            asked = replace(self._free(kind), trajectory=trajectory, slip_correction=settled)
            if self._goes_from_standing(kind):
                self._first_steps.begin(kind)
            if self._first_steps.takes(kind):
                asked = self._first_steps.reference(asked, trajectory)
            return kind, asked.with_mask(1.0)
        return self._with_reference(kind, trajectory)

    def _goes_from_standing(self, kind: str) -> bool:
        """Whether this frame is the first of a gait after standing."""
        known = self.model.types
        return known[kind].goes and self._target in known and known[self._target].stands

    def _with_reference(self, kind: str, trajectory: Array | None) -> tuple[str, Controls]:
        """A type with its reference clips, for as long as it is wished."""
        if kind != self._played:
            self._player.begin(kind, speed=math.hypot(*self.steering.velocity))
            self._played = kind
        asked = self._player.play(1, trajectory)
        return kind, asked if trajectory is not None else without_trajectory(asked)

    def _follow(self, follower: PathFollower, frame: int, ground: Array) -> tuple[str, Controls]:
        """The controls of a path, which has type weights of its own."""
        asked = follower(frame, ground)
        if follower.arc >= follower.path.length - SPACING:
            self._follower, self.wish = None, Wish()
        return PATH, asked

    def _show(self, shown: _Performance, frame: int, kind: str, otherwise: Controls) -> tuple[str, Controls]:
        """The controls of a performance; before its first frame is due and in its last ones, only some of them."""
        at = frame - shown.begins
        if at < 0:
            kept = {name: getattr(otherwise, name) for name in (*_TRAJECTORY, "slip_correction")}
            return shown.type, replace(self._free(shown.type), **kept)
        asked = shown.controls.at(slice(at, at + 1))
        asked = replace(asked, slip_correction=otherwise.slip_correction)
        if at < shown.frames - self.options.blend_frames // 2:
            kind = shown.type
        else:
            asked = replace(asked, type_weights=otherwise.type_weights)
        if not asked.trajectory_mask.any():
            # A standing character that kicks is not held in place; a moving one keeps its trajectory.
            speed = math.hypot(*(self.wish.velocity or (0.0, 0.0)))
            if self._follower is not None or speed >= STANDS_BELOW:
                asked = replace(asked, **{name: getattr(otherwise, name) for name in _TRAJECTORY})
        return kind, asked

    def _blend(self, kind: str, goal: Array) -> Array:
        """Type weights (N,) on their way to a goal, which they reach within blend_frames of a change of kind."""
        if kind != self._target:
            self._from, self._target, self._blended = self._weights, kind, 0
        self._blended += 1
        share = min(1.0, self._blended / max(1, self.options.blend_frames))
        self._weights = self._from + share * (goal - self._from)
        self.type = kind or self.model.type_names[int(goal.argmax())]
        return self._weights

    def _free(self, kind: str) -> Controls:
        """Controls (1, ...) of a type alone."""
        return Controls.of_types(self._one(kind)[None])

    def _one(self, kind: str) -> Array:
        weights = np.zeros(len(self.model.types), np.float32)
        weights[self.model.type_id(kind)] = 1.0
        return weights


def without_trajectory(controls: Controls) -> Controls:
    """The same controls without a trajectory."""
    return replace(controls, trajectory=np.zeros_like(controls.trajectory)).with_mask(0.0)


def together(asked: list[Controls]) -> Controls:
    """The controls of several characters as those of one batch."""
    return Controls.concatenated(asked)
