"""Closed-loop synthesis: the network's output is its next input, controls are asked for at every frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from motionkit.errors import ControlError
from motionkit.features.control import TRAJECTORY_COUNT, control_vector, skeleton_signal
from motionkit.features.decode import decode_motion
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT, feature_layout
from motionkit.models.checkpoint import MotionModel, Seed
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import rotate_ground
from motionkit.motion.skeleton import Skeleton, canonical_skeleton
from motionkit.synthesis.stream import NetworkStream

NOISE_KINDS = ("mean", "sample", "correlated")


@dataclass(frozen=True)
class Noise:
    """How frames are drawn from the predicted Gaussians.

    kind "mean" takes the mean, "sample" draws each frame anew (the paper's default), "correlated" draws
    noise that follows itself over time (first-order auto-regressive with coefficient rho).
    """

    kind: str = "correlated"
    temperature: float = 0.3
    rho: float = 0.95

    def __post_init__(self) -> None:
        if self.kind not in NOISE_KINDS:
            raise ControlError(f"noise {self.kind!r} is unknown, expected one of {', '.join(NOISE_KINDS)}")


@dataclass(frozen=True, eq=False)
class FrameControls:
    """What is asked of B characters at one frame.

    type_weights: (B, N). trajectory: (B, 24) unnormalised, in the heading frame of now. given: (B,) 1 where
    the trajectory counts. progress: (B,) through a performance of a type with a phase, else negative.
    """

    type_weights: Tensor
    trajectory: Tensor
    given: Tensor
    progress: Tensor


# Called with the frame number and the ground state (B, 3) root x, z, heading; answers the controls.
Controller = Callable[[int, Tensor], FrameControls]


@dataclass(frozen=True, eq=False)
class Rollout:
    """What came out: features (B, T, 276) unnormalised, contacts (B, T, 4) in [0, 1], ground (B, T, 3)."""

    features: Tensor
    contacts: Tensor
    ground: Tensor


def progress_at(frame: float, phase_frames: float) -> float:
    """Progress through performances of a length that follow each other; negative without a length."""
    return (frame / phase_frames) % 1.0 if phase_frames > 0 else -1.0


class RolloutState:
    """B characters in motion: step() moves all of them on by one frame."""

    def __init__(self, model: MotionModel, batch: int, noise: Noise, seed: int = 0) -> None:
        self.model, self.batch, self.noise = model, batch, noise
        self.stream = NetworkStream(model.network, batch)
        self.generator = torch.Generator().manual_seed(seed)
        self.layout = feature_layout(model.config.layout)
        skeletons = [skeleton_signal(canonical_skeleton())] * batch
        self.skeleton = torch.stack(skeletons)
        self.x = torch.zeros(batch, FEATURE_COUNT)
        self.contacts = torch.zeros(batch, CONTACT_COUNT)
        self.ground = torch.zeros(batch, 3)
        self.noise_state = torch.zeros(batch, FEATURE_COUNT)
        self.frame = 0

    def set_skeletons(self, skeletons: list[Skeleton]) -> None:
        """The skeleton control signal of each character."""
        self.skeleton = torch.stack([skeleton_signal(s) for s in skeletons])

    def start(
        self,
        features: Tensor,
        contacts: Tensor,
        type_weights: Tensor,
        ground: Tensor | None = None,
        phase_frames: float = 0.0,
    ) -> None:
        """Prime with real frames: features (B, T, 276) unnormalised, contacts (B, T, 4), type weights (B, N).

        phase_frames is the length of a performance, if the frames are the beginning of one.
        The last frame becomes the current one, at the place given by ground (B, 3), the origin by default.
        """
        self.stream.reset()
        x = self.model.scaling.normalize(features)
        none = torch.zeros(self.batch, TRAJECTORY_COUNT)
        for t in range(x.shape[1] - 1):
            progress = torch.full((self.batch,), progress_at(t, phase_frames))
            asked = FrameControls(type_weights, none, torch.zeros(self.batch), progress)
            self.stream.step(x[:, t], contacts[:, t], self._controls(asked))
        self.x, self.contacts = x[:, -1], contacts[:, -1]
        self.ground = torch.zeros(self.batch, 3) if ground is None else ground.clone()
        self.noise_state = torch.randn(self.batch, FEATURE_COUNT, generator=self.generator)
        self.frame = 0

    def _controls(self, asked: FrameControls) -> Tensor:
        return control_vector(
            self.model.controls,
            self.skeleton,
            asked.type_weights,
            asked.trajectory,
            asked.given,
            asked.progress,
            self.model.trajectory_scaling,
        )

    @torch.inference_mode()
    def step(self, asked: FrameControls) -> tuple[Tensor, Tensor, Tensor]:
        """The next frame: features (B, 276) unnormalised, contacts (B, 4), ground (B, 3)."""
        prediction = self.stream.step(self.x, self.contacts, self._controls(asked))
        self.x = prediction.mean + self._noise() * torch.exp(prediction.log_sigma)
        self.contacts = torch.sigmoid(prediction.contact_logits)
        features = self.model.scaling.denormalize(self.x)
        blocks, fps = self.layout.blocks, self.model.fps
        yaw = self.ground[:, 2] + features[:, blocks["root_yaw_velocity"]][:, 0] / fps
        xz = self.ground[:, :2] + rotate_ground(yaw, features[:, blocks["root_xz_velocity"]] / fps)
        self.ground = torch.cat([xz, yaw[:, None]], dim=-1)
        self.frame += 1
        return features, self.contacts, self.ground

    def _noise(self) -> Tensor:
        if self.noise.kind == "mean":
            return torch.zeros(())
        fresh = torch.randn(self.batch, FEATURE_COUNT, generator=self.generator)
        if self.noise.kind == "sample":
            return fresh * self.noise.temperature
        rho = self.noise.rho
        self.noise_state = rho * self.noise_state + (1.0 - rho * rho) ** 0.5 * fresh
        return self.noise_state * self.noise.temperature


def run(
    state: RolloutState, frames: int, controller: Controller, progress: Callable[[int], None] | None = None
) -> Rollout:
    """Let a started state run on for some frames."""
    features, contacts, ground = [], [], []
    for t in range(frames):
        f, c, g = state.step(controller(t, state.ground))
        features.append(f)
        contacts.append(c)
        ground.append(g)
        if progress:
            progress(t + 1)
    return Rollout(torch.stack(features, 1), torch.stack(contacts, 1), torch.stack(ground, 1))


def rollout_motion(model: MotionModel, rollout: Rollout, index: int, skeleton: Skeleton) -> Motion:
    """One character's motion by forward integration on a skeleton."""
    return decode_motion(
        rollout.features[index],
        skeleton,
        model.fps,
        rollout.ground[index, 0],
        model.references,
        model.config.layout,
    )


def seed_batch(seeds: list[Seed]) -> tuple[Tensor, Tensor]:
    """Seeds cut to the length of the shortest, from the end: features (B, T, 276), contacts (B, T, 4)."""
    frames = min(len(seed.features) for seed in seeds)
    return (
        torch.stack([seed.features[-frames:] for seed in seeds]),
        torch.stack([seed.contacts[-frames:] for seed in seeds]),
    )
