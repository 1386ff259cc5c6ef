"""Closed-loop synthesis: the network's output is its next input, controls are asked for at every frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from ctypes import Structure
from dataclasses import dataclass, replace

import numpy as np

from motionkit.arrays import Array, Floats, row_products
from motionkit.errors import ControlError, ModelError
from motionkit.features.control import (
    TRAJECTORY_COUNT,
    Controls,
    control_vector,
    future_trajectory,
    skeleton_signal,
)
from motionkit.features.decode import decode_motion, integrate_ground
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT, feature_layout
from motionkit.inference import slip_correction
from motionkit.inference.frame_kernel import (
    BlendArrays,
    DrawArrays,
    FrameArrays,
    NoiseArrays,
    PredictionArrays,
    bind_draw,
    draw_words,
    frame_library,
)
from motionkit.inference.height_correction import raised
from motionkit.inference.pose import orthonormal
from motionkit.inference.step import NetworkStep
from motionkit.inference.stepping import TorchStep, stepper
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import StartPose
from motionkit.motion.bvh_text import MAX_NUMBER
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import Skeleton, canonical_skeleton
from motionkit.seeds import check_seed

NOISE_KINDS = ("mean", "sample", "correlated")


@dataclass(frozen=True)
class Noise:
    """How frames are drawn from the predicted Gaussians.

    kind "mean" takes the mean, "sample" draws each frame independently (the paper's default), "correlated" draws
    noise of the same variance that is correlated in time: white noise through two first-order filters, with
    coefficients rho and smoothing. After one filter alone the steps would still be white, and the body would shake.
    """

    kind: str = "correlated"
    temperature: float = 0.05
    rho: float = 0.95
    smoothing: float = 0.8

    def __post_init__(self) -> None:
        if self.kind not in NOISE_KINDS:
            raise ControlError(f"noise {self.kind!r} is unknown, expected one of {', '.join(NOISE_KINDS)}")

    @property
    def filters(self) -> tuple[float, float, float, float]:
        """The shares that each filter keeps of its last output and takes of its input: rho, share, smoothing, share."""
        if self.kind != "correlated":
            return 0.0, 1.0, 0.0, 1.0
        a, b = self.rho, self.smoothing
        # What comes out has the variance of what goes in.
        variance = (1.0 - b) / (1.0 + b) * (1.0 + a * b) / (1.0 - a * b)
        return a, (1.0 - a * a) ** 0.5, b, (1.0 - b) / variance**0.5


def default_noise(model: MotionModel) -> Noise:
    """How frames of a model are drawn by default: of plain models at full sigma, as in the paper."""
    return Noise("sample", 1.0) if model.plain else Noise()


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


def blended_columns(layout: str) -> Floats:
    """Share of a type's velocity_blend per feature (276,): 0 for heights, because the floor stops a fall at once."""
    columns = feature_layout(layout).columns
    upright = [c.block in ("joint_positions", "joint_velocities") and c.component == 1 for c in columns]
    return 1.0 - np.array(upright, np.float32)


class RolloutState:
    """B characters in motion: step() moves all of them on by one frame.

    Between steps all is kept in numpy arrays of fixed size.
    """

    def __init__(
        self,
        model: MotionModel,
        batch: int,
        noise: Noise,
        seed: int | Sequence[int] = 0,
        compiled: bool = True,
    ) -> None:
        """Set up the characters; start() gives them frames to go on from.

        Args:
            seed: of the first character's random numbers, the others count on from it; or one for each.
            compiled: False keeps to numpy around the network even where there is a compiled kernel.

        Raises:
            ControlError: for a seed that is none.
        """
        self.model, self.batch, self.compiled = model, batch, compiled
        self._noise = noise
        # One generator for each, so that a character's motion does not depend on those beside it.
        for each in seed if isinstance(seed, Sequence) else (seed,):
            check_seed(each)
        seeds = seed if isinstance(seed, Sequence) else range(seed, seed + batch)
        self.random = [np.random.default_rng(each) for _, each in zip(range(batch), seeds, strict=True)]
        self.network = stepper(model.network, batch, self.random)
        layout = feature_layout(model.config.layout)
        blocks = layout.blocks
        self._sixd = blocks["root_rotation"] if layout.root_is_sixd else None
        self._yaw, self._xz = blocks["root_yaw_velocity"].start, blocks["root_xz_velocity"]
        self._mean, self._std = model.scaling.mean, model.scaling.std
        self._layout = model.controls
        self._presets = np.stack(
            [model.presets(name) for name in ("noise_scale", "velocity_blend", "slip_correction")], axis=1
        )
        self._feet = slip_correction.foot_columns(model.config.layout)
        self._blended = blended_columns(model.config.layout)
        self._references = model.reference_map
        self._controls = np.zeros((batch, self._layout.size), np.float32)
        self._x = np.zeros((batch, FEATURE_COUNT), np.float32)
        self._before = np.zeros((batch, FEATURE_COUNT), np.float32)  # the frame before
        self._velocity_blend = np.zeros((batch, 1), np.float32)
        self._slip_correction = np.zeros((batch, 1), np.float32)
        self._contacts = np.zeros((batch, CONTACT_COUNT), np.float32)
        self._ground = np.zeros((batch, 3), np.float32)
        self._features = np.zeros((batch, FEATURE_COUNT), np.float32)
        self._noise_state = np.zeros((batch, FEATURE_COUNT), np.float32)
        self._smooth_noise = np.zeros((batch, FEATURE_COUNT), np.float32)
        self._own_trajectory = np.zeros((batch, TRAJECTORY_COUNT), np.float32)  # in cm, as predicted
        self._prime: RolloutState | None = None
        self._drawn_from: NetworkStep | TorchStep | None = None
        self.set_skeletons([canonical_skeleton()] * batch)

    @property
    def noise(self) -> Noise:
        """How frames are drawn; may be changed between any two."""
        return self._noise

    @noise.setter
    def noise(self, noise: Noise) -> None:
        self._noise = noise
        self._drawn_from = None

    @property
    def ground(self) -> Array:
        """Root x, z (cm) and heading (radians) of every character (B, 3)."""
        return self._ground.copy()

    @property
    def features(self) -> Floats:
        """The last frame that was made (B, 276), unnormalised; changed by the next step."""
        return self._features

    @property
    def normalised(self) -> Floats:
        """The current frame (B, 276), normalised; changed by the next step."""
        return self._x

    @property
    def drawn_noise(self) -> Floats:
        """The noise in the current frame (B, 276), in standard deviations of the predicted Gaussians."""
        if self.noise.kind == "mean":
            return np.zeros_like(self._x)
        return self._smooth_noise * np.float32(self.noise.temperature) * np.exp(self._log_share)

    def set_skeletons(self, skeletons: list[Skeleton]) -> None:
        """The skeleton control signal of each character."""
        self._skeletons = np.stack([skeleton_signal(s) for s in skeletons])

    def set_skeleton(self, index: int, skeleton: Skeleton) -> None:
        """The skeleton control signal of one character."""
        self._skeletons[index] = skeleton_signal(skeleton)

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
        contacts = np.asarray(contacts)
        x = ((np.asarray(features) - self._mean) / self._std).astype(np.float32)
        self.network.reset(x.shape[1] - 1)
        given = self._recorded_trajectories(np.asarray(features)) if self.model.plain else None
        for t in range(x.shape[1] - 1):
            phase = np.array([phase_at(t, length) for length in lengths], np.float32)
            if given is not None:
                self._own_trajectory[:] = given[:, t]
            asked = controls(t, self._ground) if controls else Controls.of_types(type_weights)
            self._ask(asked if controls else replace(asked, phase=phase), x[:, t])
            self.network.step(x[:, t], contacts[:, t], self._controls)
        self._keep_trajectory()
        self._x[:], self._contacts[:] = x[:, -1], contacts[:, -1]
        self._before[:] = x[:, -2] if x.shape[1] > 1 else x[:, -1]
        self._ground[:] = 0.0 if ground is None else ground
        self._draw_normals(self._noise_state)
        self._smooth_noise[:] = self._noise_state

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
        one.random = [self.random[index]]
        one._skeletons = self._skeletons[index : index + 1]
        one.start(features, contacts, type_weights, ground, phase_frames)
        self.network.adopt(index, one.network)
        for mine, its in (
            (self._x, one._x),
            (self._before, one._before),
            (self._contacts, one._contacts),
            (self._ground, one._ground),
            (self._noise_state, one._noise_state),
            (self._smooth_noise, one._smooth_noise),
            (self._own_trajectory, one._own_trajectory),
        ):
            mine[index] = its[0]

    def _ask(self, asked: Controls, x: Floats) -> None:
        """Take in controls for normalised frames x: control vectors, and the sampling presets of the types."""
        if self.model.plain:
            asked = self._with_own_trajectory(asked)
        presets = row_products(asked.type_weights, self._presets)
        self._log_share = np.log(np.maximum(presets[:, :1], 1e-6))
        self._velocity_blend[:], self._slip_correction[:] = presets[:, 1:2], presets[:, 2:]
        self._slip_correction[:, 0] *= asked.slip_correction
        self._controls[:] = control_vector(
            self._layout, self._skeletons, asked, x, self.model.trajectory_scaling, self._references
        )

    def _recorded_trajectories(self, features: Array) -> Array:
        """The trajectories (B, T, 24) of recorded frames (B, T, 276), which go straight on after the last of them."""
        origin = np.zeros((len(features), 3), np.float32)
        ground = integrate_ground(features, origin, self.model.fps, self.model.config.layout)
        frames = np.arange(features.shape[1])
        return np.stack([future_trajectory(each.astype(np.float32), frames) for each in ground])

    def _keep_trajectory(self) -> None:
        """Keep the trajectory predicted for the frame that comes (paper section 5.2)."""
        if self.model.plain and isinstance(self.network, TorchStep):
            self._own_trajectory[:] = self.model.trajectory_scaling.denormalize(self.network.trajectory)

    def _with_own_trajectory(self, asked: Controls) -> Controls:
        """Controls in which the predicted trajectory stands where none is asked for."""
        given = asked.trajectory_mask[:, None] > 0.0
        return replace(asked, trajectory=np.where(given, asked.trajectory, self._own_trajectory)).with_mask(
            1.0
        )

    def advance(self, asked: Controls) -> tuple[Floats, Floats, Floats]:
        """step() without copies: what it answers is overwritten by the next call."""
        self._ask(asked, self._x)
        network = self.network
        network.step(self._x, self._contacts, self._controls)
        self._keep_trajectory()
        network.log_sigma += self._log_share
        if self._drawn_from is not network:
            self._bind(network)
        self._draw()
        return self._features, self._contacts, self._ground

    def _bind(self, network: NetworkStep | TorchStep) -> None:
        """Choose how frames are drawn: by the compiled kernel where there is one, else by numpy."""
        self._drawn_from = network
        library = frame_library() if self.compiled else None
        if library is None:
            self._draw = self._draw_in_numpy
            return
        fresh = None if self.noise.kind == "mean" else np.zeros_like(self._x)
        words, arrays = self.draw_words(network, fresh)
        call = bind_draw(library, words, arrays)

        def draw() -> None:
            if fresh is not None:
                self._draw_normals(fresh)
            call()

        self._draw = draw

    def draw_words(
        self, network: NetworkStep | TorchStep, fresh: Floats | None
    ) -> tuple[Structure, DrawArrays]:
        """What draw_frames is told to draw the next frame of a network by fresh normal numbers, and its arrays."""
        arrays = DrawArrays(
            PredictionArrays(network.mean, network.log_sigma, network.contact_logits),
            (self._mean, self._std),
            NoiseArrays(fresh, self._noise_state, self._smooth_noise),
            BlendArrays(self._blended, self._velocity_blend, self._slip_correction, self._before),
            FrameArrays(self._x, self._contacts, self._features, self._ground),
        )
        noise = (*self.noise.filters, self.noise.temperature)
        columns = (self._yaw, self._xz.start, self._sixd.start if self._sixd else -1, self._feet)
        return draw_words(arrays, columns, noise, self.model.fps), arrays

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")  # step() looks at what comes out
    def _draw_in_numpy(self) -> None:
        """Functions in double precision, so that they give to the last digit what frame_kernel.c gives."""
        network = self._drawn_from
        assert network is not None
        onwards = self._x + (self._x - self._before)
        self._before[:] = self._x
        if self.noise.kind == "mean":
            self._x[:] = network.mean
        else:
            self._x[:] = np.exp(network.log_sigma, dtype=np.float64)
            self._x *= self._next_noise()
            self._x += network.mean
        onwards -= self._x
        self._x += onwards * (self._velocity_blend * self._blended)
        self._contacts[:] = 1.0 / (1.0 + np.exp(-network.contact_logits, dtype=np.float64))
        features = np.multiply(self._x, self._std, out=self._features)
        features += self._mean
        if self._sixd:
            self._keep_rotation(self._sixd)
        if self._slip_correction.any():
            self._hold_ground()
        ground, fps = self._ground, np.float32(self.model.fps)
        ground[:, 2] += features[:, self._yaw] / fps
        sine, cosine = (f(ground[:, 2], dtype=np.float64).astype(np.float32) for f in (np.sin, np.cos))
        velocity = features[:, self._xz] / fps
        ground[:, 0] += cosine * velocity[:, 0] + sine * velocity[:, 1]
        ground[:, 1] += cosine * velocity[:, 1] - sine * velocity[:, 0]

    def _keep_rotation(self, root: slice) -> None:
        """Make the two columns of the root's rotation orthonormal, as all that the network has learnt from are.

        Drawn frame by frame they shrink; where one goes through zero, the body turns over in a frame.
        """
        self._features[:, root] = [orthonormal(row) for row in self._features[:, root].tolist()]
        self._x[:, root] = (self._features[:, root] - self._mean[root]) / self._std[root]

    def _hold_ground(self) -> None:
        """Take out of the root's velocities, in part, what feet on the ground would slide."""
        features, fps, feet = self._features, np.float32(self.model.fps), self._feet
        before = self._before[:, feet] * self._std[feet] + self._mean[feet]
        turn, step = features[:, self._yaw] / fps, features[:, self._xz] / fps
        angle, move = slip_correction.standing_move(features[:, feet], before, turn, step)
        share = self._slip_correction.astype(np.float64) * self.model.fps
        moved = (np.concatenate([angle[:, None], move], axis=1) * share).astype(np.float32)
        for columns, by in ((slice(self._yaw, self._yaw + 1), moved[:, :1]), (self._xz, moved[:, 1:])):
            features[:, columns] += by
            self._x[:, columns] += by / self._std[columns]

    def step(self, asked: Controls) -> tuple[Array, Array, Array]:
        """The next frame: features (B, 276) unnormalised, contacts (B, 4), ground (B, 3).

        Raises ModelError for a frame that no BVH file could hold.
        """
        features, contacts, ground = self.advance(asked)
        if not (
            np.abs(features).max() <= MAX_NUMBER and np.abs(ground).max() <= MAX_NUMBER
        ):  # NaN is neither
            raise ModelError(
                "the roll-out failed: the network predicts numbers that are not finite or far too large "
                "(damaged weights, or a start unlike any motion)"
            )
        return features.copy(), contacts.copy(), ground.copy()

    def _draw_normals(self, out: Floats) -> None:
        """Fill rows (B, 276) with standard normal numbers, each from its character's generator."""
        for generator, row in zip(self.random, out, strict=True):
            generator.standard_normal(dtype=np.float32, out=row)

    def _next_noise(self) -> Floats:
        fresh = np.empty_like(self._x)
        self._draw_normals(fresh)
        for state, keeps, takes in zip(
            (self._noise_state, self._smooth_noise),
            self.noise.filters[::2],
            self.noise.filters[1::2],
            strict=True,
        ):
            state *= np.float32(keeps)
            state += fresh * np.float32(takes)
            fresh = state
        return fresh * np.float32(self.noise.temperature)


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
    roots = raised(
        features[None], motion.local_rotations[None], motion.root_positions[None], skeleton, layout
    )
    return replace(motion, root_positions=roots[0])


def start_batch(seeds: list[StartPose]) -> tuple[Array, Array]:
    """Seeds cut to the length of the shortest, from the end: features (B, T, 276), contacts (B, T, 4)."""
    frames = min(len(seed.features) for seed in seeds)
    return (
        np.stack([seed.features[-frames:] for seed in seeds]),
        np.stack([seed.contacts[-frames:] for seed in seeds]),
    )
