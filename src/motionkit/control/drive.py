"""Live control: turns a user's wishes, which may change at any moment, into the controls of every frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from motionkit.arrays import Array
from motionkit.control.follow import PathFollower
from motionkit.control.memory import FirstSteps, Performance, Performances, Request, TypeBlend
from motionkit.control.path import Path2D
from motionkit.control.plan import plan_path
from motionkit.control.reference_player import ReferencePlayer
from motionkit.control.steering import STANDS_BELOW, Steering, SteeringOptions
from motionkit.errors import ControlError
from motionkit.features.control import Controls
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind
from motionkit.names import nfc

# Seconds of a type performed once that has no length of its own: the usual ones, and the most.
DEFAULT_SECONDS, LONGEST = 2.0, 60.0
PATH = ""  # in place of a type while the parts of a path name the types
_TRAJECTORY = ("trajectory", "trajectory_mask")
FASTEST_WISH = 1000.0  # cm/s; faster than any sprint


@dataclass(frozen=True)
class Wish:
    """What a user wants from one character from now on.

    Attributes:
        velocity: over the ground, x and z in cm/s. (0, 0) stands still; None gives no trajectory.
        facing: heading in radians. None takes the usual facing of the gait; a standing body keeps its heading.
        type: a motion type; None chooses by velocity and facing.
        path: a path to follow instead; its parts name the types. At its end the character stands.
    """

    velocity: tuple[float, float] | None = (0.0, 0.0)
    facing: float | None = None
    type: str | None = None
    path: Path2D | None = None


@dataclass(frozen=True)
class DriveOptions:
    """How wishes turn into controls; blend_frames is the length of a change of type.

    The paper's 40 frames suit changes that are known beforehand. Here the blend begins with the wish, so its length is
    a delay. Blends of 8 and of 20 frames turned as many flips as 40.
    """

    steering: SteeringOptions = field(default_factory=SteeringOptions)
    blend_frames: int = 12


class Driver:
    """Turns the wishes of one character into controls, frame by frame; a Controller for a batch of one.

    set_wish and perform may be called between any two frames. The same calls at the same frames give the same controls
    for the same body.
    """

    def __init__(
        self,
        model: MotionModel,
        kind: str | None = None,
        options: DriveOptions | None = None,
        choice: int = 0,
    ) -> None:
        """Start with a wish to stand.

        Args:
            kind: type of the frames that the character starts from; standing by default.
            choice: picks among recordings. Two characters with the same choice dance alike.
        """
        self.model, self.options, self.choice = model, options or DriveOptions(), choice
        self.wish = Wish()
        self.steering = Steering(model, self.options.steering)
        self.first_steps = FirstSteps(model, choice)
        self.performances = Performances(model, self.options.blend_frames)
        kind = kind or self.steering.type((0.0, 0.0), None)
        self.blend = TypeBlend(model, kind, self.options.blend_frames)
        self.follower: PathFollower | None = None
        self._player, self._played = ReferencePlayer(model, choice), ""  # for types that follow recordings

    @property
    def type(self) -> str:
        """The type that is shown, or the target of the present blend."""
        return self.blend.type

    def set_wish(self, wish: Wish) -> None:
        """Follow another wish from the next frame on; raises ControlError for an unknown type or an invalid number."""
        if wish.velocity is not None:
            if np.shape(wish.velocity) != (2,):
                raise ControlError(f"expected a velocity of two numbers, found {wish.velocity}")
            x, z = map(float, wish.velocity)
            wish = replace(wish, velocity=(x, z))
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
            if path is not None and self.blend.target == PATH:
                self.blend.restart()  # another path may be of another type
            plan = None if path is None else plan_path(self.model, path, self._stands)
            self.follower = None if plan is None else PathFollower(self.model, plan, self.choice)
        self.wish = wish

    def perform(self, kind: str, seconds: float = DEFAULT_SECONDS, choice: int = 0) -> None:
        """Show a type once, then return to the wish. A second call waits until the first performance is over.

        Args:
            seconds: length of types without a length of their own; performances, strikes and jumps have one.
            choice: picks among the recordings of the type.

        Raises:
            ControlError: for an unknown type, or a length beyond LONGEST.
        """
        kind = nfc(kind)
        self.model.type_id(kind)
        if not 0.0 < seconds <= LONGEST:
            raise ControlError(f"expected a length from 0 to {LONGEST:g} s, found {seconds:g}")
        self.performances.waiting = Request(kind, seconds, choice)

    @property
    def performing(self) -> str | None:
        """The type that is performed once at present, if any."""
        return None if self.performances.current is None else self.performances.current.type

    @property
    def following(self) -> float | None:
        """The share of the path that is done; None without a path."""
        return None if self.follower is None else self.follower.place.share

    def __call__(self, frame: int, ground: Array) -> Controls:
        """Controls (1, ...) of a frame for a body at ground (1, 3); frame counts up by one at each call."""
        performance = self.performances.take_turns(frame, self.steering.speed, self._repeated())
        free = self.wish.velocity is None or self.follower is not None or performance is not None
        x, z, heading = ground[0].tolist()
        self.steering.observe(x, z, heading, free)
        kind, controls = (
            self._wished() if self.follower is None else self._follow(self.follower, frame, ground)
        )
        if performance is not None:
            kind, controls = self._show(performance, frame, kind, controls)
        return replace(controls, type_weights=self.blend(kind, controls.type_weights[0])[None])

    @property
    def _stands(self) -> bool:
        """Whether the body stood at the last frame."""
        return self.blend.target != PATH and self.model.kind(self.blend.target) is MotionKind.STANCE

    def _repeated(self) -> Request | None:
        """The performance, strike or jump that the wish repeats, if any."""
        held = self.wish.type
        if self.follower is None and held and self.model.kind(held).phased:
            return Request(held, DEFAULT_SECONDS, self.choice)
        return None

    def _wished(self) -> tuple[str, Controls]:
        """The type and the controls of the wish."""
        wish = self.wish
        if wish.velocity is None:
            kind = wish.type or self.steering.type((0.0, 0.0), None)
            return kind, without_trajectory(self._recorded(kind, None))
        kind = wish.type or self.steering.type(wish.velocity, wish.facing)
        trajectory, settled = self.steering.trajectory(kind, wish.velocity, wish.facing)
        if not self.model.kind(kind).steered:
            return kind, self._recorded(kind, trajectory)
        self._played = ""
        controls = replace(self._free(kind), trajectory=trajectory, slip_correction=settled)
        if self._stands and self.model.kind(kind) is MotionKind.GAIT:
            self.first_steps.begin(kind)
        if self.first_steps.takes(kind):
            controls = self.first_steps.reference(controls, trajectory)
        return kind, controls.with_mask(1.0)

    def _recorded(self, kind: str, trajectory: Array | None) -> Controls:
        """Controls (1, ...) of a type that follows recordings, as long as the wish lasts."""
        if kind != self._played:
            self._player.begin(kind, speed=self.steering.speed)
            self._played = kind
        return self._player.play(1, trajectory)

    def _follow(self, follower: PathFollower, frame: int, ground: Array) -> tuple[str, Controls]:
        """The type PATH and the controls of a path, which include the type weights."""
        controls = follower(frame, ground)
        if follower.finished:
            self.follower, self.wish = None, Wish()
        return PATH, controls

    def _show(
        self, performance: Performance, frame: int, kind: str, otherwise: Controls
    ) -> tuple[str, Controls]:
        """The type and the controls of a performance, with some controls of the wish at its beginning and end."""
        at = frame - performance.begins
        if at < 0:
            kept = {name: getattr(otherwise, name) for name in (*_TRAJECTORY, "slip_correction")}
            return performance.type, replace(self._free(performance.type), **kept)
        controls = performance.controls.at(slice(at, at + 1))
        controls = replace(controls, slip_correction=otherwise.slip_correction)
        if at < performance.frames - self.options.blend_frames // 2:
            kind = performance.type
        else:
            controls = replace(controls, type_weights=otherwise.type_weights)
        if not controls.trajectory_mask.any():
            # A moving character keeps its trajectory; a standing one that kicks is free to move.
            speed = math.hypot(*(self.wish.velocity or (0.0, 0.0)))
            if self.follower is not None or speed >= STANDS_BELOW:
                controls = replace(controls, **{name: getattr(otherwise, name) for name in _TRAJECTORY})
        return kind, controls

    def _free(self, kind: str) -> Controls:
        """Controls (1, ...) of a type alone."""
        return Controls.of_types(self.model.type_weights(kind)[None])


def without_trajectory(controls: Controls) -> Controls:
    """The same controls without a trajectory."""
    return replace(controls, trajectory=np.zeros_like(controls.trajectory)).with_mask(0.0)


def together(controls: list[Controls]) -> Controls:
    """Join the controls of several characters into one batch."""
    return Controls.concatenated(controls)
