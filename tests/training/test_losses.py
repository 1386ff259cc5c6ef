from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from motionkit.data.dataset import Dataset
from motionkit.features.decode import decode_rotations
from motionkit.features.layout import feature_layout
from motionkit.models.network import PartTransformer, Prediction
from motionkit.models.presets import preset
from motionkit.motion.kinematics import forward_kinematics
from motionkit.motion.rotations import quat_from_yaw, quat_to_sixd
from motionkit.motion.skeleton import FOOT_JOINTS, PARENTS, canonical_skeleton
from motionkit.training import losses
from motionkit.training.losses import Batch, ConsistencyModules, FeatureSpace
from motionkit.training.sampler import WindowSampler
from motionkit.training.windows import SamplerOptions

ONES = torch.ones(1, 4)
OFFSETS = torch.from_numpy(canonical_skeleton().offsets)
REFERENCES = torch.eye(3)[:, :, None].expand(3, 3, 23)
PLAIN = FeatureSpace(torch.zeros(276), torch.ones(276), REFERENCES, "sixd-root-1", 60.0)


def prediction(mean: Tensor, logits: Tensor | None = None) -> Prediction:
    B, T = mean.shape[:2]
    zeros = torch.zeros(B, T, 24)
    logits = torch.zeros(B, T, 4) if logits is None else logits
    return Prediction(
        mean, torch.zeros_like(mean), logits, zeros, zeros, torch.zeros(2, B, T, 8), torch.zeros(2, B, T, 8)
    )


def batch(targets: Tensor) -> Batch:
    B, T = targets.shape[:2]
    return Batch(
        targets, targets, torch.ones(B, T, 4), torch.ones(B, T, 4), torch.zeros(B, T, 97),
        torch.zeros(B, T, 24), OFFSETS.expand(B, -1, -1), torch.ones(B, T),
    )  # fmt: skip


def standing(frames: int, height: float = 95.0) -> Tensor:
    """Return features (1, T, 276) of a body that stands still in its rest pose."""
    features = torch.zeros(1, frames, 276)
    blocks = feature_layout().blocks
    features[..., blocks["root_rotation"]] = torch.tensor([1.0, 0, 0, 0, 1, 0])
    features[..., blocks["joint_positions"].start] = height
    return features


def sixd_of_yaw(yaw: Tensor) -> Tensor:
    """Return root rotations (..., 6) about Y."""
    return torch.from_numpy(quat_to_sixd(quat_from_yaw(yaw.numpy())))


def fk(predicted: Prediction, data: Batch) -> float:
    return float(losses.fk_loss(predicted, data, PLAIN))


# ---- each loss by hand ----


def test_gaussian_loss_by_hand() -> None:
    mean = torch.tensor([[[1.0, 0.0], [0.0, 0.0]]])
    log_sigma = torch.tensor([[[0.0, math.log(2.0)], [0.0, 0.0]]])
    target = torch.tensor([[[3.0, 4.0], [0.0, 1.0]]])
    half_log = 0.5 * math.log(2 * math.pi)
    first = (0.5 * 4.0 + half_log) + (0.5 * 4.0 + math.log(2.0) + half_log)
    second = half_log + (0.5 + half_log)
    value = losses.gaussian_loss(mean, log_sigma, target, torch.ones(1, 2))
    assert float(value) == pytest.approx((first + second) / 2, abs=1e-5)


def test_gaussian_loss_is_the_log_density() -> None:
    draw = torch.Generator().manual_seed(0)
    mean, log_sigma, target = (torch.randn(2, 5, 7, generator=draw) for _ in range(3))
    density = torch.distributions.Normal(mean, log_sigma.exp()).log_prob(target)
    value = losses.gaussian_loss(mean, log_sigma, target, torch.ones(2, 5))
    assert float(value) == pytest.approx(float(-density.sum(-1).mean()), rel=1e-5)


def test_beta_nll_weights_uncertain_features() -> None:
    """The gradient on the mean is error / sigma^2 for beta 0, error / sigma for 0.5, and the error for 1."""
    target = torch.zeros(1, 1, 2)
    log_sigma = torch.log(torch.tensor([[[0.1, 0.5]]]))
    steep = []
    for beta_nll in (0.0, 0.5, 1.0):
        mean = torch.full((1, 1, 2), 0.2, requires_grad=True)
        losses.gaussian_loss(mean, log_sigma, target, torch.ones(1, 1), beta_nll=beta_nll).backward()
        assert mean.grad is not None
        steep.append(mean.grad[0, 0] / mean.grad[0, 0, 0])
    assert [float(s[1]) for s in steep] == pytest.approx([0.04, 0.2, 1.0], rel=1e-4)


def test_smoothness_loss_by_hand() -> None:
    mean = torch.tensor([[[0.0, 0.0], [1.0, 0.0], [2.0, 4.0], [3.0, 8.0]]])
    value = losses.smoothness_loss(mean, ONES)
    assert float(value) == pytest.approx((4.0 + 0.0) / 2, abs=1e-3)
    straight = torch.arange(6.0).reshape(1, 6, 1).expand(1, 6, 3)
    assert float(losses.smoothness_loss(straight, torch.ones(1, 6))) < 2e-4
    assert float(losses.smoothness_loss(mean[:, :2], ONES[:, :2])) == 0.0
    for frame in range(3):
        mask = torch.ones(1, 4)
        mask[0, frame] = 0.0  # one of the frames of the first difference, the only one that is not 0
        assert float(losses.smoothness_loss(mean, mask)) == pytest.approx(0.0, abs=1e-3)


def test_contact_loss_by_hand() -> None:
    logits = torch.tensor([[[0.0, 2.0, -2.0, 0.0]]])
    target = torch.tensor([[[1.0, 1.0, 1.0, 0.0]]])
    expected = 2 * math.log(2) + math.log(1 + math.exp(-2)) + math.log(1 + math.exp(2))
    value = losses.contact_loss(logits, target, torch.ones(1, 1))
    assert float(value) == pytest.approx(expected, abs=1e-5)


def test_the_mean_over_windows_does_not_depend_on_how_a_batch_is_split() -> None:
    values = torch.arange(12.0).reshape(4, 3)
    mask = torch.tensor([[1.0, 1.0, 1.0], [1.5, 1.5, 0.0], [3.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    whole = losses._mean(values, mask)
    by_hand = (1.0 + (3.0 + 4.0) / 2 + 6.0 + 10.0) / 4
    assert float(whole) == pytest.approx(by_hand), "a short window weighs as much as a full one"
    halves = (losses._mean(values[:2], mask[:2]) + losses._mean(values[2:], mask[2:])) / 2
    assert float(halves) == pytest.approx(float(whole))


def test_fk_loss_is_zero_for_the_truth_with_standing_feet() -> None:
    truth = standing(5)
    touching = torch.full((1, 5, 4), 50.0)
    assert fk(prediction(truth, touching), batch(truth)) < 1e-3


def test_fk_loss_counts_the_distance_of_feet() -> None:
    truth = standing(5)
    wrong = truth.clone()
    # Thighs 0.2 rad forward about X: both feet off by the chord over the length of the leg.
    blocks = feature_layout().blocks
    start = blocks["joint_rotations"].start
    wrong[..., [start, start + 12]] = 0.2
    offsets = OFFSETS
    expected = 0.0
    for ankle, toe in (FOOT_JOINTS[:2], FOOT_JOINTS[2:]):
        leg = offsets[PARENTS[ankle]] + offsets[ankle]
        for bone in (leg, leg + offsets[toe]):
            expected += 2 * math.sin(0.1) * float(bone[[1, 2]].norm())
    released = torch.full((1, 5, 4), -50.0)
    assert fk(prediction(wrong, released), batch(truth)) == pytest.approx(
        expected / losses.FOOT_UNIT, rel=1e-3
    )


def test_fk_loss_counts_feet_that_slide_while_they_touch() -> None:
    sliding = standing(6)
    sliding[..., feature_layout().blocks["root_xz_velocity"]] = torch.tensor([0.0, 60.0])  # 1 cm a frame
    data = batch(sliding)
    touching, released = (torch.full((1, 6, 4), sign * 50.0) for sign in (1.0, -1.0))
    slip = 4 * 1.0 / losses.FOOT_UNIT
    assert fk(prediction(sliding, touching), data) == pytest.approx(slip, abs=1e-3)
    assert fk(prediction(sliding, released), data) < 1e-3


def test_slip_weight_scales_the_slip_and_gives_contacts_no_gradient() -> None:
    sliding = standing(6)
    sliding[..., feature_layout().blocks["root_xz_velocity"]] = torch.tensor([0.0, 60.0])
    data = batch(sliding)
    logits = torch.full((1, 6, 4), 2.0, requires_grad=True)
    once, often = (losses.fk_loss(prediction(sliding, logits), data, PLAIN, times) for times in (1.0, 10.0))
    near = losses.fk_loss(prediction(sliding, logits), data, PLAIN, 0.0)
    assert float(often - near) == pytest.approx(10.0 * float(once - near)) and float(once) > float(near)
    assert not often.requires_grad


def steps(predicted: Prediction, data: Batch) -> float:
    """Return the step loss: what a step_weight of 1 adds."""
    with_steps, without = (
        float(losses.fk_loss(predicted, data, PLAIN, 0.0, weight)) for weight in (1.0, 0.0)
    )
    return with_steps - without


def lowness(data: Batch) -> Tensor:
    """Return the weights of the four foot joints of a standing body in the step loss."""
    feet = losses.foot_positions(data.targets, data.offsets, PLAIN)
    return (1.0 - (feet[0, 0, :, 1] + 95.0) / losses.NEAR_GROUND).clamp(0.0, 1.0)


def test_step_loss_compares_steps_with_the_recording() -> None:
    walking = standing(6)
    walking[..., feature_layout().blocks["root_xz_velocity"]] = torch.tensor([0.0, 60.0])  # 1 cm a frame
    data = batch(walking)
    assert steps(prediction(walking), data) < 1e-4
    # A root that stays behind drags each foot by 1 cm against the recording; low feet have the most weight.
    low = lowness(data)
    assert 0.0 < float(low.min()) < float(low.max()) < 1.0
    expected = float(low.sum()) / losses.FOOT_UNIT
    assert steps(prediction(standing(6)), data) == pytest.approx(expected, rel=1e-3)


def test_step_weight_can_differ_between_frames() -> None:
    walking = standing(6)
    walking[..., feature_layout().blocks["root_xz_velocity"]] = torch.tensor([0.0, 60.0])
    data, stays = batch(walking), prediction(standing(6))
    weights = torch.tensor([[1.0, 1.0, 0.0, 0.5, 0.0, 0.0]])  # there is no step into the first frame
    args = (stays, data, PLAIN, 0.0)
    some = float(losses.fk_loss(*args, weights)) - float(losses.fk_loss(*args, 0.0))
    assert some == pytest.approx(1.5 / 5.0 * steps(stays, data), rel=1e-4)


def test_steps_start_at_the_input_frame_not_at_the_previous_prediction() -> None:
    truth = standing(6)
    turned = truth.clone()  # the hips were predicted with a turn, and stay turned
    turned[:, 3:, feature_layout().blocks["root_rotation"]] = sixd_of_yaw(torch.tensor(0.2))
    data = batch(truth)
    fed = Batch(**{**vars(data), "inputs": turned})
    # Frame t is predicted from input t: a body that keeps the feet of the input stands still.
    assert steps(prediction(turned), fed) < 1e-4
    feet = losses.foot_positions(turned, data.offsets, PLAIN)
    away = (feet[0, 3] - feet[0, 0])[:, [0, 2]].abs().sum(-1)
    once = float((away * lowness(data)).sum()) / losses.FOOT_UNIT / 5
    assert once > 0.01
    assert steps(prediction(truth), fed) == pytest.approx(3 * once, rel=1e-3)
    assert steps(prediction(turned), data) == pytest.approx(3 * once, rel=1e-3)


def test_a_return_to_the_right_height_is_no_step() -> None:
    truth = standing(6)
    raised = truth.clone()
    raised[:, 3:, feature_layout().blocks["joint_positions"].start] += 2.0
    fed = Batch(**{**vars(batch(truth)), "inputs": raised})
    assert steps(prediction(truth), fed) == pytest.approx(0.0, abs=1e-6)


def test_step_loss_removes_the_turn_of_the_heading() -> None:
    yaw = 0.8 * torch.arange(8) / 60.0
    features = standing(9)
    features[..., 0] = 0.8
    features[0, :8, feature_layout().blocks["root_rotation"]] = sixd_of_yaw(-yaw)
    features[0, 8, feature_layout().blocks["root_rotation"]] = sixd_of_yaw(torch.tensor(-0.8 * 8 / 60.0))
    inputs, targets = features[:, :-1], features[:, 1:]
    data = Batch(**{**vars(batch(targets)), "inputs": inputs})
    assert steps(prediction(targets), data) < 2e-3
    still = targets.clone()
    still[..., 0] = 0.0
    assert steps(prediction(still), data) > 10 * steps(prediction(targets), data)


def test_fk_loss_removes_the_turn_of_the_heading() -> None:
    """No foot slips if the body stands still in the world while its heading turns."""
    yaw = 0.8 * torch.arange(8) / 60.0
    features = standing(8)
    features[..., 0] = 0.8
    features[0, :, feature_layout().blocks["root_rotation"]] = sixd_of_yaw(-yaw)
    assert fk(prediction(features, torch.full((1, 8, 4), 50.0)), batch(features)) < 2e-3


def test_fk_loss_counts_feet_that_sink_with_the_root() -> None:
    features = standing(8)
    height = feature_layout().blocks["joint_positions"].start
    features[0, :, height] = 95.0 - 0.5 * torch.arange(8)
    touching, released = (torch.full((1, 8, 4), sign * 50.0) for sign in (1.0, -1.0))
    slip = 4 * 0.5 / losses.FOOT_UNIT
    assert fk(prediction(features, touching), batch(features)) == pytest.approx(slip, abs=2e-3)
    assert fk(prediction(features, released), batch(features)) < 1e-3


def test_foot_positions_are_those_of_forward_kinematics(dataset: Dataset) -> None:
    clip = dataset.clips[0]
    data = dataset.read(clip, 0, 20)
    rotations = decode_rotations(data.features, dataset.reference_rotations)
    offsets = dataset.skeleton(clip).offsets
    _, positions = forward_kinematics(rotations, np.zeros((20, 3), np.float32), offsets, PARENTS)
    shown = (torch.from_numpy(values[None]) for values in (data.features, offsets))
    feet = losses.foot_positions(*shown, FeatureSpace.of(dataset))
    np.testing.assert_allclose(feet[0].numpy(), positions[:, list(FOOT_JOINTS)], atol=1e-3)


# ---- all terms together ----


@pytest.fixture
def real(dataset: Dataset) -> tuple[PartTransformer, ConsistencyModules, Batch]:
    sampler = WindowSampler(dataset, SamplerOptions(window=24, splices=0), 0)
    torch.manual_seed(0)
    network = PartTransformer(preset("tiny"), sampler.controls.size)
    return network, ConsistencyModules(network), sampler.batch(0, 3)


def terms_of(dataset: Dataset, network, modules, data: Batch) -> dict[str, Tensor]:
    out = network(data.inputs, data.contacts, data.controls)
    return losses.training_losses(network, modules, out, data, FeatureSpace.of(dataset))


def test_all_six_terms_are_finite_with_finite_gradients(dataset: Dataset, real) -> None:
    network, modules, data = real
    terms = terms_of(dataset, network, modules, data)
    assert list(terms) == ["gauss", "smooth", "contact", "fk", "consistency", "trajectory"]
    assert all(bool(torch.isfinite(v)) and v.dim() == 0 for v in terms.values())
    for name, value in terms.items():
        network.zero_grad()
        modules.zero_grad()
        value.backward(retain_graph=True)
        grads = [p.grad for p in network.parameters() if p.grad is not None]
        assert grads and all(bool(torch.isfinite(g).all()) for g in grads), name
        assert any(bool((g != 0).any()) for g in grads), name


def test_total_is_the_weighted_sum_of_the_paper() -> None:
    terms = {name: torch.tensor(float(i + 1)) for i, name in enumerate(losses.WEIGHTS)}
    assert losses.WEIGHTS == {
        "gauss": 1.0, "smooth": 10.0, "contact": 5.0, "fk": 5.0, "consistency": 1.0, "trajectory": 1.0
    }  # fmt: skip
    assert float(losses.total_loss(terms)) == pytest.approx(1 + 20 + 15 + 20 + 5 + 6)
    assert float(losses.total_loss(terms, {**losses.WEIGHTS, "smooth": 0.0})) == pytest.approx(47.0)


def test_without_consistency_modules_the_term_is_zero(dataset: Dataset, real) -> None:
    network, _, data = real
    assert float(terms_of(dataset, network, None, data)["consistency"]) == 0.0


def test_frames_beyond_the_end_of_a_window_do_not_count(dataset: Dataset, real) -> None:
    """The padding does not change the losses."""
    network, _, data = real
    network.eval()
    ended = Batch(**{**vars(data), "mask": torch.cat([torch.full((3, 16), 1.5), torch.zeros(3, 8)], dim=1)})
    noisy = {}
    for name in ("inputs", "targets", "contacts", "next_contacts", "controls", "trajectory"):
        value = getattr(ended, name).clone()
        value[:, 16:] = 0.5
        noisy[name] = value
    changed = Batch(**{**vars(ended), **noisy})
    a, b = terms_of(dataset, network, None, ended), terms_of(dataset, network, None, changed)
    for name in a:
        assert a[name].item() == pytest.approx(b[name].item(), rel=1e-5), name
