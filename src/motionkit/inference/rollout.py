"""Closed-loop synthesis: each output frame becomes the next input, with controls for every frame."""

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
from motionkit.motion.bvh_rows import MAX_NUMBER
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import Skeleton, canonical_skeleton

# Takes the frame number and the ground state (B, 3), root x, z and heading; returns the controls of the frame.
Controller = Callable[[int, Array], Controls]


@dataclass(frozen=True, eq=False)
class Rollout:
    """Output of a roll-out: features (B, T, 276) unnormalised, contacts (B, T, 4) in [0, 1], ground (B, T, 3)."""

    features: Array
    contacts: Array
    ground: Array

    def first(self, frames: int) -> Rollout:
        """The first frames of the roll-out."""
        return Rollout(self.features[:, :frames], self.contacts[:, :frames], self.ground[:, :frames])


def phase_at(frame: float, phase_frames: float) -> float:
    """Phase of a frame in performances of phase_frames one after another; -1 if phase_frames is 0."""
    return (frame / phase_frames) % 1.0 if phase_frames > 0 else -1.0


class RolloutState:
    """B characters in motion: step() moves all of them by one frame.

    Attributes:
        frame: the present frame.
        controls: control vectors and sampling presets of the present frame.
        noise_state: random numbers and noise filters of each character.
        network: predicts the next frame.
        drawing: samples frames from the predictions.
    """

    def __init__(self, model: MotionModel, batch: int, noise: Noise, seed: int | Sequence[int] = 0) -> None:
        """Set up the characters; start() gives them their first frames.

        Args:
            seed: seed of the first character, counted up for the others; or one seed for each.

        Raises:
            ControlError: for an invalid seed.
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
        """How frames are drawn; may change between frames."""
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
        """Prime the characters with recorded frames; the last of them becomes the present frame.

        Args:
            features: (B, T, 276) unnormalised, or a list of B arrays (T, 276) of different lengths.
            contacts: (B, T, 4), or a list as for features.
            type_weights: (B, N).
            ground: (B, 3) place of the last frame; the origin by default.
            phase_frames: length of the performance that the frames begin, for all characters or for each; 0 for none.
            controls: the controls of these frames, if they are known and all characters have as many frames; by
                default the types alone.
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
        trajectories = self.controls.recorded_trajectories(np.asarray(features)) if self.model.plain else None
        for t in range(x.shape[1] - 1):
            if trajectories is not None:
                self.controls.trajectory[:] = trajectories[:, t]
            if controls:
                now = controls(t, frame.ground)
            else:
                phase = np.array([phase_at(t, length) for length in lengths], np.float32)
                now = replace(Controls.of_types(type_weights), phase=phase)
            self.network.step(x[:, t], contacts[:, t], self.controls.take(now, x[:, t]))
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
        """Restart one character as start() does, with arrays for a batch of one; the others go on."""
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

    def advance(self, controls: Controls) -> FrameArrays:
        """Like step(), but without copies: the next call overwrites the returned frame."""
        frame = self.frame
        self.network.step(frame.x, frame.contacts, self.controls.take(controls, frame.x))
        self._keep_trajectory()
        self.drawing.draw(self.network)
        return frame

    def step(self, controls: Controls) -> tuple[Array, Array, Array]:
        """Return the next frame: features (B, 276) unnormalised, contacts (B, 4), ground (B, 3).

        Raises ModelError for a frame that no BVH file could hold.
        """
        made = self.advance(controls)
        features, contacts, ground = made.features, made.contacts, made.ground
        # The negation also catches NaN.
        if not (np.abs(features).max() <= MAX_NUMBER and np.abs(ground).max() <= MAX_NUMBER):
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
    """Run a started state for some frames, or until done() is true after a frame."""
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
    """Decode the motion of one character on a skeleton, with root-height correction unless the model is plain."""
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
    """Batch the last frames of start poses, as many as the shortest has: features (B, T, 276), contacts (B, T, 4)."""
    frames = min(len(seed.features) for seed in seeds)
    return (
        np.stack([seed.features[-frames:] for seed in seeds]),
        np.stack([seed.contacts[-frames:] for seed in seeds]),
    )
