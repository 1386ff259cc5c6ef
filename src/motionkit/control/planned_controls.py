"""The controls of planned motion types, computed before the first frame as far as they do not depend on the body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from motionkit.arrays import Array, length
from motionkit.control.memory import Bodies, FoundStances
from motionkit.control.momentum import carried_over
from motionkit.control.plan import Plan, Segment
from motionkit.control.reference_player import ReferencePlayer
from motionkit.control.standing import settling
from motionkit.features.control import TRAJECTORY_OFFSETS, Controls, types_ahead
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind
from motionkit.motion.rotations import rotate_ground, wrap_angle

LEAD = 45  # frames of a gait that lead to a performance; recorded runs last little longer; chosen
FAR = 20.0  # cm; largest distance from its way that a gait makes up for; chosen


def plan_controls(model: MotionModel, plan: Plan, choice: int = 0) -> Controls:
    """Controls (T, ...) of all types of a plan, with reference poses.

    Args:
        choice: picks among the reference clips of the types.
    """
    player, shown = ReferencePlayer(model, choice), plan.shown
    assert shown is not None
    asked = []
    for segment, after in zip(plan.segments, (*plan.segments[1:], None), strict=True):
        before = player.speed
        paused = player.ends and model.kind(segment.type) is MotionKind.PERFORMANCE
        if segment.first == 0:
            player.begin(segment.type, shown.poses, shown.behind, speed=shown.speed)
        else:
            player.begin(segment.type, paused=paused, settles=segment.settles)
        clip, at = player.clip, player.at
        controls = _played(player, segment, after)
        if segment.settles:
            controls = settling(controls, before, model.fps)
        elif before is not None and clip is not None and not paused:
            controls = carried_over(controls, clip.ground[at:], before, model.fps)
        asked.append(controls)
    ahead = types_ahead(plan.weights) if model.plain else None
    return replace(Controls.concatenated(asked), type_weights=plan.weights, types_ahead=ahead)


def _played(player: ReferencePlayer, segment: Segment, after: Segment | None) -> Controls:
    """Controls of a segment; a gait before a performance ends in the step that the performance begins with."""
    model = player.model
    performs = after is not None and model.kind(after.type) is MotionKind.PERFORMANCE
    if after is None or not performs or model.kind(segment.type) is not MotionKind.GAIT:
        return player.play(segment.count, whole=True)
    lead = min(segment.count, LEAD)
    first = [player.play(segment.count - lead, whole=True)] if segment.count > lead else []
    player.lead(after.type, lead)
    return Controls.concatenated([*first, player.play(lead, whole=True)])


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
        self.ways = GaitWays(model, plans, self.controls)

    def __call__(self, frame: int, ground: Array) -> Controls:
        """Controls (B, ...) of a frame for bodies at ground (B, 3)."""
        row = min(frame, len(self.controls.phase) - 1)
        return self.ways.led(self.stances.shown(self.controls.at(row), row), row, ground)


class GaitWays:
    """Leads characters that stay in a gait along the way that their planned trajectories add up to.

    A trajectory alone says how to go on from wherever the body is, so errors of speed and direction would add up.
    """

    def __init__(self, model: MotionModel, plans: Sequence[Plan], planned: Controls) -> None:
        """Take the plans of B characters and their controls (T, B, ...)."""
        shape = planned.trajectory_mask.shape
        self.begins, self.leads = np.zeros(shape, bool), np.zeros(shape, bool)
        self.ways = np.zeros((*shape, 3))
        self.origins = np.zeros((shape[1], 3))  # where the present way begins: x, z in cm and heading
        for character, plan in enumerate(plans):
            for segment in plan.segments:
                rows = slice(segment.first, segment.first + segment.count)
                if (
                    model.kind(segment.type) is MotionKind.GAIT
                    and planned.trajectory_mask[rows, character].all()
                ):
                    self.begins[segment.first, character] = self.leads[rows, character] = True
                    self.ways[rows, character] = way_of(planned.trajectory[rows, character])

    def led(self, asked: Controls, row: int, ground: Array) -> Controls:
        """Move trajectories (B, 24) of a row so that they lead bodies at ground (B, 3) back to their ways."""
        leads, begins, here = self.leads[row], self.begins[row], ground.astype(np.float64)
        if not leads.any():
            return asked
        self.origins[begins] = here[begins]
        way = self.ways[row]
        gap = self.origins[:, :2] + rotate_ground(self.origins[:, 2], way[:, :2]) - here[:, :2]
        far = np.maximum(length(gap) / FAR, 1.0)[:, None]
        self.origins[:, :2] += gap / far - gap  # a body that cannot follow is not hurried for it
        turn = wrap_angle(self.origins[:, 2] + way[:, 2] - here[:, 2])[:, None]
        moved = rotate_ground(turn, asked.trajectory.reshape(len(here), -1, 2).astype(np.float64))
        moved[:, : moved.shape[1] // 2] += rotate_ground(-here[:, 2], gap / far)[:, None]
        trajectory = np.where(leads[:, None], moved.reshape(asked.trajectory.shape), asked.trajectory)
        return replace(asked, trajectory=trajectory.astype(np.float32))


def way_of(trajectories: Array) -> Array:
    """Places and headings (T, 3), from zero, of a body that follows the nearest point of each trajectory (T, 24)."""
    half, frames = trajectories.shape[1] // 2, TRAJECTORY_OFFSETS[0]
    steps, ahead = np.split(trajectories.astype(np.float64)[:-1], [half], axis=1)
    way = np.zeros((len(trajectories), 3))
    way[1:, 2] = np.cumsum(np.arctan2(ahead[:, 0], ahead[:, 1]) / frames)
    way[1:, :2] = np.cumsum(rotate_ground(way[:-1, 2], steps[:, :2] / frames), axis=0)
    return way
