"""A user's wishes, which change at any moment, as the controls of every frame: what live control needs."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from motionkit.arrays import Array
from motionkit.control.follow import PathFollower
from motionkit.control.gait_limits import within_limits
from motionkit.control.memory import FirstSteps, Performance, Performances, Request, SpeedTrim, TypeBlend
from motionkit.control.path import Path2D
from motionkit.control.plan import plan_path
from motionkit.control.reference_player import ReferencePlayer
from motionkit.control.steering import STANDS_BELOW, Pair, Steering, SteeringOptions, steered_type
from motionkit.errors import ControlError
from motionkit.features.control import Controls
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind
from motionkit.names import nfc

DEFAULT_SECONDS = 2.0  # of a performance of a type that has no length of its own
PATH = ""  # stands for a type where a path names the types
_TRAJECTORY = ("trajectory", "trajectory_mask")
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


class GaitDriver:
    """How a live character goes and stands: the spring it is steered by, the speed it lacks, and its first steps."""

    def __init__(self, model: MotionModel, options: SteeringOptions, choice: int) -> None:
        """choice picks among the recordings of first steps."""
        self.model = model
        self.steering = Steering(model.fps, options)
        self.trim = SpeedTrim(model)
        self.first_steps = FirstSteps(model, choice)

    @property
    def speed(self) -> float:
        """The speed of the spring in cm/s."""
        return math.hypot(*self.steering.velocity)

    def trajectory(self, kind: str, velocity: Pair, facing: float | None) -> tuple[Array, Array]:
        """The trajectory (1, 24) of a type that is to go as wished, and how far feet may hold the root (1,)."""
        if facing is None and math.hypot(*velocity) >= STANDS_BELOW:
            gait = self.model.types[kind].gait
            facing = math.atan2(*velocity) - (0.0 if gait is None else gait.facing)
        velocity, facing = within_limits(self.model, kind, velocity, facing)
        velocity = self.trim(kind, velocity, self.steering.measured)
        settled = np.array([self.steering.settled(velocity)], np.float32)
        return np.array([self.steering.trajectory(velocity, facing)], np.float32), settled

    def first_steps_of(self, kind: str, stood: bool, asked: Controls) -> Controls:
        """The controls (1, ...) of a gait or of standing, with recordings for the first steps from standing."""
        if stood and self.model.kind(kind) is MotionKind.GAIT:
            self.first_steps.begin(kind)
        if self.first_steps.takes(kind):
            return self.first_steps.reference(asked, asked.trajectory)
        return asked


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
        """kind is the type of the frames the character starts from; by default that of standing.

        choice picks among the recordings of what is wished for: two characters with the same one dance alike.
        """
        self.model, self.options, self.choice = model, options or DriveOptions(), choice
        self.wish = Wish()
        self.gaits = GaitDriver(model, self.options.steering, choice)
        self.performances = Performances(model, self.options.blend_frames)
        self.blend = TypeBlend(
            model, kind or steered_type(model, (0.0, 0.0), None), self.options.blend_frames
        )
        self.follower: PathFollower | None = None
        self._player, self._played = ReferencePlayer(model, choice), ""  # of types that recordings move

    @property
    def type(self) -> str:
        """The type that is shown, or gone over to."""
        return self.blend.type

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
            self.follower = (
                None if path is None else PathFollower(self.model, plan_path(self.model, path), self.choice)
            )
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
        self.performances.waiting = Request(kind, seconds, choice)

    @property
    def performing(self) -> str | None:
        """The type that is being shown once, if any."""
        return None if self.performances.shown is None else self.performances.shown.type

    @property
    def following(self) -> float | None:
        """The share of the path that lies behind, None where none is followed."""
        return None if self.follower is None else self.follower.place.share

    def __call__(self, frame: int, ground: Array) -> Controls:
        """Controls (1, ...) of a frame; frame counts up by one at each call, ground (1, 3) is where the body is."""
        shown = self.performances.take_turns(frame, self.gaits.speed, self._repeated())
        free = self.wish.velocity is None or self.follower is not None or shown is not None
        x, z, heading = ground[0].tolist()
        self.gaits.steering.observe(x, z, heading, free)
        kind, asked = self._wished() if self.follower is None else self._follow(self.follower, frame, ground)
        if shown is not None:
            kind, asked = self._show(shown, frame, kind, asked)
        return replace(asked, type_weights=self.blend(kind, asked.type_weights[0])[None])

    def _repeated(self) -> Request | None:
        """A performance, strike or jump that the wish holds on to."""
        held = self.wish.type
        if self.follower is None and held and self.model.kind(held).phased:
            return Request(held, DEFAULT_SECONDS, self.choice)
        return None

    def _wished(self) -> tuple[str, Controls]:
        """The type and the controls of the wish."""
        wish = self.wish
        if wish.velocity is None:
            kind = wish.type or steered_type(self.model, (0.0, 0.0), None)
            return kind, without_trajectory(self._recorded(kind, None))
        kind = wish.type or steered_type(self.model, wish.velocity, wish.facing)
        trajectory, settled = self.gaits.trajectory(kind, wish.velocity, wish.facing)
        if not self.model.kind(kind).steered:
            return kind, self._recorded(kind, trajectory)
        self._played = ""
        asked = replace(self._free(kind), trajectory=trajectory, slip_correction=settled)
        stood = self.model.kind(self.blend.target) is MotionKind.STANCE
        return kind, self.gaits.first_steps_of(kind, stood, asked).with_mask(1.0)

    def _recorded(self, kind: str, trajectory: Array | None) -> Controls:
        """Controls (1, ...) of a type that its recordings move, for as long as it is wished."""
        if kind != self._played:
            self._player.begin(kind, speed=self.gaits.speed)
            self._played = kind
        return self._player.play(1, trajectory)

    def _follow(self, follower: PathFollower, frame: int, ground: Array) -> tuple[str, Controls]:
        """The controls of a path, which has type weights of its own."""
        asked = follower(frame, ground)
        if follower.place.at_end:
            self.follower, self.wish = None, Wish()
        return PATH, asked

    def _show(self, shown: Performance, frame: int, kind: str, otherwise: Controls) -> tuple[str, Controls]:
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
            if self.follower is not None or speed >= STANDS_BELOW:
                asked = replace(asked, **{name: getattr(otherwise, name) for name in _TRAJECTORY})
        return kind, asked

    def _free(self, kind: str) -> Controls:
        """Controls (1, ...) of a type alone."""
        return Controls.of_types(self.model.type_weights(kind)[None])


def without_trajectory(controls: Controls) -> Controls:
    """The same controls without a trajectory."""
    return replace(controls, trajectory=np.zeros_like(controls.trajectory)).with_mask(0.0)


def together(asked: list[Controls]) -> Controls:
    """The controls of several characters as those of one batch."""
    return Controls.concatenated(asked)
