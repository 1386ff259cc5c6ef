"""Closed-loop synthesis: the network's output is its next input, controls are asked for at every frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import ModelError
from motionkit.features.control import Controls
from motionkit.features.decode import decode_motion
from motionkit.inference.control_input import ControlInput
from motionkit.inference.frame_arrays import FrameArrays
from motionkit.inference.frame_draw import FrameDraw
from motionkit.inference.frame_kernel import rises
from motionkit.inference.noise import Noise, NoiseState
from motionkit.inference.stepping import TorchStep, stepper
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import StartPose
from motionkit.motion.bvh_text import MAX_NUMBER
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import Skeleton, canonical_skeleton

# Called with the frame number and the ground state (B, 3) root x, z, heading; answers the controls.
Controller = Callable[[int, Array], Controls]


@dataclass(frozen=True, eq=False)
class Rollout:
    """What came out: features (B, T, 276) unnormalised, contacts (B, T, 4) in [0, 1], ground (B, T, 3)."""

    features: Array
    contacts: Array
    ground: Array

    def first(self, frames: int) -> Rollout:
        """The first frames of it."""
        return Rollout(self.features[:, :frames], self.contacts[:, :frames], self.ground[:, :frames])


def phase_at(frame: float, phase_frames: float) -> float:
    """Progress through performances of a length that follow each other; negative without a length."""
    return (frame / phase_frames) % 1.0 if phase_frames > 0 else -1.0


class RolloutState:
    """B characters in motion: step() moves all of them on by one frame.

    Attributes:
        frame: the present frame.
        controls: what was asked for, as the network takes it.
        noise: how frames are drawn, and the random numbers of each character.
        network: predicts the next frame; draws, which turns predictions into frames.
    """

    def __init__(self, model: MotionModel, batch: int, noise: Noise, seed: int | Sequence[int] = 0) -> None:
        """Set up the characters; start() gives them frames to go on from.

        Args:
            seed: of the first character's random numbers, the others count on from it; or one for each.

        Raises:
            ControlError: for a seed that is none.
        """
        self.model, self.batch = model, batch
        self.frame, self.controls = FrameArrays.of(batch), ControlInput(model, batch)
        self.noise_state = NoiseState(batch, seed)
        self.network = stepper(model.network, batch, self.noise_state.random)
        self.drawing = FrameDraw(model, self.frame, self.controls.presets, self.noise_state, noise)
        self._prime: RolloutState | None = None
        self.controls.set_skeletons([canonical_skeleton()] * batch)

    @property
    def noise(self) -> Noise:
        """How frames are drawn; may be changed between any two."""
        return self.drawing.noise

    @noise.setter
    def noise(self, noise: Noise) -> None:
        self.drawing.noise = noise

    @property
    def ground(self) -> Array:
        """Root x, z (cm) and heading (radians) of every character (B, 3)."""
        return self.frame.ground.copy()

    def start(
        self,
        features: Array | Sequence[Array],
        contacts: Array | Sequence[Array],
        type_weights: Array,
        ground: Array | None = None,
        phase_frames: float | Sequence[float] = 0.0,
        controls: Controller | None = None,
    ) -> None:
        """Prime with real frames: features (B, T, 276) unnormalised, contacts (B, T, 4), type weights (B, N).

        controls are asked for at each of these frames where they are known, for frames of one length; else they are
        the types alone.

        Frames may also be lists of B arrays (T, ...), each of a length of its own.
        phase_frames is the length of a performance, of all or of each, if the frames are the beginning of one.
        The last frame becomes the current one, at the place given by ground (B, 3), the origin by default.
        """
        lengths = [phase_frames] * self.batch if isinstance(phase_frames, (int, float)) else phase_frames
        if len({len(each) for each in features}) > 1:
            self.network.reset()
            for i, length in enumerate(lengths):
                place = None if ground is None else ground[i : i + 1]
                self.start_one(
                    i, features[i][None], contacts[i][None], type_weights[i : i + 1], place, length
                )
            return
        contacts, scaling, frame = np.asarray(contacts), self.model.scaling, self.frame
        x = ((np.asarray(features) - scaling.mean) / scaling.std).astype(np.float32)
        self.network.reset(x.shape[1] - 1)
        given = self.controls.recorded_trajectories(np.asarray(features)) if self.model.plain else None
        for t in range(x.shape[1] - 1):
            if given is not None:
                self.controls.trajectory[:] = given[:, t]
            if controls:
                asked = controls(t, frame.ground)
            else:
                phase = np.array([phase_at(t, length) for length in lengths], np.float32)
                asked = replace(Controls.of_types(type_weights), phase=phase)
            self.network.step(x[:, t], contacts[:, t], self.controls.take(asked, x[:, t]))
        self._keep_trajectory()
        frame.x[:], frame.contacts[:] = x[:, -1], contacts[:, -1]
        frame.before[:] = x[:, -2] if x.shape[1] > 1 else x[:, -1]
        frame.ground[:] = 0.0 if ground is None else ground
        self.noise_state.start()

    def start_one(
        self,
        index: int,
        features: Array,
        contacts: Array,
        type_weights: Array,
        ground: Array | None = None,
        phase_frames: float = 0.0,
    ) -> None:
        """Start one character anew, as start() does with all; the others go on. Shapes are those of a batch of one."""
        if self._prime is None:
            self._prime = RolloutState(self.model, 1, self.noise)
            self._prime.network = self.network.alone()
        one = self._prime
        one.noise_state.random = [self.noise_state.random[index]]
        one.controls.skeletons = self.controls.skeletons[index : index + 1]
        one.start(features, contacts, type_weights, ground, phase_frames)
        self.network.adopt(index, one.network)
        self.frame.adopt(index, one.frame)
        self.noise_state.adopt(index, one.noise_state)
        self.controls.trajectory[index] = one.controls.trajectory[0]

    def _keep_trajectory(self) -> None:
        if isinstance(self.network, TorchStep):
            self.controls.keep_trajectory(self.network.trajectory)

    def advance(self, asked: Controls) -> FrameArrays:
        """step() without copies: the frame it answers is overwritten by the next call."""
        frame = self.frame
        self.network.step(frame.x, frame.contacts, self.controls.take(asked, frame.x))
        self._keep_trajectory()
        self.drawing.draw(self.network)
        return frame

    def step(self, asked: Controls) -> tuple[Array, Array, Array]:
        """The next frame: features (B, 276) unnormalised, contacts (B, 4), ground (B, 3).

        Raises ModelError for a frame that no BVH file could hold.
        """
        made = self.advance(asked)
        features, contacts, ground = made.features, made.contacts, made.ground
        if not (
            np.abs(features).max() <= MAX_NUMBER and np.abs(ground).max() <= MAX_NUMBER
        ):  # NaN is neither
            raise ModelError(
                "the roll-out failed: the network predicts numbers that are not finite or far too large "
                "(damaged weights, or a start unlike any motion)"
            )
        return features.copy(), contacts.copy(), ground.copy()


def run(
    state: RolloutState,
    frames: int,
    controller: Controller,
    progress: Callable[[int], None] | None = None,
    done: Callable[[], bool] | None = None,
) -> Rollout:
    """Let a started state run on for some frames, or until done, which is called after every frame."""
    features, contacts, ground = [], [], []
    for t in range(frames):
        f, c, g = state.step(controller(t, state.ground))
        features.append(f)
        contacts.append(c)
        ground.append(g)
        if progress:
            progress(t + 1)
        if done and done():
            break
    return Rollout(np.stack(features, 1), np.stack(contacts, 1), np.stack(ground, 1))


def rollout_motion(model: MotionModel, rollout: Rollout, index: int, skeleton: Skeleton) -> Motion:
    """One character's motion by forward integration on a skeleton, raised to where its feet are unless it is plain."""
    features, layout = rollout.features[index], model.config.layout
    motion = decode_motion(
        features, skeleton, model.fps, rollout.ground[index, 0], model.reference_rotations, layout
    )
    if model.plain:
        return motion
    _, positions = motion_kinematics(motion)
    roots = motion.root_positions.copy()
    roots[:, 1] += rises(layout, features, positions[..., 1])
    return replace(motion, root_positions=roots)


def start_batch(seeds: list[StartPose]) -> tuple[Array, Array]:
    """Seeds cut to the length of the shortest, from the end: features (B, T, 276), contacts (B, T, 4)."""
    frames = min(len(seed.features) for seed in seeds)
    return (
        np.stack([seed.features[-frames:] for seed in seeds]),
        np.stack([seed.contacts[-frames:] for seed in seeds]),
    )
