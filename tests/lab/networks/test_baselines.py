"""The networks of other papers: their maths on small cases, their sizes, and that they train and roll out."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from motionkit.control.script import parse_types
from motionkit.control.synthesize import SynthesisOptions, synthesize
from motionkit.data.dataset import Dataset
from motionkit.errors import ModelError
from motionkit.features.control import ControlLayout
from motionkit.lab.networks.baseline import Experts
from motionkit.lab.networks.htss import TwoStream, TwoStreamConfig
from motionkit.lab.networks.learned_motion_matching import (
    SEARCHED,
    LearnedMotionMatching,
    LearnedMotionMatchingConfig,
)
from motionkit.lab.networks.mvae import MotionVae, MotionVaeConfig, teacher_share
from motionkit.lab.networks.pfnn import (
    PhaseFunctionedConfig,
    PhaseFunctionedNetwork,
    gait_phase,
    spline_shares,
)
from motionkit.models.architectures import build, config_from_dict
from motionkit.models.batch import Batch, FeatureSpace
from motionkit.models.checkpoint import load_model
from motionkit.models.network import parameter_count
from motionkit.models.presets import preset
from motionkit.training.presets import train_options
from motionkit.training.sampler import WindowSampler
from motionkit.training.trainer import TrainingRun
from motionkit.training.windows import SamplerOptions

NAMES = ("pfnn", "mvae", "htss", "neural-layering", "learned-motion-matching")
SMALL = {
    "pfnn": {"hidden": 24},
    "mvae": {"hidden": 24, "gate": 8, "latent": 4, "experts": 3},
    "htss": {"part": 4, "limb": 8, "body": 16, "decoder": 8},
    "neural-layering": {"hidden": 24, "gate": 8, "experts": 3},
    "learned-motion-matching": {"hidden": 24, "latent": 6},
}


@pytest.mark.parametrize("name", NAMES)
def test_baselines_train_and_roll_out(name: str, paper_folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "m.safetensors"
    options = train_options(
        name,
        steps=20,
        batch=4,
        window=24,
        rate=2e-3,
        precision="float32",
        score_seconds=0.0,
        config=SMALL[name],
    )
    run = TrainingRun(Dataset(paper_folder), path, options, None, "cpu", None)
    kept = run.sampler.batch(10**6, 8)

    def loss() -> float:
        network = run.learner.network.eval()
        terms = network.losses(kept, run.learner.module.space, 0.0)
        network.train()
        return sum(float(terms[name].detach()) for name in ("mse", "pose") if name in terms)

    before = loss()
    run.go()
    assert loss() < 0.98 * before
    model = load_model(path)
    assert model.config.to_dict()["architecture"] == name
    made = synthesize(model, parse_types(f"{model.type_names[0]}:0.3"), SynthesisOptions(ik=False)).motion
    assert np.isfinite(made.root_positions).all() and np.ptp(made.local_rotations, axis=0).max() > 1e-4


@pytest.mark.parametrize("name", NAMES)
def test_frames_beyond_the_end_of_a_clip_do_not_count(name: str, paper_folder: Path) -> None:
    dataset = Dataset(paper_folder)
    options = SamplerOptions(window=64, splices=0)
    sampler = WindowSampler(dataset, options, controls="paper")
    batch = sampler.batch(0, 4)
    torch.manual_seed(0)
    network = build(preset(name, **SMALL[name]), sampler.controls.size).eval()
    losses = []
    for noise in (0.0, 3.0):
        mask = batch.mask.clone()
        mask[:, 40:] = 0.0
        changed = {"mask": mask}
        for field in ("inputs", "targets", "controls"):
            value = getattr(batch, field).clone()
            # What is seen of the first padded frame is the target of the last one that counts.
            value[:, 41 if field != "targets" else 40 :] += noise
            changed[field] = value
        torch.manual_seed(1)
        found = network.losses(Batch(**(vars(batch) | changed)), FeatureSpace.of(dataset), 0.5)
        losses.append({key: float(value.detach()) for key, value in found.items()})
    assert losses[1] == pytest.approx(losses[0], rel=1e-4, abs=1e-6)


# In millions, for the paper's 21 types. Of NeuralLayering the number of experts is unknown, of PFNN the input differs.
@pytest.mark.parametrize(("name", "paper", "share"), [("mvae", 2.03, 0.05), ("htss", 4.7, 0.1)])
def test_parameters_are_near_those_of_the_paper(name: str, paper: float, share: float) -> None:
    size = ControlLayout(tuple(f"type-{i}" for i in range(21)), "paper").size
    assert parameter_count(build(preset(name), size)) / 1e6 == pytest.approx(paper, rel=share)


def test_configs_are_checked() -> None:
    for name in NAMES:
        config = preset(name)
        assert config_from_dict(config.to_dict()) == config
    for change in ({"hidden": 0}, {"hidden": "many"}, {"layout": "other"}, {"dropout": 2.0}):
        with pytest.raises(ModelError):
            PhaseFunctionedConfig.from_dict(change)
    with pytest.raises(ModelError, match="unknown settings 'warp'"):
        MotionVaeConfig.from_dict({"warp": 1})


def test_experts_are_blended_by_their_shares() -> None:
    torch.manual_seed(0)
    experts = Experts(3, 5, 2)
    x = torch.randn(4, 5)
    each = torch.stack([x @ experts.weight[k] + experts.bias[k] for k in range(3)])
    shares = torch.tensor([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.5, 0.5], [0.2, 0.3, 0.5]])
    wanted = (shares.T[..., None] * each).sum(0)
    assert torch.allclose(experts(x, shares), wanted, atol=1e-6)


# ---- PFNN ----


def test_the_spline_goes_through_its_control_points() -> None:
    at = torch.arange(4) * (math.pi / 2)
    assert torch.allclose(spline_shares(at), torch.eye(4), atol=1e-6)
    everywhere = spline_shares(torch.linspace(-9.0, 9.0, 200))
    assert torch.allclose(everywhere.sum(1), torch.ones(200), atol=1e-5)
    # Catmull-Rom halfway between two points: -1/16, 9/16, 9/16, -1/16.
    half = spline_shares(torch.tensor([math.pi / 4]))[0]
    assert half.tolist() == pytest.approx([9 / 16, 9 / 16, -1 / 16, -1 / 16])


def test_the_spline_is_smooth_around_the_cycle() -> None:
    near = spline_shares(torch.tensor([2 * math.pi - 1e-3, 1e-3]))
    assert torch.allclose(near[0], near[1], atol=1e-2)


def test_the_phase_is_that_of_footsteps() -> None:
    contacts = np.zeros((60, 4), np.float32)
    for start, side in ((10, 0), (25, 2), (40, 0)):
        contacts[start : start + 12, side : side + 2] = 1.0
    phase = gait_phase(contacts)
    assert phase[[10, 25, 40]] == pytest.approx([0.0, math.pi, 2 * math.pi])
    assert (np.diff(phase) > 0).all()
    assert phase[17] == pytest.approx(math.pi * 7 / 15)
    assert (gait_phase(np.ones((20, 4), np.float32)) == 0.0).all()  # nobody steps


def test_the_phase_goes_on_by_the_networks_steps() -> None:
    network = PhaseFunctionedNetwork(PhaseFunctionedConfig(hidden=8), 5).eval()
    stream = network.stream(1)
    stream.reset(warmup=2)
    contacts = torch.zeros(1, 4)
    frames = [torch.full((1, 276), 0.1 * i) for i in range(6)]
    with torch.no_grad():
        for x in frames[:3]:
            stream.step(x, contacts, torch.zeros(1, 5))
        before = stream.phase.clone()
        _, turn = network.run(frames[3], torch.zeros(1, 5), before)
        stream.step(frames[3], torch.ones(1, 4), torch.zeros(1, 5))
    assert torch.allclose(stream.phase, before + 2 * math.pi / 60 * turn.clamp(min=0.0))


# ---- MVAE ----


def test_scheduled_sampling_is_20_20_100() -> None:
    assert [teacher_share(x / 140) for x in (0, 20, 30, 40, 140)] == pytest.approx([1.0, 1.0, 0.5, 0.0, 0.0])


def test_latent_numbers_spread_around_the_encoders_mean() -> None:
    torch.manual_seed(0)
    network = MotionVae(MotionVaeConfig(**SMALL["mvae"]), 5).eval()
    x, contacts, controls = torch.randn(1, 276), torch.zeros(1, 4), torch.zeros(1, 5)
    with torch.no_grad():
        plain, zero = (
            network.next(x, contacts, controls, None),
            network.next(x, contacts, controls, torch.zeros(1, 4)),
        )
        drawn = network.next(x, contacts, controls, torch.ones(1, 4))
    assert torch.equal(plain.mean, zero.mean) and not torch.equal(plain.mean, drawn.mean)


# ---- HTSS ----


@pytest.fixture
def two_stream(paper_folder: Path) -> tuple[TwoStream, Batch, FeatureSpace]:
    dataset = Dataset(paper_folder)
    sampler = WindowSampler(dataset, SamplerOptions(window=24, splices=0), 0, (), "paper")
    torch.manual_seed(0)
    network = TwoStream(TwoStreamConfig(**SMALL["htss"]), sampler.controls.size)
    return network, sampler.batch(0, 3), FeatureSpace.of(dataset)


def test_all_columns_belong_to_one_part(two_stream) -> None:
    columns = sorted(c for part in two_stream[0].columns.values() for c in part)
    assert columns == list(range(276))


def test_each_side_of_the_gan_trains_its_own_network(two_stream) -> None:
    network, batch, space = two_stream
    terms = network.losses(batch, space, 0.5)

    def moved(term: str) -> tuple[bool, bool]:
        network.zero_grad()
        terms[term].backward(retain_graph=True)
        grads = {
            n: p.grad is not None and bool(p.grad.abs().sum() > 0) for n, p in network.named_parameters()
        }
        inside = [moves for name, moves in grads.items() if name.startswith("discriminator")]
        outside = [moves for name, moves in grads.items() if not name.startswith("discriminator")]
        return any(inside), any(outside)

    assert moved("gan") == (False, True)
    assert moved("discriminator") == (True, False)


@pytest.mark.parametrize("name", ("htss", "neural-layering"))
def test_a_stream_predicts_what_the_window_does(name: str, paper_folder: Path) -> None:
    dataset = Dataset(paper_folder)
    sampler = WindowSampler(dataset, SamplerOptions(window=24, splices=0), 0, (), "paper")
    batch = sampler.batch(0, 2)
    torch.manual_seed(1)
    network = build(type(preset(name))(**SMALL[name]), sampler.controls.size).eval()
    stream = network.stream(2)
    with torch.no_grad():
        frames = [
            stream.step(batch.inputs[:, t], batch.contacts[:, t], batch.controls[:, t]) for t in range(24)
        ]
        if name == "htss":
            whole = network.run(batch.inputs, batch.controls, None)[0].mean
        else:
            rows = torch.cat([batch.controls, batch.contacts], dim=-1)
            series = torch.cat(
                [rows[:, (torch.arange(24) - back).clamp(min=0)] for back in range(0, 61, 10)], dim=-1
            )
            whole = network.run(batch.inputs, series).mean
    assert torch.allclose(torch.stack([f.mean for f in frames], 1), whole, atol=1e-4)


# ---- learned motion matching ----


def matching_network() -> LearnedMotionMatching:
    torch.manual_seed(0)
    return LearnedMotionMatching(LearnedMotionMatchingConfig(hidden=16, latent=4), 30).eval()


def test_matching_features_are_feet_and_hips_and_controls() -> None:
    network = matching_network()
    assert network.matching_size == 4 * 3 + 4 * 3 + 3 + 30  # feet, their velocities, the hips', controls
    x, controls = torch.randn(2, 276), torch.randn(2, 30)
    features = network.matching(x, controls)
    assert features.shape == (2, network.matching_size) and torch.equal(features[:, -30:], controls)


def test_frames_count_only_where_a_search_is_due() -> None:
    network, contacts = matching_network(), torch.zeros(1, 4)
    draw = torch.Generator().manual_seed(1)
    frames = torch.randn(SEARCHED + 6, 1, 276, generator=draw)
    others = frames.clone()
    others[3 : SEARCHED + 1] += 1.0  # between the searches at frames 1 and 1 + SEARCHED
    later = frames.clone()
    later[SEARCHED + 1] += 1.0

    def roll(rows: torch.Tensor) -> torch.Tensor:
        stream = network.stream(1)
        stream.reset(warmup=2)  # frames 0 and 1
        with torch.no_grad():
            return torch.stack([stream.step(x, contacts, torch.zeros(1, 30)).mean for x in rows])

    made = roll(frames)
    assert torch.equal(roll(others), made)
    changed = (roll(later) != made).flatten(1).any(dim=1)
    assert changed.nonzero()[0].item() == SEARCHED + 1


def test_the_stepper_is_trained_on_its_own_steps() -> None:
    network = matching_network()
    state = torch.randn(3, 2 * SEARCHED + 5, network.matching_size + 4)
    with torch.no_grad():
        for values in network.stepper[-1].parameters():
            values.zero_()
        standing = network._stepper_loss(state, torch.ones(state.shape[:2]))
    runs = state[:, : 2 * SEARCHED].reshape(6, SEARCHED, -1)
    assert torch.allclose(standing, (runs[:, :1] - runs[:, 1:]).abs().mean(), atol=1e-5)


def test_the_projector_learns_the_nearest_of_the_batch() -> None:
    network = matching_network()
    state = 10.0 * torch.randn(40, network.matching_size + 4)  # so far apart that noise changes no neighbour
    found: list[torch.Tensor] = []

    class Oracle(torch.nn.Module):
        def forward(self, queries: torch.Tensor) -> torch.Tensor:
            found.append(queries)
            nearest = torch.cdist(queries, state[:, : network.matching_size]).argmin(dim=1)
            assert torch.equal(nearest, torch.arange(40))
            return state[nearest]

    network.projector = Oracle()  # type: ignore[assignment]
    assert float(network._projector_loss(state, torch.ones(len(state)))) == 0.0
    assert (found[0] - state[:, : network.matching_size]).abs().max() > 0.5
