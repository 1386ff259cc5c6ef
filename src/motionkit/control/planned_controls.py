"""The controls of planned motion types, computed before the first frame as far as they do not depend on the body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from motionkit.arrays import Array
from motionkit.control.memory import Bodies, FoundStances
from motionkit.control.momentum import carried_over
from motionkit.control.plan import Plan
from motionkit.control.reference_player import ReferencePlayer
from motionkit.control.standing import settling
from motionkit.features.control import TRAJECTORY_OFFSETS, Controls, types_ahead
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind
from motionkit.motion.rotations import rotate_ground, wrap_angle


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
        self.ways = [StayWays(model, plan, self.controls.trajectory[:, i]) for i, plan in enumerate(plans)]

    def __call__(self, frame: int, ground: Array) -> Controls:
        """Controls (B, ...) of a frame for bodies at ground (B, 3)."""
        row = min(frame, len(self.controls.phase) - 1)
        asked = self.stances.shown(self.controls.at(row), row)
        trajectory = asked.trajectory.copy()
        for i, ways in enumerate(self.ways):
            trajectory[i] = ways.led(row, trajectory[i], ground[i])
        return replace(asked, trajectory=trajectory)


import os
class StayWays:
    """Leads a body that stays in a gait along the way that its trajectories add up to.

    A trajectory alone tells how to go on from wherever the body is, so its errors of speed and direction add up.
    """

    def __init__(self, model: MotionModel, plan: Plan, trajectories: Array) -> None:
        self.ways: dict[int, Array] = {}
        self.first = {}
        for segment in plan.segments:
            if model.kind(segment.type) is MotionKind.GAIT and model.uses_references:
                rows = slice(segment.first, segment.first + segment.count)
                way = added_up(trajectories[rows])
                for at in range(segment.count):
                    self.ways[segment.first + at] = way[at]
                    self.first[segment.first + at] = segment.first
        self.anchor = None
        self.began = -1

    def led(self, frame: int, trajectory: Array, ground: Array) -> Array:
        if frame not in self.ways:
            return trajectory
        ground = ground.astype(np.float64)
        at = self.ways[frame]
        if self.anchor is None or self.began != self.first[frame]:
            self.began = self.first[frame]
            self.anchor = np.concatenate([ground[:2] - rotate_ground(ground[2] - at[2], at[:2]), [ground[2] - at[2]]])
        place = self.anchor[:2] + rotate_ground(self.anchor[2], at[:2])
        heading = self.anchor[2] + at[2]
        gap = place - ground[:2]
        far = float(np.linalg.norm(gap))
        most = float(os.environ.get('GAP','20'))
        if far > most:
            self.anchor[:2] -= gap * (1 - most / far)
            gap *= most / far
        half = len(trajectory) // 2
        turn = float(wrap_angle(np.array([heading - ground[2]]))[0]) * float(os.environ.get('TURN','1'))
        gap = rotate_ground(-ground[2], gap)
        places = rotate_ground(turn, trajectory[:half].reshape(-1, 2).astype(np.float64)) + gap
        directions = rotate_ground(turn, trajectory[half:].reshape(-1, 2).astype(np.float64))
        return np.concatenate([places.reshape(-1), directions.reshape(-1)]).astype(np.float32)


def added_up(trajectories: Array) -> Array:
    """Places and headings (T, 3) in the frame of the first, when each frame goes the first tenth... """
    n = TRAJECTORY_OFFSETS[0]
    half = trajectories.shape[1] // 2
    out = np.zeros((len(trajectories), 3))
    for i in range(1, len(out)):
        t = trajectories[i - 1].astype(np.float64)
        h = out[i - 1, 2]
        out[i, :2] = out[i - 1, :2] + rotate_ground(h, t[:2]) / n
        out[i, 2] = h + np.arctan2(t[half], t[half + 1]) / n
    return out
