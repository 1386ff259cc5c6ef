"""Roll-outs of many characters at once: plans or controllers in, the motion of each body out.

The scoreboard rolls out all seeds and types as one batch, because a batch takes little longer than one character.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from motionkit.arrays import Array
from motionkit.control.drive import together
from motionkit.control.reference_player import last_poses
from motionkit.control.script import TypePart, plan_controls
from motionkit.control.steering import steered_type
from motionkit.evaluation.body import Body, bodies
from motionkit.features.control import Controls
from motionkit.features.decode import decode_rotations, root_height
from motionkit.inference.height_correction import raised
from motionkit.inference.rollout import (
    Controller,
    Noise,
    Rollout,
    RolloutState,
    run,
    start_batch,
)
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_continuous, quat_from_yaw, quat_multiply

BATCH = 128  # characters per network step; more need memory and save no time
WALK = 130.0  # cm/s; a neutral type is the one that walks at about this speed
NEUTRAL_SECONDS = 0.5

# Called with the share of the work that is done (0 to 1).
Progress = Callable[[float], None]


@dataclass(frozen=True)
class Plan:
    """The types one character performs in turn; choice selects among start poses and reference clips."""

    parts: tuple[TypePart, ...]
    choice: int = 0


@dataclass(frozen=True, eq=False)
class Performance:
    """The motion of one character: its body, and the contacts (T, 4) the network predicted."""

    body: Body
    contacts: Array

    def motion(self, model: MotionModel) -> Motion:
        """Return the motion, for writing or foot locking."""
        return Motion(
            model.character("default"), self.body.rotations, self.body.positions[:, 0], self.body.fps
        )


def neutral_types(model: MotionModel) -> tuple[str, ...]:
    """Return the types characters perform before a command: the one that stands, and the one that walks."""
    return tuple(
        dict.fromkeys((steered_type(model, (0.0, 0.0), None), steered_type(model, (0.0, WALK), 0.0)))
    )


def roll_plans(
    model: MotionModel,
    plans: list[Plan],
    noise: Noise | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> list[Performance]:
    """Roll out each plan with one character. All plans must have the same length.

    A plan starts from start poses of its first type. Phases and reference poses are those of `synthesize`.
    The same seed gives the same motion.
    """
    out: list[Performance] = []
    for first in range(0, len(plans), BATCH):
        some = plans[first : first + BATCH]

        def report(share: float, done: int = first, size: int = len(some)) -> None:
            if progress:
                progress((done + share * size) / len(plans))

        out += _roll_batch(model, some, noise or Noise(), seed + first, report)
    return out


def _roll_batch(
    model: MotionModel, plans: list[Plan], noise: Noise, seed: int, progress: Progress
) -> list[Performance]:
    starts = [model.types[plan.parts[0].type].start_poses for plan in plans]
    features, contacts = start_batch(
        [seeds[plan.choice % len(seeds)] for plan, seeds in zip(plans, starts, strict=True)]
    )
    # The start poses of a performance are its first frames, as in synthesize.
    lengths = [model.phase_seconds(plan.parts[0].type) * model.fps for plan in plans]
    asked = [
        plan_controls(model, plan.parts, last_poses(model, seen), len(seen) if length else 0, plan.choice)
        for plan, seen, length in zip(plans, features, lengths, strict=True)
    ]
    together = Controls.side_by_side(asked)
    frames = len(together.phase)

    def controls(frame: int, ground: Array) -> Controls:
        return together.at(frame)

    state = RolloutState(model, len(plans), noise, seed)
    state.start(features, contacts, together.type_weights[0], None, lengths)
    rollout = run(state, frames, controls, lambda frame: progress(frame / frames))
    return performances(model, rollout)


@dataclass(frozen=True, eq=False)
class Driven:
    """A character with a controller.

    Attributes:
        type: the type whose start poses it starts from.
        controller: called in every frame.
        ground: (3,) root x and z in cm and heading at the start; the origin facing +Z by default.
    """

    type: str
    controller: Controller
    ground: Array = field(default_factory=lambda: np.zeros(3, np.float32))


def roll_controlled(
    model: MotionModel,
    characters: list[Driven],
    frames: int,
    noise: Noise,
    seed: int = 0,
    progress: Progress | None = None,
    done: Callable[[], bool] | None = None,
) -> list[Performance]:
    """Roll out each character with its own controller for `frames` frames, or until done.

    Args:
        done: called after every frame; true ends the roll-out.
    """
    starts = [model.types[character.type].start_poses for character in characters]
    features, contacts = start_batch([some[i % len(some)] for i, some in enumerate(starts)])
    type_ids = [model.type_id(character.type) for character in characters]
    weights = np.eye(len(model.types), dtype=np.float32)[type_ids]

    def controls(frame: int, here: Array) -> Controls:
        return together([c.controller(frame, here[i : i + 1]) for i, c in enumerate(characters)])

    def report(frame: int) -> None:
        if progress:
            progress(frame / frames)

    state = RolloutState(model, len(characters), noise, seed)
    state.start(features, contacts, weights, np.stack([character.ground for character in characters]))
    return performances(model, run(state, frames, controls, report, done))


def performances(model: MotionModel, rollout: Rollout) -> list[Performance]:
    """Return the motions of the characters of a roll-out, on the default body."""
    rotations, roots = rollout_pose(model, rollout)
    found = bodies(rotations, roots, model.character("default"), model.fps)
    return [Performance(body, contacts) for body, contacts in zip(found, rollout.contacts, strict=True)]


def rollout_pose(model: MotionModel, rollout: Rollout) -> tuple[Array, Array]:
    """Return local rotations (B, T, 23, 4) and global root positions (B, T, 3) in cm of a roll-out."""
    layout = model.config.layout
    rotations = decode_rotations(rollout.features, model.reference_rotations, layout)
    root = quat_multiply(quat_from_yaw(rollout.ground[..., 2]), rotations[..., 0, :])
    rotations = np.concatenate([root[..., None, :], rotations[..., 1:, :]], axis=-2)
    rotations = np.stack([quat_continuous(each) for each in rotations])
    height = root_height(rollout.features, layout)
    roots = np.stack([rollout.ground[..., 0], height, rollout.ground[..., 1]], axis=-1)
    return rotations, raised(rollout.features, rotations, roots, model.character("default"), layout)
