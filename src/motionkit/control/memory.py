"""State of characters between frames: found stances, first steps, type blends, performances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from motionkit.arrays import Array
from motionkit.control.plan import StandingSpan
from motionkit.control.reference_player import ReferencePlayer
from motionkit.control.standing import STOPPING_FRAMES, like_recorded
from motionkit.features.control import Controls
from motionkit.features.reference import REFERENCE_OFFSETS
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind

AFTER_EVENT = 10  # frames of the recording shown after a strike or jump; chosen
FIRST_STEPS = 45  # frames of a gait, from standing, with reference poses; chosen


class Bodies(Protocol):
    """Characters whose last frame can be read, such as a RolloutState."""

    @property
    def features(self) -> Array:
        """Features (B, 276) of the last frame of all characters."""


class FoundStances:
    """Moves the reference poses of characters that have stopped to the stances that they found."""

    def __init__(
        self, model: MotionModel, spans: Sequence[Sequence[StandingSpan]], bodies: Bodies | None = None
    ) -> None:
        """Take the spans in which each of B characters stands; without bodies they get no reference poses."""
        self.model, self.bodies = model, bodies
        self.standing = [
            (character, replace(span, first=span.first + STOPPING_FRAMES))
            for character, each in enumerate(spans)
            for span in each
        ]
        self.found: dict[int, Array | None] = {}

    def moved(self, controls: Controls, frame: int) -> Controls:
        """Move the reference poses of a frame (B, ...) to the stances; drop them where no recording is similar."""
        now = [
            (number, character)
            for number, (character, span) in enumerate(self.standing)
            if span.first <= frame and (span.end is None or frame < span.end)
        ]
        if not now:
            return controls
        reference, gain = controls.reference.copy(), controls.reference_gain.copy()
        for number, character in now:
            stance = self._stance(number)
            if stance is None:
                reference[character] = gain[character] = 0.0
            else:
                reference[character] += np.tile(stance, len(REFERENCE_OFFSETS))
        return replace(controls, reference=reference, reference_gain=gain)

    def _stance(self, number: int) -> Array | None:
        """The stance (24,) of a body at the first call; None if it is unlike all recordings."""
        if number not in self.found:
            character, span = self.standing[number]
            stance = None
            if self.bodies is not None:
                stance = self.model.pose_embedding.of(self.bodies.features[character])
                if not like_recorded(self.model.types[span.type].reference_clips, stance):
                    stance = None
            self.found[number] = stance
        return self.found[number]


class FirstSteps:
    """Reference poses for one character during the first FIRST_STEPS frames of a gait from standing.

    With the trajectory alone, the body leans forward and drops by 8 cm before it lifts the first foot.
    """

    def __init__(self, model: MotionModel, choice: int = 0) -> None:
        self._player = ReferencePlayer(model, choice, recorded_share=0.0, few=True)
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

    def reference(self, controls: Controls, trajectory: Array) -> Controls:
        """Add the reference pose of the next frame to controls (1, ...), for a trajectory (1, 24)."""
        self._left -= 1
        played = self._player.play(1, trajectory)
        return replace(controls, reference=played.reference, reference_gain=played.reference_gain)


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
            self.target = kind
            self.restart()
        self.blended += 1
        share = min(1.0, self.blended / max(1, self.frames))
        self.weights = self.before + share * (goal - self.before)
        self.type = kind or self.model.type_names[int(goal.argmax())]
        return self.weights

    def restart(self) -> None:
        """Begin a blend from the present weights."""
        self.before, self.blended = self.weights, 0


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
        self.current: Performance | None = None
        self.waiting: Request | None = None

    def end(self) -> None:
        """Drop the waiting performance, and end the present one now unless it is shown whole, as a flip is."""
        self.waiting = None
        if self.current is not None and self.model.phase_seconds(self.current.type) == 0.0:
            self.current = None

    def take_turns(self, frame: int, speed: float, again: Request | None) -> Performance | None:
        """Return the performance of a frame; when one is over, the waiting one begins.

        Args:
            speed: speed of the body in cm/s.
            again: request to repeat if none waits.
        """
        before = self.current
        if before is not None and not before.over(frame):
            return before
        request = self.waiting or again
        self.current = self.waiting = None
        if request is not None:
            # The first frame comes in the middle of the type blend, as in training.
            repeats = before is not None and before.type == request.type
            begins = frame if repeats else frame + self.blend_frames // 2
            self.current = Performance(request.type, begins, self._played(request, speed))
        return self.current

    def _played(self, request: Request, speed: float) -> Controls:
        length = round(self.model.phase_seconds(request.type) * self.model.fps)
        player = ReferencePlayer(self.model, request.choice)
        player.begin(request.type, speed=speed)
        if self.model.kind(request.type) is not MotionKind.PERFORMANCE:
            event = player.event_frames()
            length = event + AFTER_EVENT if event else 0
        return player.play(max(1, length or round(request.seconds * self.model.fps)))
