"""The controls of planned motion types, computed before the first frame as far as they do not depend on the body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from motionkit.arrays import Array
from motionkit.control.memory import Bodies, FoundStances
from motionkit.control.momentum import carried_over
from motionkit.control.plan import Plan
from motionkit.control.reference_player import ReferencePlayer
from motionkit.control.standing import settling
from motionkit.features.control import Controls, types_ahead
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind


def plan_controls(model: MotionModel, plan: Plan, choice: int = 0) -> Controls:
    """Controls (T, ...) of all types of a plan, with reference poses.

    Args:
        choice: picks among the reference clips of the types.
    """
    player, shown = ReferencePlayer(model, choice), plan.shown
    assert shown is not None
    asked = []
    for segment in plan.segments:
        before = player.speed
        paused = player.ends and model.kind(segment.type) is MotionKind.PERFORMANCE
        if segment.first == 0:
            player.begin(segment.type, shown.poses, shown.behind, speed=shown.speed)
        else:
            player.begin(segment.type, paused=paused, settles=segment.settles)
        clip, at = player.clip, player.at
        controls = player.play(segment.count, whole=True)
        if segment.settles:
            controls = settling(controls, before, model.fps)
        elif before is not None and clip is not None and not paused:
            controls = carried_over(controls, clip.ground[at:], before, model.fps)
        asked.append(controls)
    ahead = types_ahead(plan.weights) if model.plain else None
    return replace(Controls.concatenated(asked), type_weights=plan.weights, types_ahead=ahead)


class CrowdController:
    """Controls of several characters, frame by frame; after its plan, a character repeats the last controls."""

    def __init__(
        self, model: MotionModel, plans: Sequence[Plan], choice: int = 0, bodies: Bodies | None = None
    ) -> None:
        """Make the controls of all frames.

        Args:
            plans: one for each character.
            choice: picks among reference clips for the first character, counted up for the others.
            bodies: the characters; their recordings of standing are moved to the stances in which they stop.
        """
        self.controls = Controls.side_by_side(
            [plan_controls(model, plan, choice + i) for i, plan in enumerate(plans)]
        )
        self.stances = FoundStances(model, [plan.stands for plan in plans], bodies)

    def __call__(self, frame: int, ground: Array) -> Controls:
        """Controls (B, ...) of a frame; ground is not used."""
        row = min(frame, len(self.controls.phase) - 1)
        return self.stances.shown(self.controls.at(row), row)
