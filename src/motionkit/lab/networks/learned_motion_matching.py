"""Learned motion matching (Holden et al. 2020): motion matching whose database is kept in three networks.

A decompressor makes a pose from matching features and latent numbers, a stepper leads both to the next frame, and a
projector finds those nearest to a query, which happens every third of a second. Matching features are the places and
velocities of the feet, the velocity of the hips, and the control vector in place of the paper's future trajectory. Two
things differ from the paper: all networks are trained at once, the last two on latent numbers without gradient; and the
nearest neighbours that the projector learns are sought among the frames of the batch instead of the whole database.
Shape legend: B batch, T frames, M matching features, Z latent numbers, N rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from motionkit.features.control import TRAJECTORY_COUNT
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT, feature_layout
from motionkit.lab.networks.baseline import (
    NO_SIGMA,
    BaselineConfig,
    masked_mean,
    mlp,
    prediction_losses,
    steps,
)
from motionkit.models.batch import Batch, FeatureSpace
from motionkit.models.predictor import NextFrame, Predictor
from motionkit.motion.skeleton import FOOT_JOINTS

SEARCHED = 20  # frames between searches
# Weights of the losses: steps between decompressed frames, the size of the latent numbers and of their steps.
WEIGHTS = {"step": 5.0, "size": 0.1, "rough": 0.01}


@dataclass(frozen=True)
class LearnedMotionMatchingConfig(BaselineConfig):
    """Sizes of the networks."""

    architecture: str = "learned-motion-matching"
    hidden: int = 512
    latent: int = 32


class LearnedMotionMatching(Predictor):
    """A query in every third of a second, poses out."""

    config: LearnedMotionMatchingConfig
    config_class = LearnedMotionMatchingConfig

    def __init__(self, config: LearnedMotionMatchingConfig, control_size: int) -> None:
        super().__init__(config, control_size)
        layout = feature_layout(config.layout)
        matched = layout.block_columns("joint_positions", FOOT_JOINTS)
        matched += layout.block_columns("joint_velocities", (*FOOT_JOINTS, 0))
        self.matched: Tensor
        self.register_buffer("matched", torch.tensor(matched), persistent=False)
        self.matching_size = len(matched) + control_size
        pose, state = FEATURE_COUNT + CONTACT_COUNT, self.matching_size + config.latent

        def layers(inputs: int, count: int, outputs: int) -> nn.Sequential:
            return mlp((inputs, *[config.hidden] * count, outputs), nn.ReLU)

        self.compressor = layers(pose, 3, config.latent)  # for training
        self.decompressor = layers(state, 1, pose)
        self.stepper = layers(state, 2, state)
        self.projector = layers(self.matching_size, 4, state)

    def matching(self, x: Tensor, controls: Tensor) -> Tensor:
        """Return matching features (..., M) of features (..., 276) and controls (..., C)."""
        return torch.cat([x[..., self.matched], controls], dim=-1)

    def frame(self, state: Tensor) -> NextFrame:
        """Return the frame in matching features and latent numbers (..., M + Z)."""
        x, contacts = self.decompressor(state).float().split([FEATURE_COUNT, CONTACT_COUNT], dim=-1)
        # The control vector ends with the trajectory, and it is the last of the matching features.
        end = self.matching_size
        trajectory = state[..., end - TRAJECTORY_COUNT : end].float()
        return NextFrame(x, torch.full_like(x, NO_SIGMA), contacts, trajectory)

    def losses(self, batch: Batch, space: FeatureSpace, progress: float) -> dict[str, Tensor]:
        """Return the losses of decompressor, stepper and projector."""
        matching = self.matching(batch.inputs, batch.controls)
        latent = self.compressor(torch.cat([batch.inputs, batch.contacts], dim=-1))
        state = torch.cat([matching, latent.to(matching.dtype)], dim=-1)
        made = self.frame(state)
        # Of the present frame: a copy of the batch with it as the target. The trajectory is only carried along.
        present = Batch(
            **{
                **vars(batch),
                "targets": batch.inputs,
                "next_contacts": batch.contacts,
                "trajectory": made.trajectory_mean,
            }
        )
        rebuilt = prediction_losses(made, present)
        known = state.detach().float()
        return {
            "mse": rebuilt["mse"],
            "contact": rebuilt["contact"],
            "step": WEIGHTS["step"]
            * masked_mean((steps(made.mean) - steps(batch.inputs)).square(), batch.mask[:, 1:]),
            "size": WEIGHTS["size"] * masked_mean(latent.float().square(), batch.mask),
            "rough": WEIGHTS["rough"] * masked_mean(steps(latent.float()).abs(), batch.mask[:, 1:]),
            "stepper": self._stepper_loss(known, batch.mask),
            "projector": self._projector_loss(known.flatten(0, 1), batch.mask.flatten()),
        }

    def _stepper_loss(self, state: Tensor, mask: Tensor) -> Tensor:
        """Return the mean distance of SEARCHED steps, each from the one before, from states (B, T, M + Z) of a mask."""
        runs = max(1, state.shape[1] // SEARCHED)
        length = min(SEARCHED, state.shape[1])
        true = state[:, : runs * length].reshape(-1, length, state.shape[-1])
        at, errors = true[:, 0], []
        for t in range(1, length):
            at = at + self.stepper(at).float()
            errors.append((at - true[:, t]).abs())
        return masked_mean(torch.stack(errors, dim=1), mask[:, : runs * length].reshape(-1, length)[:, 1:])

    def _projector_loss(self, state: Tensor, mask: Tensor) -> Tensor:
        """Return the mean distance of projected queries from the nearest of the states (N, M + Z) of a mask (N,)."""
        features = state[:, : self.matching_size]
        noise = torch.rand(len(features), 1, device=features.device) * torch.randn_like(features)
        queries = features + noise
        apart = torch.cdist(queries, features)
        nearest = torch.where(mask > 0.0, apart, torch.inf).argmin(dim=1)
        return ((self.projector(queries).float() - state[nearest]).abs().mean(dim=-1) * mask).mean()

    def stream(self, batch: int) -> MatchingStream:
        """Return the state of a batch of characters."""
        return MatchingStream(self)


class MatchingStream:
    """Matching features and latent numbers of B characters, and when they were last sought."""

    def __init__(self, network: LearnedMotionMatching) -> None:
        self.network = network
        self.reset()

    def reset(self, warmup: int = 0) -> None:
        """Forget all frames; recorded ones are all sought, so that the last of them is."""
        self.since, self.warmup = 0, warmup
        self.state: Tensor | None = None

    def step(
        self, x_BF: Tensor, contacts_B4: Tensor, controls_BC: Tensor, latent_BZ: Tensor | None = None
    ) -> NextFrame:
        """Predict the next frame; the frame itself and the controls only count where a search is due."""
        if self.state is None or self.warmup > 0 or self.since >= SEARCHED:
            self.state = self.network.projector(self.network.matching(x_BF, controls_BC))
            self.since = 0
        self.warmup, self.since = self.warmup - 1, self.since + 1
        self.state = self.state + self.network.stepper(self.state)
        return self.network.frame(self.state)
