"""State of characters between frames: found stances, speed control, first steps, type blends, performances."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from motionkit.arrays import Array
from motionkit.control.gait_limits import speed_limits
from motionkit.control.plan import Stand
from motionkit.control.reference_player import ReferencePlayer
from motionkit.control.standing import SETTLING, like_recorded
from motionkit.control.steering import STANDS_BELOW, Pair
from motionkit.features.control import Controls
from motionkit.features.reference import REFERENCE_OFFSETS
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind

AFTER_EVENT = 10  # frames of the recording shown after a strike or jump; chosen
FIRST_STEPS = 45  # frames of a gait, from standing, with reference poses; chosen


@dataclass(frozen=True)
class TrimSettings:
    """Integral controller for speed; all numbers are chosen, by live roll-outs."""

    seconds: float = 1.0  # time in which the integral grows by the present error
    wait: float = 0.5  # s after a change of wish, while the body accelerates, without integration
    same_wish: float = 0.1  # change of velocity, as a share of the speed, up to which the wish is the same
    lead: float = 0.3  # overshoot of the requested speed at first, as a share of the change
    lead_seconds: float = 0.35  # duration of the overshoot
    limits: tuple[float, float] = (0.75, 1.35)  # limits of the requested speed, as shares of the wish


TRIM = TrimSettings()


class Bodies(Protocol):
    """Characters whose last frame can be read, such as a RolloutState."""

    @property
    def features(self) -> Array:
        """Features (B, 276) of the last frame of all characters."""


class FoundStances:
    """Moves the reference poses of characters that have stopped to the stances that they found."""

    def __init__(
        self, model: MotionModel, stands: Sequence[Sequence[Stand]], bodies: Bodies | None = None
    ) -> None:
        """Take the stands of each of B characters after other types; without bodies a stand gets no reference poses."""
        self.model, self.bodies = model, bodies
        self.standing = [
            (character, replace(stand, first=stand.first + SETTLING))
            for character, each in enumerate(stands)
            for stand in each
        ]
        self.found: dict[int, Array | None] = {}

    def shown(self, asked: Controls, frame: int) -> Controls:
        """Move the reference poses of a frame (B, ...) to the stances; drop them where no recording is similar."""
        now = [
            (number, character)
            for number, (character, stand) in enumerate(self.standing)
            if stand.first <= frame and (stand.end is None or frame < stand.end)
        ]
        if not now:
            return asked
        reference, gain = asked.reference.copy(), asked.reference_gain.copy()
        for number, character in now:
            stance = self._stance(number)
            if stance is None:
                reference[character] = gain[character] = 0.0
            else:
                reference[character] += np.tile(stance, len(REFERENCE_OFFSETS))
        return replace(asked, reference=reference, reference_gain=gain)

    def _stance(self, number: int) -> Array | None:
        """The stance (24,) of a body at the first call; None if it is unlike all recordings."""
        if number not in self.found:
            character, stand = self.standing[number]
            stance = None
            if self.bodies is not None:
                stance = self.model.pose_embedding.of(self.bodies.features[character])
                if not like_recorded(self.model.types[stand.type].reference_clips, stance):
                    stance = None
            self.found[number] = stance
        return self.found[number]


class SpeedTrim:
    """Integral controller for the speed of one character: a factor on the wished speed for each gait.

    A well trained network misses the speed of its trajectory by a tenth, one trained for two hours by a quarter, and
    foot locking slows the root further. On a path the trajectory runs ahead of a body that lags, which corrects the
    speed. A velocity wish has no such place, so the error is integrated while the wish stays the same. After a change
    of wish the requested speed overshoots for TRIM.lead_seconds, because a body changes its speed slowly.

    The factor of a gait stays during other gaits and after a change of speed: a body at 0.9 of one speed reaches about
    0.9 of another.
    """

    def __init__(self, model: MotionModel) -> None:
        self.model = model
        self.shares: dict[str, float] = {}
        self._kind = ""
        self._wish: Pair = (0.0, 0.0)
        self._lead = 0.0  # cm/s of overshoot after a change of wish
        self._since = 0  # frames since the last change of wish

    def __call__(self, kind: str, velocity: Pair, gone: Pair) -> Pair:
        """Return the velocity to request in this frame; types other than gaits get the wished one.

        Args:
            kind: the present type.
            velocity: wished velocity, x and z in cm/s.
            gone: measured velocity of the body, x and z in cm/s.
        """
        speed = math.hypot(*velocity)
        if speed < STANDS_BELOW or self.model.kind(kind) is not MotionKind.GAIT:
            self._kind = ""
            return velocity
        if kind != self._kind or math.dist(velocity, self._wish) > TRIM.same_wish * speed:
            change = speed - math.hypot(*self._wish) if kind == self._kind else 0.0
            self._lead = TRIM.lead * min(max(change, -speed), speed)
            self._kind, self._wish, self._since = kind, velocity, 0
        self._since += 1
        share = self.shares.get(kind, 1.0)
        found = self._since > TRIM.wait * self.model.fps
        if found:
            along = (gone[0] * velocity[0] + gone[1] * velocity[1]) / speed
            share += (1.0 - along / speed) / (TRIM.seconds * self.model.fps)
            share = min(max(share, TRIM.limits[0]), TRIM.limits[1])
        lead = self._lead if self._since <= TRIM.lead_seconds * self.model.fps else 0.0
        share = self._within(kind, speed, share * speed + lead) / speed
        if found:
            self.shares[kind] = share
        return share * velocity[0], share * velocity[1]

    def _within(self, kind: str, wanted: float, asked: float) -> float:
        """Limit a requested speed to the recorded speeds, or to the wanted speed if that is outside them."""
        slowest, fastest = speed_limits(self.model, kind)
        return max(min(asked, max(fastest, wanted)), min(slowest, wanted))


class FirstSteps:
    """Reference poses for one character during the first FIRST_STEPS frames of a gait from standing.

    With the trajectory alone, the body leans forward and drops by 8 cm before it lifts the first foot.
    """

    def __init__(self, model: MotionModel, choice: int = 0) -> None:
        self._player = ReferencePlayer(model, choice, own_share=0.0, few=True)
        self._kind, self._left = "", 0

    def begin(self, kind: str) -> None:
        """Begin the first steps of a standing body in a gait."""
        self._player.forget()
        self._player.begin(kind, speed=0.0)
        self._kind, self._left = kind, FIRST_STEPS

    def takes(self, kind: str) -> bool:
        """Whether first steps in this gait are left; a change of gait ends them."""
        if kind != self._kind:
            self._left = 0
        return self._left > 0

    def reference(self, asked: Controls, trajectory: Array) -> Controls:
        """Add the reference pose of the next frame to controls (1, ...), for a trajectory (1, 24)."""
        self._left -= 1
        shown = self._player.play(1, trajectory)
        return replace(asked, reference=shown.reference, reference_gain=shown.reference_gain)


class TypeBlend:
    """Type weights of a live character; a blend to another type begins in the frame that requests it."""

    def __init__(self, model: MotionModel, kind: str, frames: int) -> None:
        """Begin in a type; frames is the length of a blend."""
        self.model, self.frames = model, frames
        self.type = self.target = kind
        self.weights = self.before = model.type_weights(kind)
        self.blended = frames

    def __call__(self, kind: str, goal: Array) -> Array:
        """Return type weights (N,) that reach a goal (N,) within self.frames frames of a change of kind.

        kind is empty if the goal itself blends the types, as on a path.
        """
        if kind != self.target:
            self.before, self.target, self.blended = self.weights, kind, 0
        self.blended += 1
        share = min(1.0, self.blended / max(1, self.frames))
        self.weights = self.before + share * (goal - self.before)
        self.type = kind or self.model.type_names[int(goal.argmax())]
        return self.weights


@dataclass(frozen=True)
class Performance:
    """A type shown once; its first frame comes at frame `begins`."""

    type: str
    begins: int
    controls: Controls

    @property
    def frames(self) -> int:
        """Length in frames."""
        return len(self.controls.phase)

    def over(self, frame: int) -> bool:
        """Whether it has ended before a frame."""
        return frame >= self.begins + self.frames


@dataclass(frozen=True)
class Request:
    """A type to show once; choice picks its recordings, and seconds counts if it has no length of its own."""

    type: str
    seconds: float
    choice: int


class Performances:
    """The present performance of a live character, and the next one, which waits for its end."""

    def __init__(self, model: MotionModel, blend_frames: int) -> None:
        """Begin without a performance; blend_frames is the length of a change of type."""
        self.model, self.blend_frames = model, blend_frames
        self.shown: Performance | None = None
        self.waiting: Request | None = None

    def take_turns(self, frame: int, speed: float, again: Request | None) -> Performance | None:
        """Return the performance of a frame; when one is over, the waiting one begins.

        Args:
            speed: speed of the body in cm/s.
            again: request to repeat if none waits.
        """
        before = self.shown
        if before is not None and not before.over(frame):
            return before
        request = self.waiting or again
        self.shown = self.waiting = None
        if request is not None:
            # The first frame comes in the middle of the type blend, as in training.
            repeats = before is not None and before.type == request.type
            begins = frame if repeats else frame + self.blend_frames // 2
            self.shown = Performance(request.type, begins, self._played(request, speed))
        return self.shown

    def _played(self, request: Request, speed: float) -> Controls:
        length = round(self.model.phase_seconds(request.type) * self.model.fps)
        player = ReferencePlayer(self.model, request.choice)
        player.begin(request.type, speed=speed)
        if self.model.kind(request.type) is not MotionKind.PERFORMANCE:
            event = player.event_frames()
            length = event + AFTER_EVENT if event else 0
        return player.play(max(1, length or round(request.seconds * self.model.fps)))
