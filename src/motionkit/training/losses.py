"""The six losses of the paper (section 4.2), each a function, each logged by its name.

All norms are over normalised features, except the FK loss, whose foot positions are in units of
20 cm (about the deviation of foot positions). mask is (B, T): 0 where a
window has ended, else such that every window weighs the same; means divide by B T, so that the mean over
equal shares of a batch is the mean over the batch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from motionkit.data.dataset import Dataset
from motionkit.features.layout import feature_layout
from motionkit.models.consistency import ConsistencyModules, feature_difference, safe_norm, shared_data
from motionkit.models.network import PartTransformer, Prediction
from motionkit.models.torch_rotations import decode_rotations, quat_from_yaw, quat_multiply, quat_rotate
from motionkit.motion.skeleton import FOOT_JOINTS, PARENTS

FOOT_UNIT = 20.0  # cm
NEAR_GROUND = 15.0  # cm; the higher a foot joint is, up to here, the less its movement counts
TYPICAL_SIGMA = 0.1  # of a trained network
WEIGHTS = {"gauss": 1.0, "smooth": 10.0, "contact": 5.0, "fk": 5.0, "consistency": 1.0, "trajectory": 1.0}


@dataclass(frozen=True)
class LossOptions:
    """How the terms are measured, by default as in the paper.

    outlier and beta_nll are those of gaussian_loss, both weights those of fk_loss; step_except names the types in
    whose frames step_weight does not count.
    """

    outlier: float = math.inf
    beta_nll: float = 0.0
    slip_weight: float = 1.0
    step_weight: float = 0.0
    step_except: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Batch:
    """A batch of windows, normalised; targets are one frame ahead of inputs.

    inputs, targets: (B, T, 276). contacts, next_contacts: (B, T, 4). controls: (B, T, C).
    trajectory: (B, T, 24) of the target frame. offsets: (B, 23, 3) cm. mask: (B, T).
    """

    inputs: Tensor
    targets: Tensor
    contacts: Tensor
    next_contacts: Tensor
    controls: Tensor
    trajectory: Tensor
    offsets: Tensor
    mask: Tensor

    def to(self, device: torch.device | str) -> Batch:
        """The batch on another device."""
        return Batch(**{name: value.to(device, non_blocking=True) for name, value in vars(self).items()})

    def part(self, index: int, count: int) -> Batch:
        """The index-th of count equal parts."""
        return Batch(**{name: value.chunk(count)[index] for name, value in vars(self).items()})


@dataclass(frozen=True, eq=False)
class FeatureSpace:
    """What normalised features mean: mean and std (276,), reference_rotations (23, 4), the layout's version, the rate."""

    mean: Tensor
    std: Tensor
    reference_rotations: Tensor
    layout: str
    fps: float

    @classmethod
    def of(cls, dataset: Dataset) -> FeatureSpace:
        """That of a dataset, on the CPU."""
        mean, std, reference_rotations = (
            torch.from_numpy(array)
            for array in (dataset.scaling.mean, dataset.scaling.std, dataset.reference_rotations)
        )
        return cls(mean, std, reference_rotations, dataset.layout.version, dataset.fps)

    def to(self, device: torch.device) -> FeatureSpace:
        """The same on another device."""
        mean, std, reference_rotations = (
            t.to(device) for t in (self.mean, self.std, self.reference_rotations)
        )
        return FeatureSpace(mean, std, reference_rotations, self.layout, self.fps)

    def denormalize(self, values: Tensor) -> Tensor:
        """Features (..., 276) in cm, radians and their rates."""
        return values * self.std + self.mean

    def root_height(self, features: Tensor) -> Tensor:
        """Height (...) in cm of the root, from unnormalised features."""
        return features[..., feature_layout(self.layout).root_height]


def _mean(values: Tensor, mask: Tensor) -> Tensor:
    return (values * mask).sum() / mask.numel()


def gaussian_loss(
    mean: Tensor,
    log_sigma: Tensor,
    target: Tensor,
    mask: Tensor,
    outlier: float = math.inf,
    beta_nll: float = 0.0,
) -> Tensor:
    """Negative log-likelihood per frame, summed over columns (L_G; also L_t over the trajectory).

    What is hard to predict gets a large sigma, and the likelihood's gradient on the mean then fades with its
    square: easy frames are learned ever better, hard ones never. Each term counts by (sigma / TYPICAL_SIGMA) to the
    power 2 x beta_nll, which is not differentiated (Seitzer et al. 2022, "On the Pitfalls of Heteroscedastic
    Uncertainty Estimation"); 0 is the plain likelihood, 1 weighs all errors alike.

    Beyond outlier deviations the square goes on as a straight line (Huber 1964). Exponential maps jump where
    a joint turns past half a turn, once in some hundred frames; squared, that one frame outweighs its batch.
    """
    scaled = ((target - mean) * torch.exp(-log_sigma)).abs()
    inner = scaled.clamp(max=outlier)
    penalty = inner * (scaled - 0.5 * inner)
    terms = penalty + log_sigma + 0.9189385
    if beta_nll:
        terms = terms * torch.exp(2.0 * beta_nll * (log_sigma.detach() - math.log(TYPICAL_SIGMA)))
    return _mean(terms.sum(-1), mask)


def smoothness_loss(mean: Tensor, mask: Tensor) -> Tensor:
    """Norm of the second difference of the predicted means (L_s)."""
    if mean.shape[1] < 3:
        return torch.zeros((), device=mean.device)
    return _mean(safe_norm(mean[:, :-2] + mean[:, 2:] - 2.0 * mean[:, 1:-1]), mask[:, 2:])


def contact_loss(logits: Tensor, target: Tensor, mask: Tensor) -> Tensor:
    """Binary cross-entropy of the four contacts, summed (L_f)."""
    return _mean(F.binary_cross_entropy_with_logits(logits, target, reduction="none").sum(-1), mask)


def foot_positions(features: Tensor, offsets: Tensor, space: FeatureSpace) -> Tensor:
    """Feet (B, T, 4, 3) in cm relative to the root, in the heading frame, from unnormalised features."""
    rotations = decode_rotations(features, space.reference_rotations, space.layout)
    feet = []
    for ankle, toe in (FOOT_JOINTS[:2], FOOT_JOINTS[2:]):
        chain = [ankle]
        while PARENTS[chain[0]] > 0:
            chain.insert(0, PARENTS[chain[0]])
        turn = rotations[..., 0, :]
        place = torch.zeros_like(features[..., :3])
        for joint in (*chain, toe):
            place = place + quat_rotate(turn, offsets[:, None, joint])
            turn = quat_multiply(turn, rotations[..., joint, :])
            if joint in (ankle, toe):
                feet.append(place)
    return torch.stack(feet, dim=-2)


def fk_loss(
    prediction: Prediction,
    batch: Batch,
    space: FeatureSpace,
    slip_weight: float = 1.0,
    step_weight: float | Tensor = 0.0,
) -> Tensor:
    """Feet by forward kinematics near the true ones, and still on the ground while in contact (L_FK).

    Paper eq. 8 compares the feet of two frames in the root's space, where a standing foot moves as the
    body passes over it; here the step the root takes between the frames is taken out first. What a touching foot
    slips counts slip_weight times; it teaches feet to stand still, not contacts to be denied.

    Both of the paper's terms look at predictions alone, but a roll-out goes from the frame it was given to the
    one predicted from it. step_weight times, a number or one for each frame (B, T), counts how far that movement of a
    foot over the ground is off the true one, the more the lower the foot is.
    """
    features, truth = space.denormalize(prediction.mean), space.denormalize(batch.targets)
    predicted = foot_positions(features, batch.offsets, space)
    with torch.no_grad():
        true = foot_positions(truth, batch.offsets, space)
    loss = _mean(safe_norm((predicted - true) / FOOT_UNIT).sum(-1), batch.mask)
    heights = space.root_height(features)
    if slip_weight:
        before = (predicted[:, :-1], heights[:, :-1])
        slip = _foot_moves(features[:, 1:], predicted[:, 1:], *before, space).abs().sum(-1) / FOOT_UNIT
        touching = torch.sigmoid(prediction.contact_logits.detach())
        both = touching[:, 1:] * touching[:, :-1]
        loss = loss + slip_weight * _mean((both * slip).sum(-1), batch.mask[:, 1:])
    if isinstance(step_weight, Tensor) or step_weight:
        with torch.no_grad():
            given = space.denormalize(batch.inputs[:, 1:])
            start = (foot_positions(given, batch.offsets, space), space.root_height(given))
            height = space.root_height(truth)
            wanted = _foot_moves(truth[:, 1:], true[:, 1:], true[:, :-1], height[:, :-1], space)
            low = (1.0 - (true[:, 1:, :, 1] + height[:, 1:, None]) / NEAR_GROUND).clamp(0.0, 1.0)
        moves = _foot_moves(features[:, 1:], predicted[:, 1:], *start, space)
        # Not upwards: a body that is too high or too low is to come back.
        off = (moves - wanted)[..., [0, 2]].abs().sum(-1) / FOOT_UNIT
        weights = step_weight[:, 1:] if isinstance(step_weight, Tensor) else step_weight
        loss = loss + _mean(weights * (low * off).sum(-1), batch.mask[:, 1:])
    return loss


def _foot_moves(
    features: Tensor, feet: Tensor, before: Tensor, height_before: Tensor, space: FeatureSpace
) -> Tensor:
    """How far (B, T, 4, 3) feet move in the world from a frame to the next, in the heading frame of the later one.

    Args:
        features: (B, T, 276) unnormalised, of the later frames.
        feet, before: (B, T, 4, 3) relative to the root, of the later frames and of the earlier ones.
        height_before: (B, T) of the root in the earlier ones.
    """
    blocks = feature_layout(space.layout).blocks
    turn = features[..., blocks["root_yaw_velocity"]] / space.fps
    step = features[..., blocks["root_xz_velocity"]] / space.fps
    lift = (space.root_height(features) - height_before)[..., None]
    step = torch.stack([step[..., 0], lift[..., 0], step[..., 1]], dim=-1)
    return feet + step[:, :, None] - quat_rotate(quat_from_yaw(-turn), before)


def consistency_loss(
    network: PartTransformer, modules: ConsistencyModules, prediction: Prediction, batch: Batch
) -> Tensor:
    """Shared channels alike between parts, and decodable to the shared data (L_con = L_feat + 2 L_root)."""
    channels = network.config.shared_channels
    alike = feature_difference(prediction.shallow, channels) + feature_difference(prediction.deep, channels)
    truth = shared_data(network, batch.inputs)
    root = torch.zeros((), device=truth.device)
    for decoded in modules(prediction.shallow, prediction.deep):
        for part in decoded:
            root = root + _mean(safe_norm(part.float() - truth), batch.mask)
    return alike + 2.0 * root


def training_losses(
    network: PartTransformer,
    modules: ConsistencyModules | None,
    prediction: Prediction,
    batch: Batch,
    space: FeatureSpace,
    options: LossOptions | None = None,
    step_share: Tensor | None = None,
) -> dict[str, Tensor]:
    """All six terms by name, unweighted.

    Args:
        step_share: (C,) what each control counts in how much of step_weight a frame gets; all of it by default.
    """
    options = options or LossOptions()
    rules = (options.outlier, options.beta_nll)
    step_weight = (
        options.step_weight if step_share is None else options.step_weight * (batch.controls @ step_share)
    )
    feet = (options.slip_weight, step_weight)
    zero = torch.zeros((), device=prediction.mean.device)
    consistency = zero if modules is None else consistency_loss(network, modules, prediction, batch)
    return {
        "gauss": gaussian_loss(prediction.mean, prediction.log_sigma, batch.targets, batch.mask, *rules),
        "smooth": smoothness_loss(prediction.mean, batch.mask),
        "contact": contact_loss(prediction.contact_logits, batch.next_contacts, batch.mask),
        "fk": fk_loss(prediction, batch, space, *feet),
        "consistency": consistency,
        "trajectory": gaussian_loss(
            prediction.trajectory_mean,
            prediction.trajectory_log_sigma,
            batch.trajectory,
            batch.mask,
            options.outlier,
        ),
    }


def total_loss(terms: dict[str, Tensor], weights: dict[str, float] | None = None) -> Tensor:
    """The weighted sum (paper eq. 4)."""
    weights = WEIGHTS if weights is None else weights
    return torch.stack([weights[name] * value for name, value in terms.items()]).sum()
