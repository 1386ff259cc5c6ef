"""Live characters: controls in, a posed frame of every character out, one step at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from motionkit.arrays import Array, Floats
from motionkit.errors import ControlError
from motionkit.features.control import TRAJECTORY_OFFSETS, Controls
from motionkit.inference.foot_lock import FootLock
from motionkit.inference.frame_kernel import PoseKernel, frame_library
from motionkit.inference.height_correction import HeightCorrection
from motionkit.inference.pose import BodyKinematics, PoseDecoder
from motionkit.inference.rollout import Noise, RolloutState
from motionkit.inference.start import on_body, type_start
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind
from motionkit.motion.skeleton import JOINT_COUNT

_POSITIONS = 2 * len(TRAJECTORY_OFFSETS)  # of the trajectory numbers, the first are centimetres


@dataclass(frozen=True, eq=False)
class CharacterFrame:
    """One frame of N characters, float32, in cm and radians.

    Attributes:
        positions: (N, 23, 3) joints in the world.
        rotations: (N, 23, 4) quaternions w, x, y, z in the parent's space.
        root_positions: (N, 3) the hips in the world.
        contacts: (N, 4) probabilities: left foot, left toe, right foot, right toe.
        ground: (N, 3) root x, z and heading in the world, from which controllers make trajectories.
    """

    positions: Array
    rotations: Array
    root_positions: Array
    contacts: Array
    ground: Array


class CharacterStream:
    """N independent characters; each call of step() moves all of them by one frame.

    Every character has a skeleton of the model. A network that takes skeletons as input moves that skeleton itself;
    otherwise the character gets the network's rotations, and its path over the ground is scaled by its leg length.
    MotionIndex, trajectories and frames are all in the character's own world, so nothing outside has to know of
    the scale.
    """

    def __init__(
        self,
        model: MotionModel,
        count: int = 1,
        noise: Noise | None = None,
        seed: int = 0,
        ik: bool = True,
        characters: Sequence[str] = ("default",),
        compiled: bool = True,
    ) -> None:
        """count characters, taking the named skeletons in turn, at the origin in the model's first type.

        compiled=False poses them in numpy even where there is a compiled kernel.

        Raises:
            ControlError: for an unknown character or a count below one.
        """
        if count < 1:
            raise ControlError(f"expected a count of at least 1, found {count}")
        self.model, self.count = model, count
        self.state = RolloutState(model, count, noise or Noise(), seed, compiled)
        self.scale = np.ones(count, np.float32)
        self.decoder = PoseDecoder(model.config.layout, model.reference_rotations)
        self.offsets = np.zeros((count, JOINT_COUNT, 3), np.float32)
        self.body = BodyKinematics(self.offsets)
        self.height_correction = HeightCorrection(model.config.layout, count)
        self.feet = FootLock(count) if ik else None
        library = frame_library() if compiled else None
        kernel = library and PoseKernel(
            library, self.decoder, self.offsets, self.scale, self.height_correction, self.feet
        )
        self._pose = kernel.pose if kernel else self._pose_in_numpy
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
        skeleton = self.model.character(character)
        self.scale[index] = self.model.body_scale(character)
        self.state.set_skeleton(index, self.model.moved_skeleton(character))
        self._scaled = bool((self.scale != 1.0).any())
        self.offsets[index] = skeleton.offsets
        self.body.set_offsets(index, self.offsets[index])
        self.height_correction.rise[index] = 0.0
        if self.feet is not None:
            self.feet.reset(index)

    def reset(
        self,
        index: int,
        character: str = "default",
        type: str | None = None,
        place: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        """Start one character anew from a start pose of a type, at a place x, z (cm) and heading (radians).

        Raises:
            ControlError: for an unknown character or type.
        """
        model, kind = self.model, type or model_first_type(self.model)
        weights = model.type_weights(kind)[None]
        start = on_body(model, type_start(model, kind, 1), model.moved_skeleton(character))
        self._take_body(index, character)
        ground = np.array([place], np.float32)
        ground[:, :2] /= float(self.scale[index])
        length = model.phase_seconds(kind) * model.fps
        self.state.start_one(index, start.features, start.contacts, weights, ground, length)

    @property
    def ground(self) -> Array:
        """Root x, z (cm) and heading (radians) of every character in its world (N, 3)."""
        ground = self.state.ground
        ground[:, :2] *= self.scale[:, None]
        if self.feet is not None:
            ground[:, :2] += self.feet.carry
        return ground

    def step(self, controls: Controls) -> CharacterFrame:
        """Move every character on by one frame (1 / model.fps seconds)."""
        if self._scaled:
            trajectory = controls.trajectory.copy()
            trajectory[:, :_POSITIONS] /= self.scale[:, None]
            controls = replace(controls, trajectory=trajectory)
        if self.feet is not None:
            self.feet.hold[:] = controls.slip_correction * self.model.root_hold(controls.type_weights)
        features, contacts, ground = self.state.advance(controls)
        rotations, root, positions = self._pose(features, contacts, ground)
        return CharacterFrame(
            positions,
            rotations,
            root,
            contacts.copy(),
            self.ground,
        )

    def _pose_in_numpy(
        self, features: Floats, contacts: Floats, ground: Floats
    ) -> tuple[Floats, Floats, Floats]:
        rotations, root = self.decoder.decode(features, ground)
        root *= self.scale[:, None]
        world = self.body.forward(rotations, root)
        self.height_correction.apply(features, root, world, self.scale)
        if self.feet is not None:
            positions = self.feet.apply(rotations, root, world, contacts, self.scale)
        else:
            positions = np.ascontiguousarray(world[..., :3, 3])
        return rotations, root, positions


def model_first_type(model: MotionModel) -> str:
    """The type a character begins in if none is asked for: standing, else the first with start poses."""
    known = {name: kind for name, kind in model.types.items() if kind.start_poses}
    if not known:
        raise ControlError("the model has no start poses")
    return next((name for name in known if model.kind(name) is MotionKind.STANCE), next(iter(known)))
