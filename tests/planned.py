"""Controls of motion types one after another, as tests ask for them."""

from __future__ import annotations

from collections.abc import Sequence

from motionkit.arrays import Array
from motionkit.control.character_start import StartState
from motionkit.control.plan import plan_types
from motionkit.control.planned_controls import plan_controls
from motionkit.control.script import TypePart
from motionkit.features.control import Controls
from motionkit.models.model import MotionModel


def controls_of(
    model: MotionModel, parts: Sequence[TypePart], near: Array, behind: int = 0, choice: int = 0
) -> Controls:
    """Controls of parts after frames with these pose embeddings, which have shown some of the first performance."""
    return plan_controls(model, plan_types(model, parts, StartState(near, behind)), choice)
