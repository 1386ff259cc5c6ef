"""What characters remember from frame to frame: the stance they found, the speed they lack, types that are blended."""

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

AFTER_EVENT = 10  # frames of the recording that follow a strike or jump; chosen
FIRST_STEPS = 45  # frames of a gait from standing that recordings are shown for; chosen


@dataclass(frozen=True)
class TrimSettings:
    """Integral controller for speed; all numbers are chosen, by live roll-outs."""

    seconds: float = 1.0  # in which a lack of speed is asked for once more
    wait: float = 0.5  # s after a change of wish, in which the body is still on its way to it
    same_wish: float = 0.1  # share of the speed; what differs less is the same wish
    lead: float = 0.3  # share of a change of speed that is asked for beyond it at first
    lead_seconds: float = 0.35  # for how long
    limits: tuple[float, float] = (0.75, 1.35)  # shares of the wished speed that are asked for


TRIM = TrimSettings()


class Bodies(Protocol):
    """Characters whose last frame can be read, such as a RolloutState."""

    @property
    def features(self) -> Array:
        """Features (B, 276) of the last frame of all characters."""


class FoundStances:
    """Moves the reference poses of characters that have come to a stand to the stances that they have found."""

    def __init__(
        self, model: MotionModel, stands: Sequence[Sequence[Stand]], bodies: Bodies | None = None
    ) -> None:
        """Take where each of B characters stands after other types; without bodies no recordings are shown there."""
        self.model, self.bodies = model, bodies
        self.standing = [
            (character, replace(stand, first=stand.first + SETTLING))
            for character, each in enumerate(stands)
            for stand in each
        ]
        self.found: dict[int, Array | None] = {}

    def shown(self, asked: Controls, frame: int) -> Controls:
        """The controls (B, ...) of a frame about the stances; without recordings where none is like the stance."""
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
        """The stance (24,) that a body has when it is first asked for; None if no recording is like it."""
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
    """Integral controller for speed: the share of the wished speed that one character is asked for, for each gait.

    A well trained network is off the speed of its trajectory by a tenth, one trained for two hours by a fourth, and
    locked feet keep the root back. On a path the place asked for runs ahead of a body that lags, which makes up for it.
    A held key has no place: the lack of speed is summed up here while the wish stays the same. Nor does a body change
    its speed at once: as the wish changes, more of the change is asked for than is wished.

    The share is kept while another gait goes, and over a change of speed: a body that goes at 0.9 of a speed goes at
    about 0.9 of another one.
    """

    def __init__(self, model: MotionModel) -> None:
        self.model = model
        self.shares: dict[str, float] = {}
        self._kind = ""
        self._wish: Pair = (0.0, 0.0)
        self._lead = 0.0  # cm/s to ask for beyond the wish, as it has just changed
        self._since = 0  # frames for which the wish is the same

    def __call__(self, kind: str, velocity: Pair, gone: Pair) -> Pair:
        """Return the velocity to ask a gait for in this frame; others are asked for what is wished.

        Args:
            kind: the type that goes.
            velocity: wished, x and z in cm/s.
            gone: of the body, x and z in cm/s.
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
        """The speed to ask for: not beyond those of the recordings for the sake of one within them."""
        slowest, fastest = speed_limits(self.model, kind)
        return max(min(asked, max(fastest, wanted)), min(slowest, wanted))


class FirstSteps:
    """The first steps of a gait from standing: one character is shown few recordings for FIRST_STEPS frames.

    Steered by the trajectory alone from the start, it leans after it and drops by 8 cm before the first foot follows.
    """

    def __init__(self, model: MotionModel, choice: int = 0) -> None:
        self._player = ReferencePlayer(model, choice, own_share=0.0, few=True)
        self._kind, self._left = "", 0

    def begin(self, kind: str) -> None:
        """A body that stands begins to go in this gait."""
        self._player.forget()
        self._player.begin(kind, speed=0.0)
        self._kind, self._left = kind, FIRST_STEPS

    def takes(self, kind: str) -> bool:
        """Whether the first steps in this gait are still to come; those in another gait are over."""
        if kind != self._kind:
            self._left = 0
        return self._left > 0

    def reference(self, asked: Controls, trajectory: Array) -> Controls:
        """Controls (1, ...) of the next frame with a reference; asked are those without, trajectory (1, 24)."""
        self._left -= 1
        shown = self._player.play(1, trajectory)
        return replace(asked, reference=shown.reference, reference_gain=shown.reference_gain)


class TypeBlend:
    """Type weights of a live character: they go over to those of another type from the frame it is asked for."""

    def __init__(self, model: MotionModel, kind: str, frames: int) -> None:
        """Begin in a type; frames is what a change takes."""
        self.model, self.frames = model, frames
        self.type = self.target = kind
        self.weights = self.before = model.type_weights(kind)
        self.blended = frames

    def __call__(self, kind: str, goal: Array) -> Array:
        """Type weights (N,) on their way to a goal (N,), which they reach within the frames of a change of kind.

        kind is empty where the goal itself says which types are shown.
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
    """A type shown once; its first frame is due at frame begins."""

    type: str
    begins: int
    controls: Controls

    @property
    def frames(self) -> int:
        """How long it takes."""
        return len(self.controls.phase)

    def over(self, frame: int) -> bool:
        """Whether it has ended before a frame."""
        return frame >= self.begins + self.frames


@dataclass(frozen=True)
class Request:
    """A type to show once: by a choice of recordings, for some seconds if it has no length of its own."""

    type: str
    seconds: float
    choice: int


class Performances:
    """What a live character shows once: the performance that is shown, and the one that waits for its end."""

    def __init__(self, model: MotionModel, blend_frames: int) -> None:
        """Begin with none; blend_frames is what a change of type takes."""
        self.model, self.blend_frames = model, blend_frames
        self.shown: Performance | None = None
        self.waiting: Request | None = None

    def take_turns(self, frame: int, speed: float, again: Request | None) -> Performance | None:
        """The performance that is shown in a frame: once one is over, the one that waits begins.

        Args:
            speed: of the body in cm/s.
            again: what is shown again and again where nothing waits.
        """
        before = self.shown
        if before is not None and not before.over(frame):
            return before
        request = self.waiting or again
        self.shown = self.waiting = None
        if request is not None:
            # Weights cross the middle of their blend as the first frame is due, as they do in training.
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
