"""The controls of planned motion types, computed before the first frame as far as they do not depend on the body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import Array, length
from motionkit.control.memory import Bodies, FoundStances
from motionkit.control.momentum import carried_over
from motionkit.control.plan import Plan, Segment
from motionkit.control.reference_player import ReferencePlayer
from motionkit.control.standing import stopping
from motionkit.features.control import TRAJECTORY_OFFSETS, Controls, types_ahead
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind
from motionkit.motion.rotations import rotate_ground, wrap_angle

LEAD_IN = 45  # frames of a gait that lead to a performance; recorded runs last little longer; chosen
FAR = 20.0  # cm; largest distance from its way that a gait makes up for; chosen


def plan_controls(model: MotionModel, plan: Plan, choice: int = 0) -> Controls:
    """Controls (T, ...) of all types of a plan, with reference poses.

    Args:
        choice: picks among the reference clips of the types.
    """
    player, start_state = ReferencePlayer(model, choice), plan.start_state
    assert start_state is not None
    parts = []
    for segment, after in zip(plan.segments, (*plan.segments[1:], None), strict=True):
        before = player.speed
        paused = player.ends and model.kind(segment.type) is MotionKind.PERFORMANCE
        if segment.first == 0:
            player.begin(segment.type, start_state.poses, start_state.behind, speed=start_state.speed)
        else:
            player.begin(segment.type, paused=paused, stops=segment.stops)
        clip, at = player.clip, player.at
        controls = _played(player, segment, after)
        if segment.stops:
            controls = stopping(controls, before, model.fps)
        elif before is not None and clip is not None and not paused:
            controls = carried_over(controls, clip.ground[at:], before, model.fps)
        parts.append(controls)
    ahead = types_ahead(plan.weights) if model.plain else None
    return replace(Controls.concatenated(parts), type_weights=plan.weights, types_ahead=ahead)


def _played(player: ReferencePlayer, segment: Segment, after: Segment | None) -> Controls:
    """Controls of a segment; a gait before a performance ends in the step that the performance begins with."""
    model = player.model
    performs = after is not None and model.kind(after.type) is MotionKind.PERFORMANCE
    if after is None or not performs or model.kind(segment.type) is not MotionKind.GAIT:
        return player.play(segment.count, whole=True)
    lead_in = min(segment.count, LEAD_IN)
    first = [player.play(segment.count - lead_in, whole=True)] if segment.count > lead_in else []
    player.lead_into(after.type, lead_in)
    return Controls.concatenated([*first, player.play(lead_in, whole=True)])


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
        self.stances = FoundStances(model, [plan.standing_spans for plan in plans], bodies)
        self.paths = GaitPaths(model, plans, self.controls)

    def __call__(self, frame: int, ground: Array) -> Controls:
        """Controls (B, ...) of a frame for bodies at ground (B, 3)."""
        row = min(frame, len(self.controls.phase) - 1)
        return self.paths.corrected(self.stances.moved(self.controls.at(row), row), row, ground)


class GaitPaths:
    """Leads characters that stay in a gait along the way that their planned trajectories add up to.

    A trajectory alone says how to go on from wherever the body is, so errors of speed and direction would add up.
    """

    def __init__(self, model: MotionModel, plans: Sequence[Plan], planned: Controls) -> None:
        """Take the plans of B characters and their controls (T, B, ...)."""
        shape = planned.trajectory_mask.shape
        self.begins, self.leads = np.zeros(shape, bool), np.zeros(shape, bool)
        self.paths = np.zeros((*shape, 3))
        self.origins = np.zeros((shape[1], 3))  # where the present way begins: x, z in cm and heading
        for character, plan in enumerate(plans):
            for segment in plan.segments:
                rows = slice(segment.first, segment.first + segment.count)
                if (
                    model.kind(segment.type) is MotionKind.GAIT
                    and planned.trajectory_mask[rows, character].all()
                ):
                    self.begins[segment.first, character] = self.leads[rows, character] = True
                    self.paths[rows, character] = integrated_path(planned.trajectory[rows, character])

    def anchor(self, row: int, which: NDArray[np.bool_], ground: Array) -> None:
        """Let the ways of some characters (B,) go on from where their bodies are at a row: at ground (B, 3)."""
        if not which.any():
            return
        here, path = ground.astype(np.float64), self.paths[min(row, len(self.paths) - 1)]
        heading = here[:, 2] - path[:, 2]
        place = here[:, :2] - rotate_ground(heading, path[:, :2])
        self.origins[which] = np.concatenate([place, heading[:, None]], axis=1)[which]

    def corrected(self, controls: Controls, row: int, ground: Array) -> Controls:
        """Move trajectories (B, 24) of a row so that they lead bodies at ground (B, 3) back to their ways."""
        leads, begins, here = self.leads[row], self.begins[row], ground.astype(np.float64)
        if not leads.any():
            return controls
        self.anchor(row, begins, ground)
        path = self.paths[row]
        gap = self.origins[:, :2] + rotate_ground(self.origins[:, 2], path[:, :2]) - here[:, :2]
        far = np.maximum(length(gap) / FAR, 1.0)[:, None]
        self.origins[:, :2] += gap / far - gap  # a body that cannot follow is not hurried for it
        turn = wrap_angle(self.origins[:, 2] + path[:, 2] - here[:, 2])[:, None]
        moved = rotate_ground(turn, controls.trajectory.reshape(len(here), -1, 2).astype(np.float64))
        moved[:, : moved.shape[1] // 2] += rotate_ground(-here[:, 2], gap / far)[:, None]
        trajectory = np.where(leads[:, None], moved.reshape(controls.trajectory.shape), controls.trajectory)
        return replace(controls, trajectory=trajectory.astype(np.float32))


def integrated_path(trajectories: Array) -> Array:
    """Places and headings (T, 3), from zero, of a body that follows the nearest point of each trajectory (T, 24)."""
    half, frames = trajectories.shape[1] // 2, TRAJECTORY_OFFSETS[0]
    steps, ahead = np.split(trajectories.astype(np.float64)[:-1], [half], axis=1)
    path = np.zeros((len(trajectories), 3))
    path[1:, 2] = np.cumsum(np.arctan2(ahead[:, 0], ahead[:, 1]) / frames)
    path[1:, :2] = np.cumsum(rotate_ground(path[:-1, 2], steps[:, :2] / frames), axis=0)
    return path
