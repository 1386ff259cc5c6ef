from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from motionkit.arrays import Array
from motionkit.data.dataset import Clip, Dataset
from motionkit.data.splice import splice_clips
from motionkit.errors import DatasetError
from motionkit.features.control import ControlLayout
from motionkit.features.reference import BEFORE_EVENT, PAUSE
from motionkit.training.losses import LossOptions
from motionkit.training.objective import _step_share
from motionkit.training.presets import train_options
from motionkit.training.sampler import WindowSampler
from motionkit.training.splices import Span, from_event
from motionkit.training.windows import SamplerOptions, drifted

WINDOW = 40


def sampler(dataset: Dataset, seed: int = 0, **changes) -> WindowSampler:
    options = train_options("tiny", steps=1, **{"window": WINDOW, "splices": 0} | changes)
    made = WindowSampler(dataset, options.sampler, seed)
    made.make_splices()
    return made


def types_of(made: WindowSampler, batch) -> Array:
    """Return type weights (B, T, N) of a batch."""
    return batch.controls[..., made.controls.type]


def test_shapes(dataset: Dataset) -> None:
    batch = sampler(dataset).batch(0, 5)
    size = sampler(dataset).controls.size
    shapes = {name: tuple(value.shape) for name, value in vars(batch).items()}
    assert shapes == {
        "inputs": (5, WINDOW, 276),
        "targets": (5, WINDOW, 276),
        "contacts": (5, WINDOW, 4),
        "next_contacts": (5, WINDOW, 4),
        "controls": (5, WINDOW, size),
        "trajectory": (5, WINDOW, 24),
        "offsets": (5, 23, 3),
        "mask": (5, WINDOW),
    }


def test_targets_are_one_frame_ahead_of_inputs(dataset: Dataset) -> None:
    batch = sampler(dataset, noise=0.0).batch(0, 6)
    assert np.array_equal(batch.inputs[:, 1:], batch.targets[:, :-1])
    assert np.array_equal(batch.contacts[:, 1:], batch.next_contacts[:, :-1])


def test_noise_is_on_the_inputs_only(dataset: Dataset) -> None:
    clean, noisy = (sampler(dataset, noise=level).batch(3, 8) for level in (0.0, 0.05))
    assert np.array_equal(clean.targets, noisy.targets)
    assert float((noisy.inputs - clean.inputs).std()) == pytest.approx(0.05, rel=0.05)


def test_windows_depend_on_seed_step_and_place_alone(dataset: Dataset) -> None:
    one, two = sampler(dataset, splices=4), sampler(dataset, splices=4)
    one.batch(0, 4)  # earlier batches make no difference
    for name, value in vars(one.batch(7, 4)).items():
        assert np.array_equal(value, getattr(two.batch(7, 4), name)), name
    assert not np.array_equal(one.batch(7, 4).inputs, one.batch(8, 4).inputs)
    assert not np.array_equal(one.batch(7, 4).inputs, sampler(dataset, 1, splices=4).batch(7, 4).inputs)


def test_shares_of_a_batch_are_the_batch(dataset: Dataset) -> None:
    made = sampler(dataset, splices=3)
    whole = made.batch(2, 6)
    shares = [made.batch(2, 6, first, 3) for first in (0, 3)]
    for name, value in vars(whole).items():
        assert np.array_equal(value, np.concatenate([getattr(s, name) for s in shares])), name


def test_windows_of_one_batch_differ(dataset: Dataset) -> None:
    inputs = sampler(dataset).batch(0, 8).targets
    assert len({tuple(w[0, :5].tolist()) for w in inputs}) > 4


def test_balance_makes_types_equally_often(dataset: Dataset) -> None:
    made = sampler(dataset, balance=1.0, phase_weight=1.0)
    assert np.allclose(made.probabilities, np.full((6,), 1 / 6).astype(np.float64))
    recorded = sampler(dataset, balance=0.0, phase_weight=1.0).probabilities
    walking, cartwheel = (dataset.types.index(n) for n in ("walking", "cartwheel"))
    frames = {
        i: sum(int((dataset.clip_types(c) == i).sum()) for c in dataset.select("train"))
        for i in (walking, cartwheel)
    }
    ratio = float(recorded[walking] / recorded[cartwheel])
    assert ratio == pytest.approx(frames[walking] / frames[cartwheel])


def test_types_with_a_phase_are_sampled_more_often(dataset: Dataset) -> None:
    made = sampler(dataset, balance=1.0, phase_weight=3.0).probabilities
    assert "cartwheel" in dataset.phase_seconds and "walking" not in dataset.phase_seconds
    cartwheel, walking = (dataset.types.index(n) for n in ("cartwheel", "walking"))
    assert float(made[cartwheel] / made[walking]) == pytest.approx(3.0)


def test_type_weights_scale_how_often_types_are_sampled(dataset: Dataset) -> None:
    plain = sampler(dataset).probabilities
    made = sampler(dataset, type_weights={"walking": 4.0, "running": 0.0}).probabilities
    walking, running, others = (
        dataset.types.index("walking"),
        dataset.types.index("running"),
        [i for i, n in enumerate(dataset.types) if n not in ("walking", "running")],
    )
    assert float(made[running]) == 0.0 and float(made.sum()) == pytest.approx(1.0)
    for i in others:
        assert float(made[walking] / made[i]) == pytest.approx(4.0 * float(plain[walking] / plain[i]))
    with pytest.raises(DatasetError, match="--type-weights: unknown type 'flying', expected some of"):
        sampler(dataset, type_weights={"flying": 2.0})
    with pytest.raises(DatasetError, match="--type-weights: all types have weight 0"):
        sampler(dataset, type_weights=dict.fromkeys(dataset.types, 0.0))


@pytest.mark.parametrize(("name", "value"), [("type_weights", {"walking": 0.0}), ("splices", 20)])
def test_windows_cut_at_intervals_take_no_weights_of_types(
    dataset: Dataset, name: str, value: object
) -> None:
    with pytest.raises(DatasetError, match=f"--{name.replace('_', '-')} needs windows drawn by type"):
        sampler(dataset, interval=4.0, **{name: value})


def test_held_out_clips_are_never_sampled(dataset: Dataset) -> None:
    made = sampler(dataset)
    assert all(clip.split == "train" for clip in made.clips)
    held = next(c for c in dataset.clips if c.split == "test")
    assert held not in made.clips


def test_trajectory_dropout_and_its_flag(dataset: Dataset) -> None:
    always, never = sampler(dataset, trajectory_dropout=0.0), sampler(dataset, trajectory_dropout=1.0)
    flag, trajectory = always.controls.flag, always.controls.trajectory
    shown, hidden = always.batch(0, 8).controls, never.batch(0, 8).controls
    assert (shown[..., flag] == 1).all() and (shown[..., trajectory] != 0).any()
    assert (hidden[..., flag] == 0).all() and (hidden[..., trajectory] == 0).all()
    some = sampler(dataset, trajectory_dropout=0.5).batch(0, 40).controls[:, 0, flag].mean()
    assert 0.2 < float(some) < 0.8


def test_the_type_changes_before_the_motion_never_after(dataset: Dataset) -> None:
    prompt, early = (sampler(dataset, lead_share=share, splices=30) for share in (0.0, 1.0))
    compared = 0
    for step in range(24):
        a, b = types_of(prompt, prompt.batch(step, 8)), types_of(early, early.batch(step, 8))
        for before, after in zip(a, b, strict=True):
            if before[0].argmax() != before[-1].argmax():
                new = int(before[-1].argmax())
                assert (after[:, new] >= before[:, new] - 1e-6).all()
                compared += 1
    assert compared > 3


def test_short_clips_are_padded_and_have_the_same_weight(dataset: Dataset) -> None:
    long = max(c.frames for c in dataset.select("train"))
    batch = sampler(dataset, window=long + 100).batch(0, 4)
    assert np.allclose(batch.mask.mean(axis=1), np.ones(4, np.float32), atol=1e-5)
    ended = batch.mask == 0
    assert ended.any()
    for name in ("inputs", "targets", "controls", "trajectory", "contacts"):
        assert (getattr(batch, name)[ended] == 0).all(), name


def test_splices_are_made_once_for_a_seed(dataset: Dataset) -> None:
    one, two = sampler(dataset, splices=5), sampler(dataset, splices=5)
    assert len(one.splices) == 5
    for a, b in zip(one.splices, two.splices, strict=True):
        assert np.array_equal(a.data.features, b.data.features) and np.array_equal(a.data.types, b.data.types)


def test_a_dataset_without_training_clips(dataset: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dataset, "clips", ())
    with pytest.raises(DatasetError, match="no training clips"):
        WindowSampler(dataset, SamplerOptions())


def test_gaps_in_reference_poses_last_half_a_second_to_a_second(dataset: Dataset) -> None:
    gaps = {"reference_dropout": 0.0, "reference_gaps": 1.0, "lead_share": 0.0}
    batch = sampler(dataset, window=96, **gaps).batch(0, 16)
    gain = batch.controls[..., -1] * (batch.mask > 0)
    recorded = (batch.mask > 0).sum(dim=1)
    missing = recorded - gain.sum(dim=1)
    assert float(missing.max()) > 30 and 0 < float(missing.min()) and float(missing.max()) < 60
    for row, frames in zip(gain, recorded.tolist(), strict=True):
        assert int((row[:frames].diff() < 0).sum()) <= 1, "one gap a window"


def test_drifting_trajectories_are_too_long_or_too_short(dataset: Dataset) -> None:
    given = {"trajectory_dropout": 0.0, "reference_dropout": 1.0, "lead_share": 0.0}
    true, drifting = (
        sampler(dataset, window=24, splices=0, trajectory_drift=drift, **given).batch(0, 8)
        for drift in (0.0, 0.2)
    )
    # Which windows are drawn, and the trajectory to be predicted, stay as they are.
    assert torch.equal(true.targets, drifting.targets) and torch.equal(true.trajectory, drifting.trajectory)
    columns = ControlLayout(dataset.types).trajectory
    scaling = dataset.trajectory_scaling
    before, after = (scaling.denormalize(batch.controls[..., columns].numpy()) for batch in (true, drifting))
    factors = []
    for row in range(8):
        frames = int((true.mask[row] > 0).sum())
        straight, drifted = (each[row, :frames] for each in (before, after))
        assert np.allclose(straight[:, 12:], drifted[:, 12:], atol=1e-3)  # directions
        straight, drifted = straight[:, :12], drifted[:, :12]
        factors.append(float((drifted * straight).sum() / (straight * straight).sum()))
        assert np.allclose(drifted, factors[-1] * straight, atol=1e-2)
    assert 0.05 < np.std(factors) < 0.5


def test_only_windows_that_go_straight_drift() -> None:
    trajectory, way = np.ones((30, 24), np.float32), np.zeros((31, 3), np.float32)
    way[:, 0] = np.arange(31)
    random = torch.Generator().manual_seed(1)
    assert not np.array_equal(drifted(trajectory, way, 0.2, random), trajectory)
    way[16:, 0] = way[15::-1, 0][:15]  # there and back
    assert np.array_equal(drifted(trajectory, way, 0.2, random), trajectory)


def test_performances_are_repeated_over_a_pause(dataset: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every second splice that ends in one, from another of its type."""
    asked = []

    def noted(dataset, first, second, decay, pick, pause):
        asked.append((first, second, pause))
        return splice_clips(dataset, first, second, decay, pick, pause)

    monkeypatch.setattr("motionkit.training.splices.splice_clips", noted)
    sampler(dataset, splices=60)
    assert {pause for *_, pause in asked} == {0, PAUSE}
    for number, ((clip_a, _, end), (clip_b, start, _), pause) in enumerate(asked):
        after = int(dataset.clip_types(clip_b)[start])
        if pause:
            assert int(dataset.clip_types(clip_a)[end - 1]) == after
        assert (pause > 0) == (number % 2 == 1 and dataset.types[after] in dataset.phase_seconds)


def test_strikes_are_repeated_from_shortly_before_one() -> None:
    phases = np.full(100, -1.0, np.float32)
    phases[8:20] = phases[60:75] = phases[95:] = 0.5
    data: Any = SimpleNamespace(read=lambda *_: SimpleNamespace(phases=phases))
    clip, span = Clip("strikes", 0, 200, "train", "", 0), Span(0, 30, 130)
    found = [from_event(data, clip, span, lambda count, n=n: n % count) for n in range(3)]
    assert found == [Span(0, 30, 130), Span(0, 30 + 60 - BEFORE_EVENT, 130), Span(0, 30, 130)]
    phases[:] = 0.5  # a whole performance
    assert from_event(data, clip, span, lambda count: 0) == span


def test_a_sampler_changes_its_options_but_not_its_splices(dataset: Dataset) -> None:
    sampler = WindowSampler(dataset, SamplerOptions(window=24, splices=3, balance=0.0))
    sampler.make_splices()
    splices, before = list(sampler.splices), sampler.probabilities
    sampler.use(SamplerOptions(window=24, splices=3, balance=1.0, phase_weight=1.0))
    assert sampler.splices == splices and not torch.equal(sampler.probabilities, before)
    seen = sampler.probabilities[sampler.probabilities > 0]
    assert torch.allclose(seen, seen[:1])


@pytest.mark.parametrize("controls", ["extended", "paper"])
def test_the_step_loss_leaves_out_types(dataset: Dataset, controls: str) -> None:
    """The share of the other types is 0 to 1, also where a control vector has the types of six frames."""
    options = LossOptions(step_weight=10.0, step_except=("walking",))
    share = _step_share(dataset.types, options, controls)
    made = WindowSampler(dataset, train_options("tiny", steps=1, splices=0).sampler, controls=controls)
    batch = made.batch(0, 16)
    assert share is not None
    shares = batch.controls @ share
    layout = made.controls
    walks = batch.controls[..., layout.type.start + dataset.types.index("walking")]
    assert torch.allclose(shares, 1.0 - walks, atol=1e-5) and float(walks.max()) == 1.0
