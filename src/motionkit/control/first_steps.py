"""The first steps of a gait from standing: a body is shown recordings for them, then it goes by its trajectory alone.

Steered by the trajectory alone from the start, it leans after it and drops by 8 cm before the first foot follows.
"""

from __future__ import annotations

from dataclasses import replace

from motionkit.arrays import Array
from motionkit.control.reference_player import ReferencePlayer
from motionkit.features.control import Controls
from motionkit.models.model import MotionModel

FIRST_STEPS = 45  # frames


class FirstSteps:
    """Shows few recordings of a gait for FIRST_STEPS frames, to one character; the same choice shows the same."""

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
