"""Live characters: each step takes controls and returns the posed frame of every character."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import ControlError
from motionkit.features.control import TRAJECTORY_OFFSETS, Controls, skeleton_signal
from motionkit.inference.frame_arrays import BodyArrays
from motionkit.inference.frame_kernel import PoseKernel
from motionkit.inference.noise import Noise
from motionkit.inference.rollout import RolloutState
from motionkit.inference.start import on_body, type_start
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind

_POSITIONS = 2 * len(TRAJECTORY_OFFSETS)  # count of trajectory numbers in cm; they come first


@dataclass(frozen=True, eq=False)
class CharacterFrame:
    """One frame of N characters, float32, in cm and radians.

    Attributes:
        positions: (N, 23, 3) joints in the world.
        rotations: (N, 23, 4) quaternions w, x, y, z in parent space.
        root_positions: (N, 3) the hips in the world.
        contacts: (N, 4) probabilities: left foot, left toe, right foot, right toe.
        ground: (N, 3) root x, z and heading in the world; controllers make trajectories from it.
    """

    positions: Array
    rotations: Array
    root_positions: Array
    contacts: Array
    ground: Array


class CharacterStream:
    """N independent characters; each call of step() moves all of them by one frame.

    Every character has a skeleton of the model. A network that takes skeletons as input moves that skeleton. Otherwise
    the character gets the network's rotations, and its path over the ground is scaled by its leg length. Positions,
    trajectories and frames use the character's own scale.
    """

    def __init__(
        self,
        model: MotionModel,
        count: int = 1,
        noise: Noise | None = None,
        seed: int = 0,
        ik: bool = True,
        characters: Sequence[str] = ("default",),
    ) -> None:
        """Start count characters at the origin in the model's first type; they take the named skeletons in turn.

        Raises:
            ControlError: for an unknown character or a count below one.
        """
        if count < 1:
            raise ControlError(f"expected a count of at least 1, found {count}")
        self.model, self.count = model, count
        self.state = RolloutState(model, count, noise or Noise(), seed)
        self.body = BodyArrays.of(count, ik)
        self.poser = PoseKernel(model.config.layout, model.reference_rotations, self.body)
        for index in range(count):
            self._take_body(index, characters[index % len(characters)])
        kind = model_first_type(model)
        bodies = [model.moved_skeleton(characters[index % len(characters)]) for index in range(count)]
        starts = [on_body(model, type_start(model, kind), body) for body in bodies]
        features, contacts = (
            np.concatenate(p) for p in zip(*((s.features, s.contacts) for s in starts), strict=True)
        )
        weights = np.tile(model.type_weights(kind), (count, 1))
        self.state.start(features, contacts, weights, None, model.phase_seconds(kind) * model.fps)

    def _take_body(self, index: int, character: str) -> None:
        model = self.model
        offsets, scale = model.character(character).offsets, model.body_scale(character)
        self.body.put(index, offsets, scale, model.soles.get(character))
        self.state.controls.skeletons[index] = skeleton_signal(model.moved_skeleton(character))

    def reset(
        self,
        index: int,
        character: str = "default",
        type: str | None = None,
        place: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        """Restart one character from a start pose of a type, at x, z (cm) and heading (radians).

        Raises:
            ControlError: for an unknown index, character or type, or a place that is not finite.
        """
        if not 0 <= index < len(self.body.scale):
            raise ControlError(f"expected a character from 0 to {len(self.body.scale) - 1}, found {index}")
        if not np.isfinite(place).all():
            raise ControlError(f"expected a place of finite numbers, found {place}")
        model, kind = self.model, type or model_first_type(self.model)
        weights = model.type_weights(kind)[None]
        start = on_body(model, type_start(model, kind, 1), model.moved_skeleton(character))
        self._take_body(index, character)
        ground = np.array([place], np.float32)
        ground[:, :2] /= float(self.body.scale[index])
        length = model.phase_seconds(kind) * model.fps
        self.state.start_one(index, start.features, start.contacts, weights, ground, length)

    @property
    def ground(self) -> Array:
        """Root x, z (cm) and heading (radians) of every character in its world (N, 3)."""
        ground = self.state.ground
        ground[:, :2] *= self.body.scale[:, None]
        if self.body.feet is not None:
            ground[:, :2] += self.body.feet.root.carry
        return ground

    def step(self, controls: Controls) -> CharacterFrame:
        """Move every character on by one frame (1 / model.fps seconds)."""
        scale, feet = self.body.scale, self.body.feet
        if (scale != 1.0).any():
            trajectory = controls.trajectory.copy()
            trajectory[:, :_POSITIONS] /= scale[:, None]
            controls = replace(controls, trajectory=trajectory)
        if feet is not None:
            feet.root.hold[:] = controls.slip_correction * self.model.root_hold(controls.type_weights)
        made = self.state.advance(controls)
        rotations, root, positions = self.poser.pose(made.features, made.contacts, made.ground)
        return CharacterFrame(positions, rotations, root, made.contacts.copy(), self.ground)


def model_first_type(model: MotionModel) -> str:
    """The default type of a new character: standing, else the first type with start poses."""
    known = {name: kind for name, kind in model.types.items() if kind.start_poses}
    if not known:
        raise ControlError("the model has no start poses")
    return next((name for name in known if model.kind(name) is MotionKind.STANCE), next(iter(known)))
