"""The paper's own way: its control signals, its trajectory fed back, no corrections, its characters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import torch

from motionkit.control.follow import follow_path
from motionkit.control.path import shape_path
from motionkit.control.script import parse_types
from motionkit.control.synthesize import SynthesisOptions, synthesize
from motionkit.data.dataset import Dataset
from motionkit.errors import ModelError
from motionkit.features.control import (
    TRAJECTORY_OFFSETS,
    ControlLayout,
    Controls,
    skeleton_signal,
    types_ahead,
)
from motionkit.features.encode import identity_reference_rotations
from motionkit.inference.noise import Noise, default_noise
from motionkit.inference.rollout import RolloutState
from motionkit.inference.start import on_body, type_start
from motionkit.inference.stepping import TorchStep
from motionkit.models.checkpoint import load_model
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import SamplingPreset
from motionkit.motion.skeleton import JOINT_NAMES, canonical_skeleton, leg_length
from motionkit.training.presets import train_options
from motionkit.training.sampler import LEAST_CUT, WindowSampler
from motionkit.training.trainer import train
from motionkit.training.windows import ControlSampling, SamplerOptions
from planned import controls_of

SMALL = {"width": 48, "heads": 4, "ffn": 96, "layers": 2, "control_width": 16, "control_embedding": 24}


@pytest.fixture(scope="module")
def run(paper_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[MotionModel, list[str]]:
    path = tmp_path_factory.mktemp("paper-model") / "paper.safetensors"
    notes: list[str] = []
    options = train_options(
        "tptn-paper",
        steps=6,
        batch=4,
        window=24,
        precision="float32",
        score_seconds=0.0,
        config={**SMALL, "shared_channels": 12},
    )
    train(paper_folder, path, options, device="cpu", on_event=lambda e: notes.append(e.text))
    return load_model(path), notes


@pytest.fixture
def paper_model(run: tuple[MotionModel, list[str]]) -> MotionModel:
    return run[0]


def test_features_have_plain_exponential_maps(paper_folder: Path, dataset_folder: Path) -> None:
    assert np.array_equal(Dataset(paper_folder).reference_rotations, identity_reference_rotations())
    assert not np.allclose(Dataset(dataset_folder).reference_rotations, identity_reference_rotations())


def test_the_control_vector_has_the_four_signals_of_the_paper() -> None:
    layout = ControlLayout(("a", "b", "c"), "paper")
    assert (layout.skeleton, layout.type, layout.trajectory) == (slice(0, 69), slice(69, 87), slice(87, 111))
    assert layout.size == 69 + 6 * 3 + 24


def test_types_are_given_at_six_frames_of_the_coming_second() -> None:
    weights = np.eye(2, dtype=np.float32)[np.repeat([0, 1], [30, 50])]
    ahead = types_ahead(weights)
    assert ahead.shape == (80, len(TRAJECTORY_OFFSETS), 2)
    assert ahead[0, :, 1].tolist() == [0, 0, 1, 1, 1, 1] and ahead[15, :, 1].tolist() == [0, 1, 1, 1, 1, 1]
    assert ahead[79, :, 1].tolist() == [1] * 6
    assert Controls.of_types(weights).ahead[3].tolist() == [[1, 0]] * 6


def test_training_windows_hold_them(paper_folder: Path) -> None:
    dataset = Dataset(paper_folder)
    sampler = WindowSampler(
        dataset,
        SamplerOptions(window=24, interval=4.0, noise=0.0, controls=ControlSampling(lead_share=0.0)),
        0,
        (),
        "paper",
    )
    batch = sampler.batch(0, 4)
    types = batch.controls[..., sampler.controls.type].reshape(4, 24, 6, len(dataset.types))
    kept = batch.mask > 0
    assert torch.allclose(types.sum(-1)[kept], torch.ones(()))
    # 10 frames on, the first of the frames ahead is what the second was.
    assert torch.allclose(types[:, 10:, 0][kept[:, 10:]], types[:, :-10, 1][kept[:, 10:]], atol=1e-6)


def test_windows_are_cut_more_often_where_a_type_has_few_frames(paper_folder: Path) -> None:
    dataset = Dataset(paper_folder)

    def cuts_per_frame(balance: float) -> dict[int, float]:
        options = SamplerOptions(window=24, interval=4.0, balance=balance)
        sampler = WindowSampler(dataset, options, 0, (), "paper")
        tracks = [dataset.clip_types(clip) for clip in sampler.clips]
        kinds = [int(tracks[number][start]) for number, start in sampler.cuts]
        usable = np.concatenate([t[: len(t) - min(24, LEAST_CUT)] for t in tracks])
        return {k: kinds.count(k) / int((usable == k).sum()) for k in set(kinds)}

    plain, balanced = cuts_per_frame(0.0), cuts_per_frame(1.0)
    assert all(rate == pytest.approx(0.25, rel=0.2) for rate in plain.values())
    frames = np.bincount(np.concatenate([dataset.clip_types(c) for c in dataset.select("train")]))
    rarest, commonest = min(balanced, key=lambda k: frames[k]), max(balanced, key=lambda k: frames[k])
    assert balanced[rarest] / balanced[commonest] == pytest.approx(
        frames[commonest] / frames[rarest], rel=0.3
    )


def test_the_log_says_how_the_run_compares_with_the_papers(run: tuple[MotionModel, list[str]]) -> None:
    line = next(text for text in run[1] if "epochs" in text)
    assert "6 steps of 4 x 24 frames" in line and "rate 0.0001, halved every 2 steps" in line


def test_a_budget_sets_steps_batch_window_and_rate() -> None:
    cpu = train_options("tptn-paper", budget="cpu", batch=None)
    assert (cpu.steps, cpu.optimizer.batch, cpu.sampler.window, cpu.optimizer.rate) == (1500, 8, 160, 1e-3)
    assert (cpu.optimizer.method, cpu.optimizer.warmup, cpu.config) == ("muon", 50, {"trajectory_skip": True})
    own = train_options("tptn-paper", steps=5, budget="cpu", window=40, method="adamw", warmup=0)
    assert (own.steps, own.optimizer.batch, own.sampler.window) == (5, 8, 40)
    assert (own.optimizer.method, own.optimizer.warmup) == ("adamw", 0)
    paper = train_options("tptn-paper", budget="paper")
    assert paper == train_options("tptn-paper", steps=paper.steps)
    with pytest.raises(ModelError, match="budgets are for presets"):
        train_options("tptn", budget="cpu")


def test_the_rate_is_halved_at_every_quarter(paper_folder: Path, tmp_path: Path) -> None:
    rates: list[float] = []
    options = train_options(
        "tptn-paper",
        steps=8,
        batch=2,
        window=16,
        score_seconds=0.0,
        log_every=1,
        config={**SMALL, "shared_channels": 12},
    )
    train(paper_folder, tmp_path / "m.safetensors", options, device="cpu")
    import json

    log = (tmp_path / "m.run" / "log.jsonl").read_text().splitlines()
    rates = [json.loads(line)["rate"] for line in log if json.loads(line)["kind"] == "log"]
    assert [round(1e-4 / rate) for rate in rates] == [1, 2, 2, 4, 4, 8, 8, 8]


def test_nothing_surrounds_the_network(paper_model: MotionModel) -> None:
    assert paper_model.plain and not paper_model.uses_references
    assert all(
        kind.preset == SamplingPreset() and not kind.reference_clips for kind in paper_model.types.values()
    )
    assert default_noise(paper_model) == Noise("sample", 1.0)


def started(model: MotionModel, noise: Noise | None = None) -> RolloutState:
    kind = model.type_names[0]
    start = type_start(model, kind)
    state = RolloutState(model, 1, noise or Noise("mean"), 0)
    weights = np.zeros((1, len(model.types)), np.float32)
    weights[0, 0] = 1.0
    state.start(start.features, start.contacts, weights)
    return state


def test_the_predicted_trajectory_is_fed_back(paper_model: MotionModel) -> None:
    state = started(paper_model)
    weights = np.eye(len(paper_model.types), dtype=np.float32)[:1]
    columns = paper_model.controls.trajectory
    for _ in range(3):
        own = paper_model.trajectory_scaling.denormalize(state.network.trajectory)
        state.step(Controls.of_types(weights))
        assert np.allclose(
            state.controls.vectors[:, columns], paper_model.trajectory_scaling.normalize(own), atol=1e-5
        )
    assert np.abs(state.controls.vectors[:, columns]).max() > 0.0


def test_a_trajectory_that_is_given_comes_first(paper_model: MotionModel) -> None:
    state = started(paper_model)
    weights = np.eye(len(paper_model.types), dtype=np.float32)[:1]
    wanted = np.full((1, 24), 7.0, np.float32)
    state.step(replace(Controls.of_types(weights), trajectory=wanted).with_mask(1.0))
    shown = state.controls.vectors[:, paper_model.controls.trajectory]
    assert np.allclose(shown, paper_model.trajectory_scaling.normalize(wanted), atol=1e-5)


def test_initial_frames_are_shown_the_way_they_went(paper_model: MotionModel) -> None:
    """The controls of initial frames are computed from their motion (paper section 5.2)."""
    state = started(paper_model)
    start = paper_model.types[paper_model.type_names[0]].start_poses[0]
    ways = state.controls.recorded_trajectories(start.features[None])[0]
    from motionkit.features.control import future_trajectory

    frames = np.arange(len(start.features) - 10)  # whose first sample ahead is still recorded
    truth = future_trajectory(start.ground, frames)
    assert np.allclose(ways[frames][:, :2], truth[:, :2], atol=0.2)


def test_frames_are_drawn_at_full_sigma(paper_model: MotionModel) -> None:
    mean, drawn = started(paper_model), started(paper_model, Noise("sample", 1.0))
    weights = np.eye(len(paper_model.types), dtype=np.float32)[:1]
    mean.step(Controls.of_types(weights))
    drawn.step(Controls.of_types(weights))
    sigma = np.exp(np.asarray(mean.network.log_sigma))
    deviations = (drawn.frame.x - mean.frame.x) / sigma
    assert 0.8 < float(deviations.std()) < 1.2


def test_a_character_changes_what_the_network_is_shown(paper_model: MotionModel) -> None:
    tall = canonical_skeleton().offsets * np.float32(1.2)
    model = replace(paper_model, characters=paper_model.characters | {"tall": tall})
    kind = parse_types(f"{model.type_names[0]}:0.3")
    made = {
        name: synthesize(model, kind, SynthesisOptions(character=name, noise=Noise("mean"), ik=False)).motion
        for name in ("default", "tall")
    }
    assert np.allclose(made["tall"].skeleton.offsets, tall)
    assert np.abs(made["tall"].local_rotations - made["default"].local_rotations).max() > 1e-4


def test_five_performers_give_the_network_five_inputs(
    paper_model: MotionModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    bones = canonical_skeleton().offsets
    arms, legs = (
        [j for j, name in enumerate(JOINT_NAMES) if any(word in name for word in words)]
        for words in (("Arm", "Hand"), ("Leg", "Foot"))
    )
    bodies = {"default": bones, "tall": 1.15 * bones, "small": 0.85 * bones}
    for name, joints in (("long arms", arms), ("long legs", legs)):
        bodies[name] = bones * np.where(np.isin(np.arange(len(bones)), joints), 1.2, 1.0)[:, None]
    model = replace(paper_model, characters={k: v.astype(np.float32) for k, v in bodies.items()})
    seen: list[np.ndarray] = []
    step = TorchStep.step

    def watched(self: TorchStep, x: np.ndarray, contacts: np.ndarray, controls: np.ndarray) -> None:
        seen.append(controls.copy())
        step(self, x, contacts, controls)

    monkeypatch.setattr(TorchStep, "step", watched)
    kind = parse_types(f"{model.type_names[0]}:0.2")
    shown, made = [], []
    for name in bodies:
        seen.clear()
        options = SynthesisOptions(character=name, noise=Noise("mean"), ik=False)
        made.append(synthesize(model, kind, options).motion.local_rotations)
        skeletons = np.stack(seen)[:, 0, model.controls.skeleton]
        np.testing.assert_array_equal(skeletons, np.broadcast_to(skeletons[0], skeletons.shape))
        np.testing.assert_allclose(
            skeletons[0], skeleton_signal(model.character(name)), rtol=1e-6, err_msg=name
        )
        shown.append(skeletons[0])
    for one, two in combinations(range(len(bodies)), 2):
        assert np.abs(shown[one] - shown[two]).max() > 0.01
        assert np.abs(made[one] - made[two]).max() > 1e-4


def test_start_frames_take_the_bones_of_the_character(paper_model: MotionModel) -> None:
    start = type_start(paper_model, paper_model.type_names[0])
    tall = canonical_skeleton(canonical_skeleton().offsets * np.float32(1.3))
    small = canonical_skeleton()
    one, two = (on_body(paper_model, start, body).features[0] for body in (small, tall))
    height = 6 + 66 + 66 + 1  # of the root
    assert np.allclose(two[:, height] / one[:, height], leg_length(tall) / leg_length(small), rtol=1e-3)


def test_a_path_can_be_followed(paper_model: MotionModel) -> None:
    path = shape_path("line", 0.5, [paper_model.type_names[0]], 1.0)
    made = follow_path(paper_model, path, SynthesisOptions(noise=Noise("mean")))
    assert np.isfinite(made.motion.root_positions).all()


def test_plans_name_the_types_ahead(paper_model: MotionModel) -> None:
    names = paper_model.type_names
    parts = parse_types(f"{names[0]}:1,{names[1]}:1")
    asked = controls_of(paper_model, parts, np.zeros((2, 24), np.float32))
    assert asked.types_ahead is not None and asked.types_ahead.shape == (120, 6, len(names))
    assert asked.types_ahead[35, -1, 1] > 0.9 and asked.type_weights[35, 0] > 0.9


def test_a_model_with_other_controls_is_no_start(paper_model: MotionModel, dataset: Dataset) -> None:
    from motionkit.models.architectures import build
    from motionkit.models.presets import preset
    from motionkit.training.initial_network import warm_start

    network = build(preset("tiny"), ControlLayout(dataset.types).size)
    with pytest.raises(ModelError, match="other control signals"):
        warm_start(network, dataset, paper_model)
    assert dataset.scaling is not paper_model.scaling, "nothing has been changed"


def test_eq_8_as_it_is_written(paper_folder: Path, make_loss: Callable[..., float]) -> None:
    """The feet of one frame, by forward kinematics, against the foot positions in the mean of the next."""
    assert make_loss(touching=True) > 0.0
    assert make_loss(touching=False) == pytest.approx(0.0, abs=1e-6)


@pytest.fixture
def make_loss(paper_folder: Path) -> Callable[..., float]:
    from motionkit.models.batch import FeatureSpace
    from motionkit.models.network import Prediction
    from motionkit.training.losses import foot_positions, paper_foot_slip

    dataset = Dataset(paper_folder)
    batch = WindowSampler(dataset, SamplerOptions(window=24, interval=4.0, noise=0.0), 0, (), "paper").batch(
        0, 2
    )
    space = FeatureSpace.of(dataset)
    features = space.denormalize(batch.targets)
    feet = foot_positions(features, batch.offsets, space)

    def loss(touching: bool) -> float:
        logits = torch.full((2, 24, 4), 30.0 if touching else -30.0)
        none = torch.zeros(1)
        prediction = Prediction(batch.targets, none, logits, none, none, none, none)
        return float(paper_foot_slip(prediction, feet, features, batch, space))

    return loss
