from __future__ import annotations

import pytest
import torch

from motionkit.errors import ModelError
from motionkit.features.control import CONTROL_KINDS, ControlLayout
from motionkit.features.layout import feature_layout
from motionkit.models.config import ModelConfig
from motionkit.models.layers import sinusoidal_positions, spatial_dropout
from motionkit.models.network import PartTransformer, parameter_count, part_columns
from motionkit.models.parts import PARTITIONS, partition
from motionkit.models.presets import PRESETS, preset
from motionkit.motion.skeleton import JOINT_NAMES
from motionkit.training.losses import ConsistencyModules, feature_difference, safe_norm, shared_data


def reach(network, inputs, frame: int) -> torch.Tensor:
    """How much each input frame moves the prediction at one frame: (T,) gradient norms."""
    x, contacts, controls = (value.clone().requires_grad_() for value in inputs)
    out = network(x, contacts, controls)
    total = out.mean[:, frame].sum() + out.log_sigma[:, frame].sum() + out.contact_logits[:, frame].sum()
    total = total + out.trajectory_mean[:, frame].sum()
    grads = torch.autograd.grad(total, (x, contacts, controls))
    return torch.stack([g.abs().sum(dim=(0, 2)) for g in grads]).sum(dim=0)


def test_receptive_field_is_exactly_87_frames(make_network, make_inputs) -> None:
    config = preset("tptn")
    assert config.receptive_field == 87
    # At full size the first of the 87 frames is felt through 12 softmaxes: small, but in float64 there.
    network = make_network(config.changed(log_sigma_min=-99.0, log_sigma_max=99.0)).double()
    felt = reach(network, [v.double() for v in make_inputs(1, 120)], 110)
    first = 110 - 87 + 1
    assert (felt[:first] == 0).all() and (felt[111:] == 0).all()
    assert (felt[first:111] > 0).all()


@pytest.mark.parametrize("name", ["tptn-paper", "ebtn", "5ptn", "tiny"])
def test_receptive_field_is_what_the_config_says(make_network, make_inputs, name: str) -> None:
    config = preset(name, log_sigma_min=-99.0, log_sigma_max=99.0)
    network = make_network(config).double()
    last = config.receptive_field + 15
    felt = reach(network, [v.double() for v in make_inputs(1, last + 4)], last)
    assert torch.nonzero(felt).flatten().tolist() == list(range(last - config.receptive_field + 1, last + 1))


@pytest.mark.parametrize("name", PRESETS)
def test_the_past_does_not_feel_the_future(make_network, make_inputs, name: str) -> None:
    network = make_network(preset(name))
    inputs = make_inputs(2, 50)
    other = make_inputs(2, 50, seed=9)
    changed = [torch.cat([a[:, :30], b[:, 30:]], dim=1) for a, b in zip(inputs, other, strict=True)]
    with torch.no_grad():
        before, after = network(*inputs), network(*changed)
    for field in ("mean", "log_sigma", "trajectory_mean", "trajectory_log_sigma", "contact_logits"):
        assert torch.equal(getattr(before, field)[:, :30], getattr(after, field)[:, :30]), field
    assert (before.mean[:, 30:] - after.mean[:, 30:]).abs().amax() > 0.01


def test_parameter_count_of_tptn_is_near_the_papers(make_network) -> None:
    assert 3.4e6 < parameter_count(make_network(preset("tptn"))) < 3.8e6


@pytest.mark.parametrize("name", ["tptn-paper", "ebtn", "fptn-r", "fptn-s", "5ptn"])
def test_the_ablations_are_of_about_the_same_size(make_network, name: str) -> None:
    assert 3.2e6 < parameter_count(make_network(preset(name))) < 4.0e6


@pytest.mark.parametrize("name", PRESETS)
def test_shapes(make_network, make_inputs, name: str) -> None:
    config = preset(name)
    network = make_network(config)
    with torch.no_grad():
        out = network(*make_inputs(3, 21))
    parts = len(partition(config.variant.partition).parts)
    assert out.mean.shape == out.log_sigma.shape == (3, 21, 276)
    assert out.trajectory_mean.shape == out.trajectory_log_sigma.shape == (3, 21, 24)
    assert out.contact_logits.shape == (3, 21, 4)
    assert out.shallow.shape == out.deep.shape == (parts, 3, 21, config.width)
    assert (
        out.log_sigma.min() >= config.head.log_sigma_min and out.log_sigma.max() <= config.head.log_sigma_max
    )


@pytest.mark.parametrize("frames", [1, 2, 15, 16, 17, 33])
def test_any_length(make_network, make_inputs, frames: int) -> None:
    """Padding to whole blocks does not show: a longer run begins with the shorter one."""
    network = make_network(preset("tiny"))
    inputs = make_inputs(2, 40)
    with torch.no_grad():
        whole, part = network(*inputs), network(*(v[:, :frames] for v in inputs))
    assert torch.allclose(whole.mean[:, :frames], part.mean, atol=1e-5)


def test_characters_of_a_batch_do_not_meet(make_network, make_inputs) -> None:
    network = make_network(preset("tiny"))
    inputs = make_inputs(3, 20)
    with torch.no_grad():
        together, alone = network(*inputs), network(*(v[1:2] for v in inputs))
    assert torch.allclose(together.mean[1:2], alone.mean, atol=1e-5)


def own_columns(config: ModelConfig, part: int) -> list[int]:
    """Columns of the 276 that only one part takes in."""
    layout, body = feature_layout(config.layout), partition(config.variant.partition)
    return [c for j in body.parts[part].joints if j not in body.shared for c in layout.joint_columns(j)]


@pytest.mark.parametrize("fusion", ["none", "linear"])
@pytest.mark.parametrize("name", ["two", "five"])
def test_parts_meet_in_the_fusion_only(make_network, make_inputs, name: str, fusion: str) -> None:
    config = preset("tiny", partition=name, fusion=fusion)
    network = make_network(config)
    x, contacts, controls = make_inputs(1, 20)
    other = x.clone()
    other[..., own_columns(config, 1)] += 1.0
    with torch.no_grad():
        before, after = network(x, contacts, controls), network(other, contacts, controls)
    shallow = (before.shallow - after.shallow).abs().amax(dim=(1, 2, 3))
    deep = (before.deep - after.deep).abs().amax(dim=(1, 2, 3))
    assert [bool(v > 0) for v in shallow] == [p == 1 for p in range(len(shallow))]
    if fusion == "none":
        assert [bool(v > 0) for v in deep] == [p == 1 for p in range(len(deep))]
    else:
        assert (deep > 0).all()


def test_contacts_reach_the_parts_with_feet_only(make_network, make_inputs) -> None:
    network = make_network(preset("tiny"))
    x, contacts, controls = make_inputs(1, 12)
    with torch.no_grad():
        before, after = network(x, contacts, controls), network(x, 1 - contacts, controls)
    moved = (before.shallow - after.shallow).abs().amax(dim=(1, 2, 3))
    names = [part.name for part in network.body.parts]
    assert float(moved[names.index("upper")]) == 0.0 and float(moved[names.index("lower")]) > 0.0


@pytest.mark.parametrize("name", ["tptn", "fptn-s", "5ptn", "tiny"])
def test_shared_channels_take_in_the_shared_joints_alone(make_network, make_inputs, name: str) -> None:
    config = preset(name)
    network = make_network(config)
    x, contacts, _ = make_inputs(1, 6)
    layout, body = feature_layout(config.layout), partition(config.variant.partition)
    shared = [c for joint in body.shared for c in layout.joint_columns(joint)]
    others = [c for c in range(276) if c not in shared]
    module = network.shallow

    def embed(features: torch.Tensor, touching: torch.Tensor) -> torch.Tensor:
        inputs = network.split_parts(features, touching)
        return module.embed_motion(torch.cat([inputs] * module.kernel, dim=-1))

    changed = x.clone()
    changed[..., others] += 1.0
    before, after = embed(x, contacts), embed(changed, 1 - contacts)
    S = config.embedding.shared_channels
    assert torch.equal(before[..., :S], after[..., :S])
    assert (before[..., S:] - after[..., S:]).abs().amax(dim=(1, 2)).min() > 0
    changed = x.clone()
    changed[..., shared] += 1.0
    assert (embed(changed, contacts) - before)[..., :S].abs().amax() > 0.1


@pytest.mark.parametrize("name", PARTITIONS)
def test_partitions_hold_every_joint_and_every_contact(name: str) -> None:
    body = PARTITIONS[name]
    assert {j for part in body.parts for j in part.joints} == set(range(len(JOINT_NAMES)))
    assert sorted(c for part in body.parts for c in part.contacts) == [0, 1, 2, 3]
    for part in body.parts:
        assert set(body.shared) <= set(part.joints)
        assert len(set(part.joints)) == len(part.joints)


@pytest.mark.parametrize("name", PARTITIONS)
def test_part_columns_begin_with_the_shared_joints(name: str) -> None:
    config = ModelConfig().changed(partition=name)
    gather, shared = part_columns(config)
    body = partition(name)
    common = 12 * len(body.shared)
    assert (gather[:, :common] == gather[:1, :common]).all()
    assert shared[:, :common].all() and not shared[:, common:].any()
    for row, part in zip(gather.tolist(), body.parts, strict=True):
        real = [c for c in row if c < 280]
        assert len(real) == 12 * len(part.joints) + len(part.contacts)


def test_lower_and_upper_part_take_in_what_the_paper_says() -> None:
    gather, _ = part_columns(ModelConfig())
    sizes = {
        p.name: sum(c < 280 for c in row)
        for p, row in zip(partition("two").parts, gather.tolist(), strict=True)
    }
    assert sizes == {"upper": 12 + 14 * 12, "lower": 12 + 8 * 12 + 4}


def test_leaky_head_adds_a_share_of_the_input(make_network, make_inputs) -> None:
    inputs = make_inputs(1, 8)
    leaky = make_network(preset("tiny"))
    absolute = make_network(preset("tiny", head_leak=0.0))
    absolute.load_state_dict(leaky.state_dict())
    with torch.no_grad():
        difference = leaky(*inputs).mean - absolute(*inputs).mean
    assert torch.allclose(difference, leaky.config.head.head_leak * inputs[0], atol=1e-5)


@pytest.mark.parametrize("kind", CONTROL_KINDS)
@pytest.mark.parametrize("given", [True, False])
def test_the_trajectory_skip_adds_the_trajectory_that_is_given(kind: str, given: bool) -> None:
    layout = ControlLayout(("walking", "running", "idle"), kind)
    torch.manual_seed(0)
    skips = PartTransformer(preset("tiny", controls=kind, trajectory_skip=True), layout.size).eval()
    plain = PartTransformer(preset("tiny", controls=kind), layout.size).eval()
    plain.load_state_dict(skips.state_dict())
    x, contacts, controls = torch.randn(1, 8, 276), torch.zeros(1, 8, 4), torch.randn(1, 8, layout.size)
    if not given:  # as control_vector shows it
        controls[..., layout.trajectory] = 0.0
    with torch.no_grad():
        made, other = skips(x, contacts, controls), plain(x, contacts, controls)
    torch.testing.assert_close(made.trajectory_mean - other.trajectory_mean, controls[..., layout.trajectory])
    assert torch.equal(made.mean, other.mean)
    assert torch.equal(made.trajectory_log_sigma, other.trajectory_log_sigma)


def test_momentum_adds_a_share_of_the_last_step(make_network, make_inputs) -> None:
    inputs = make_inputs(1, 8)
    network = make_network(preset("tiny"))
    assert network.momentum is not None
    with torch.no_grad():
        before = network(*inputs).mean
        network.momentum.add_(0.5)
        difference = network(*inputs).mean - before
    steps = torch.diff(inputs[0], dim=1, prepend=inputs[0][:, :1])
    assert torch.allclose(difference, 0.5 * steps, atol=1e-5)


def test_momentum_begins_apart_in_velocities(make_network) -> None:
    columns = feature_layout("expmap-root-1").columns
    network = make_network(preset("tiny", layout="expmap-root-1", velocity_momentum=-0.25))
    wanted = [-0.25 if "velocit" in column.block else 0.8 for column in columns]
    assert network.momentum.tolist() == pytest.approx(wanted) and {-0.25, 0.8} == set(wanted)


def test_layer_controls_can_be_left_out(make_network) -> None:
    without = make_network(preset("tiny", layer_controls=False))
    assert not any(".control." in name for name in without.state_dict())
    assert any(".control." in name for name in make_network(preset("tiny")).state_dict())


def test_dropout_is_for_training_only(make_network, make_inputs) -> None:
    network = make_network(preset("tiny"))
    inputs = make_inputs(1, 10)
    with torch.no_grad():
        assert torch.equal(network(*inputs).mean, network(*inputs).mean)
        network.train()
        assert not torch.equal(network(*inputs).mean, network(*inputs).mean)


def test_spatial_dropout_drops_channels_over_all_frames() -> None:
    torch.manual_seed(0)
    x = torch.ones(2, 3, 40, 50)
    out = spatial_dropout(x, 0.3, True)
    assert torch.equal(out, out[:, :, :1].expand_as(out))
    dropped = (out[:, :, 0] == 0).float().mean()
    assert 0.2 < float(dropped) < 0.4
    assert torch.allclose(out[out > 0], torch.tensor(1 / 0.7))
    assert torch.equal(spatial_dropout(x, 0.3, False), x)


def test_sinusoidal_positions_by_the_formula() -> None:
    table = sinusoidal_positions(9, 8, torch.device("cpu"))
    assert float(table[5, 4]) == pytest.approx(float(torch.sin(torch.tensor(5 / 10000 ** (4 / 8)))), abs=1e-6)
    assert float(table[5, 5]) == pytest.approx(float(torch.cos(torch.tensor(5 / 10000 ** (4 / 8)))), abs=1e-6)


# ---- consistency modules ----


def test_consistency_modules_decode_the_shared_data(make_network, make_inputs) -> None:
    network = make_network(preset("fptn-s"))
    modules = ConsistencyModules(network)
    inputs = make_inputs(2, 5)
    with torch.no_grad():
        out = network(*inputs)
        shallow, deep = modules(out.shallow, out.deep)
    truth = shared_data(network, inputs[0])
    assert shallow.shape == deep.shape == (4, *truth.shape)
    columns = [c for j in network.body.shared for c in feature_layout().joint_columns(j)]
    assert torch.equal(truth, inputs[0][..., columns])


def test_consistency_modules_are_no_part_of_the_network(make_network) -> None:
    network = make_network(preset("tiny"))
    before = set(network.state_dict())
    ConsistencyModules(network)
    assert set(network.state_dict()) == before
    assert not any("consist" in name for name in before)


def test_feature_difference_by_hand() -> None:
    features = torch.zeros(3, 1, 1, 5)
    features[1, ..., 0] = 3.0
    features[2, ..., 1] = 4.0
    features[..., 4] = torch.tensor([0.0, 50.0, 90.0]).reshape(3, 1, 1)  # not a shared channel
    whole = torch.ones(1, 1)
    assert float(feature_difference(features, 4, whole)) == pytest.approx((3.0 + 4.0 + 5.0) / 3, abs=1e-3)
    assert float(feature_difference(features[:1], 4, whole)) == 0.0, "one part has nobody to differ from"
    padded = torch.cat([features, 9.0 * features], dim=2)
    one = torch.tensor([[2.0, 0.0]])  # a window of two frames that ends after the first
    assert float(feature_difference(padded, 4, one)) == pytest.approx((3.0 + 4.0 + 5.0) / 3, abs=1e-3)


def test_safe_norm_has_a_gradient_at_zero() -> None:
    x = torch.zeros(3, requires_grad=True)
    safe_norm(x).backward()
    assert torch.isfinite(x.grad).all()


# ---- configuration ----


@pytest.mark.parametrize("name", PRESETS)
def test_config_survives_a_dictionary(name: str) -> None:
    config = preset(name)
    assert ModelConfig.from_dict(config.to_dict()) == config


def test_paper_preset_is_the_papers() -> None:
    config = preset("tptn-paper")
    assert (
        config.head.head_leak,
        config.variant.position,
        config.variant.norm,
        config.dropout.input_dropout,
    ) == (
        0.0,
        "sinusoidal",
        "post",
        0.5,
    )
    assert (config.layers, config.window, config.kernel) == (6, 8, 3)
    assert config.layout == "expmap-root-1"


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"width": 100}, "multiple of heads"),
        ({"shared_channels": 96}, "exceed control and shared channels"),
        ({"position": "rotary"}, "position is 'rotary', expected one of bias, sinusoidal"),
        ({"norm": "none"}, "norm is 'none'"),
        ({"fusion": "cross"}, "fusion is 'cross'"),
    ],
)
def test_impossible_configs(change: dict, complaint: str) -> None:
    with pytest.raises(ModelError, match=complaint):
        ModelConfig().changed(**change)


def test_config_of_another_release() -> None:
    with pytest.raises(ModelError, match="unknown settings flux, warp"):
        ModelConfig.from_dict({**ModelConfig().to_dict(), "warp": 1, "flux": 2})


def test_unknown_names() -> None:
    with pytest.raises(ModelError, match="preset 'huge' is unknown, expected one of tptn"):
        preset("huge")
    with pytest.raises(ModelError, match="body partition 'nine' is unknown"):
        partition("nine")
