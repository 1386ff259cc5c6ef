"""The six losses of the paper (section 4.2). Each is a function and is logged by its name.

All norms are over normalised features, except in the FK loss: its foot positions are in units of 20 cm, about
their standard deviation. mask is (B, T): 0 after the end of a window, and otherwise scaled so that every window has
the same weight. Means divide by B T, so averaging over equal parts of a batch gives the mean over the batch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from motionkit.features.layout import feature_layout
from motionkit.models.batch import Batch, FeatureSpace
from motionkit.models.layers import FeedForward
from motionkit.models.network import PartTransformer, Prediction
from motionkit.models.torch_rotations import (
    expmap_to_matrix,
    multiply,
    rotate,
    sixd_to_matrix,
    yaw_to_matrix,
)
from motionkit.motion.skeleton import FOOT_JOINTS

FOOT_UNIT = 20.0  # cm
NEAR_GROUND = 15.0  # cm; the weight of a foot joint in the step loss falls to 0 at this height
TYPICAL_SIGMA = 0.1  # standard deviation that a trained network typically predicts
WEIGHTS = {"gauss": 1.0, "smooth": 10.0, "contact": 5.0, "fk": 5.0, "consistency": 1.0, "trajectory": 1.0}


@dataclass(frozen=True)
class LossOptions:
    """How the losses are computed and weighted; the defaults are the paper's."""

    outlier: float = math.inf  # number of standard deviations beyond which gaussian_loss is linear
    beta_nll: float = 0.0  # beta of gaussian_loss; 0 is the plain likelihood
    slip_weight: float = 1.0  # weight of foot slip in fk_loss
    step_weight: float = 0.0  # weight of the step loss in fk_loss; docs/results-log.md tries 50
    step_except: tuple[str, ...] = ()  # types whose step_weight is 0
    likelihood: str = "gauss"  # or "l2", the paper's ablation "L2 loss": squared errors, sigma untrained
    # Foot slip: "ground" measures it over the ground, "paper" as eq. 8 is written (fk_loss, paper_foot_slip).
    foot_term: str = "ground"
    weights: dict[str, float] = field(default_factory=lambda: dict(WEIGHTS))  # weights of the six losses


class ConsistencyModules(nn.Module):
    """A two-layer network per part and level, from the shared channels to the data of the shared joints."""

    def __init__(self, network: PartTransformer) -> None:
        super().__init__()
        config = network.config
        self.parts = len(network.body.parts)
        self.channels = config.embedding.shared_channels
        self.outputs = 12 * len(network.body.shared)
        sizes = (self.parts, self.channels, config.head.consistency_hidden, self.outputs)
        self.shallow, self.deep = FeedForward(*sizes), FeedForward(*sizes)

    def forward(self, shallow: Tensor, deep: Tensor) -> tuple[Tensor, Tensor]:
        """Decode features (P, B, T, D) of both levels to data (P, B, T, 12 S)."""
        return self.shallow(shallow[..., : self.channels].float()), self.deep(
            deep[..., : self.channels].float()
        )


def shared_data(network: PartTransformer, x_BTF: Tensor) -> Tensor:
    """Return the shared joints' columns (B, T, 12 S) of features, in the order of the parts' inputs."""
    columns = network.part_columns[0, : 12 * len(network.body.shared)]
    return x_BTF[..., columns]


def feature_difference(features: Tensor, channels: int, mask: Tensor) -> Tensor:
    """Return the mean distance between the shared channels of pairs of parts (paper L_feat), a scalar.

    features are (P, B, T, D).
    """
    shared = features[..., :channels].float()
    pairs = [(p, q) for p in range(len(shared)) for q in range(p)]
    if not pairs:
        return torch.zeros((), device=features.device)
    return torch.stack([_mean(safe_norm(shared[p] - shared[q]), mask) for p, q in pairs]).mean()


def safe_norm(x: Tensor) -> Tensor:
    """Return the Euclidean norm over the last dimension, with a finite gradient at zero."""
    return torch.sqrt(x.float().square().sum(-1) + 1e-8)


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
    """Return the negative log-likelihood per frame, summed over columns (L_G; also L_t over the trajectory).

    Values that are hard to predict get a large sigma, and the likelihood's gradient on their mean falls with its
    square. So easy frames are learned ever better and hard ones never. beta-NLL (Seitzer et al. 2022, "On the
    Pitfalls of Heteroscedastic Uncertainty Estimation") therefore weights each term by (sigma / TYPICAL_SIGMA) to
    the power 2 x beta_nll, without gradient. 0 is the plain likelihood; 1 gives all errors the same weight.

    Beyond `outlier` standard deviations the square continues as a straight line (Huber 1964). Exponential maps jump
    where a joint turns past half a turn, once in a few hundred frames. Squared, that frame would outweigh its batch.
    """
    scaled = ((target - mean) * torch.exp(-log_sigma)).abs()
    inner = scaled.clamp(max=outlier)
    penalty = inner * (scaled - 0.5 * inner)
    terms = penalty + log_sigma + 0.9189385
    if beta_nll:
        terms = terms * torch.exp(2.0 * beta_nll * (log_sigma.detach() - math.log(TYPICAL_SIGMA)))
    return _mean(terms.sum(-1), mask)


def squared_loss(mean: Tensor, target: Tensor, mask: Tensor) -> Tensor:
    """Return the squared error per frame, summed over columns (the paper's ablation "L2 loss")."""
    return _mean((target - mean).square().sum(-1), mask)


def smoothness_loss(mean: Tensor, mask: Tensor) -> Tensor:
    """Return the norm of the second difference of the predicted means (L_s), where all three frames count."""
    if mean.shape[1] < 3:
        return torch.zeros((), device=mean.device)
    count = mask[:, 2:] * (mask[:, :-2] > 0) * (mask[:, 1:-1] > 0)
    return _mean(safe_norm(mean[:, :-2] + mean[:, 2:] - 2.0 * mean[:, 1:-1]), count)


def contact_loss(logits: Tensor, target: Tensor, mask: Tensor) -> Tensor:
    """Return the binary cross-entropy of the contacts, summed over the four (L_f)."""
    return _mean(F.binary_cross_entropy_with_logits(logits, target, reduction="none").sum(-1), mask)


# Joints of the left leg from the hip to the toes, and as many of the right one.
LEG = FOOT_JOINTS[1]
LEGS = slice(1, 1 + 2 * LEG)


def foot_positions(features: Tensor, offsets: Tensor, space: FeatureSpace) -> Tensor:
    """Return feet (B, T, 4, 3) in cm under the root, in the heading frame, of unnormalised features and bones in cm."""
    columns = feature_layout(space.layout)
    root = features[..., columns.blocks["root_rotation"]]
    turn = sixd_to_matrix(root) if columns.root_is_sixd else expmap_to_matrix(root.movedim(-1, 0))
    first = columns.blocks["joint_rotations"].start
    expmaps = features[..., first : first + 6 * LEG].unflatten(-1, (2, LEG, 3))[..., :-1, :]
    references = space.reference_matrices[..., LEGS].unflatten(-1, (2, LEG))[..., :-1].mT[..., None, None]
    bends = multiply(references, expmap_to_matrix(expmaps.permute(4, 3, 2, 0, 1)))
    bones = offsets[:, LEGS].unflatten(1, (2, LEG)).permute(2, 3, 1, 0)[..., None]
    turn = turn[:, :, None]  # of both legs
    places = [rotate(turn, bones[0])]
    for bend, bone in zip(bends.unbind(2), bones[1:], strict=True):
        turn = multiply(turn, bend)
        places.append(places[-1] + rotate(turn, bone))
    return torch.stack(places[-2:], dim=2).flatten(1, 2).permute(2, 3, 1, 0)


def fk_loss(
    prediction: Prediction,
    batch: Batch,
    space: FeatureSpace,
    slip_weight: float = 1.0,
    step_weight: float | Tensor = 0.0,
    foot_term: str = "ground",
) -> Tensor:
    """Return the distance of the feet from the true ones by forward kinematics, plus their slip in contact (L_FK).

    Paper eq. 8 compares the feet of two frames in the root's space, where a planted foot moves as the body passes over
    it. Here slip is measured over the ground. Contacts weight it without gradient; otherwise the loss would fall by
    unlearning contacts.

    Both terms of the paper compare predictions only, but a roll-out steps from an input frame to the frame predicted
    from it. The step loss compares the movement of each foot in this step with the recorded movement, with more weight
    on lower feet.

    Args:
        step_weight: weight of the step loss, as one number or per frame (B, T).
        foot_term: "paper" for the slip of eq. 8 as it is written (paper_foot_slip).
    """
    features = space.denormalize(prediction.mean)
    predicted = foot_positions(features, batch.offsets, space)
    with torch.no_grad():  # of targets and inputs at once
        recorded = space.denormalize(torch.cat([batch.targets, batch.inputs]))
        true, start = foot_positions(recorded, batch.offsets.repeat(2, 1, 1), space).chunk(2)
    loss = _mean(safe_norm((predicted - true) / FOOT_UNIT).sum(-1), batch.mask)
    heights = space.root_height(features)
    if slip_weight and foot_term == "paper":
        loss = loss + slip_weight * paper_foot_slip(prediction, predicted, features, batch, space)
    elif slip_weight:
        before = (predicted[:, :-1], heights[:, :-1])
        slip = _foot_moves(features[:, 1:], predicted[:, 1:], *before, space).abs().sum(-1) / FOOT_UNIT
        touching = torch.sigmoid(prediction.contact_logits.detach())
        both = touching[:, 1:] * touching[:, :-1]
        loss = loss + slip_weight * _mean((both * slip).sum(-1), batch.mask[:, 1:])
    if isinstance(step_weight, Tensor) or step_weight:
        with torch.no_grad():
            truth, current = recorded.chunk(2)
            height = space.root_height(truth)
            true_moves = _foot_moves(truth[:, 1:], true[:, 1:], true[:, :-1], height[:, :-1], space)
            low = (1.0 - (true[:, 1:, :, 1] + height[:, 1:, None]) / NEAR_GROUND).clamp(0.0, 1.0)
        from_input = (start[:, 1:], space.root_height(current)[:, 1:])
        moves = _foot_moves(features[:, 1:], predicted[:, 1:], *from_input, space)
        # Vertical movement does not count: a body that is too high or too low must be free to come back.
        off = (moves - true_moves)[..., ::2].abs().sum(-1) / FOOT_UNIT
        weights = step_weight[:, 1:] if isinstance(step_weight, Tensor) else step_weight
        loss = loss + _mean(weights * (low * off).sum(-1), batch.mask[:, 1:])
    return loss


def paper_foot_slip(
    prediction: Prediction, feet: Tensor, features: Tensor, batch: Batch, space: FeatureSpace
) -> Tensor:
    """Return the foot slip, the second term of eq. 8, as the paper writes it.

    It compares the feet (B, T, 4, 3) of one frame by forward kinematics, in cm in the root's space, with the foot
    positions in the predicted unnormalised mean of the next frame. The predicted contacts of both frames weight it,
    with gradient.
    """
    # Slices, because a list of indices comes from the CPU, and a CUDA graph cannot wait for that.
    rows = feature_layout(space.layout).indices("joint_positions", FOOT_JOINTS)
    predicted_feet = torch.stack([features[:, 1:, first : last + 1] for first, _, last in rows], dim=-2)
    height = torch.zeros_like(feet[..., :1, :])
    height[..., 0, 1] = space.root_height(features)
    moved = (feet + height)[:, :-1] - predicted_feet
    touching = torch.sigmoid(prediction.contact_logits)
    both = touching[:, 1:] * touching[:, :-1]
    return _mean((both * moved.abs().sum(-1) / FOOT_UNIT).sum(-1), batch.mask[:, 1:])


def _foot_moves(
    features: Tensor, feet: Tensor, before: Tensor, height_before: Tensor, space: FeatureSpace
) -> Tensor:
    """Return the movement (B, T, 4, 3) in cm of the feet over the ground, in the later frame's heading frame.

    features are unnormalised ones of the later frames; feet, before and height_before are in cm.
    """
    blocks = feature_layout(space.layout).blocks
    turn = features[..., blocks["root_yaw_velocity"].start] / space.fps
    step = features[..., blocks["root_xz_velocity"]] / space.fps
    lift = (space.root_height(features) - height_before)[..., None]
    step = torch.stack([step[..., 0], lift[..., 0], step[..., 1]], dim=-1)
    seen = rotate(yaw_to_matrix(-turn)[:, :, None], before.permute(3, 2, 0, 1)).permute(2, 3, 1, 0)
    return feet + step[:, :, None] - seen


def consistency_loss(
    network: PartTransformer,
    modules: ConsistencyModules,
    prediction: Prediction,
    batch: Batch,
) -> Tensor:
    """Return how far shared channels differ between parts and from the recorded root (L_con = L_feat + 2 L_root).

    Recorded frames are the targets of the frames before, because inputs are noisy or predicted.
    """
    channels = network.config.embedding.shared_channels
    levels = (prediction.shallow, prediction.deep)
    alike = torch.stack([feature_difference(level, channels, batch.mask) for level in levels]).sum()
    truth = shared_data(network, torch.cat([batch.inputs[:, :1], batch.targets[:, :-1]], dim=1))
    root = torch.zeros((), device=truth.device)
    for decoded in modules(*levels):
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
    """Return all six losses by name, unweighted.

    step_share (C,) are weights whose product with a frame's controls is the factor on its step_weight; None for 1.
    """
    options = options or LossOptions()
    rules = (options.outlier, options.beta_nll)
    step_weight = (
        options.step_weight if step_share is None else options.step_weight * (batch.controls @ step_share)
    )
    feet = (options.slip_weight, step_weight, options.foot_term)
    zero = torch.zeros((), device=prediction.mean.device)
    consistency = zero if modules is None else consistency_loss(network, modules, prediction, batch)
    if options.likelihood == "l2":
        gauss = squared_loss(prediction.mean, batch.targets, batch.mask)
        trajectory = squared_loss(prediction.trajectory_mean, batch.trajectory, batch.mask)
    else:
        gauss = gaussian_loss(prediction.mean, prediction.log_sigma, batch.targets, batch.mask, *rules)
        trajectory = gaussian_loss(
            prediction.trajectory_mean,
            prediction.trajectory_log_sigma,
            batch.trajectory,
            batch.mask,
            options.outlier,
        )
    return {
        "gauss": gauss,
        "smooth": smoothness_loss(prediction.mean, batch.mask),
        "contact": contact_loss(prediction.contact_logits, batch.next_contacts, batch.mask),
        "fk": fk_loss(prediction, batch, space, *feet) if options.weights.get("fk", 1.0) else zero,
        "consistency": consistency,
        "trajectory": trajectory,
    }


def total_loss(terms: dict[str, Tensor], weights: dict[str, float] | None = None) -> Tensor:
    """Return the weighted sum of the losses (...) (paper eq. 4); a loss without a named weight has weight 1."""
    weights = WEIGHTS if weights is None else weights
    return torch.stack([weights.get(name, 1.0) * value for name, value in terms.items()]).sum(0)
