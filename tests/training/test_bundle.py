from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from motionkit.arrays import Array, distances_between
from motionkit.data.dataset import Clip, Dataset
from motionkit.data.preprocess import PreprocessOptions, preprocess
from motionkit.features.control import ControlLayout
from motionkit.features.reference import EMBEDDING_COUNT, REFERENCE_OFFSETS
from motionkit.models.checkpoint import MOVEMENT_FRAMES, ReferenceClip
from motionkit.models.network import PartTransformer
from motionkit.models.presets import preset
from motionkit.motion.bvh import write_bvh
from motionkit.motion.motion import Motion
from motionkit.training.bundle import (
    LONGEST_REFERENCE,
    REFERENCE_SECONDS,
    START_FRAMES,
    STARTS_PER_TYPE,
    before_rest,
    bundle_model,
    measure_gaits,
    recorded_references,
    sampling_presets,
    start_poses_of,
    typical_first,
)
from synthetic_motions import make_walk


def test_seeds_are_beginnings_of_training_stretches_of_the_type(dataset: Dataset) -> None:
    for kind in dataset.types:
        seeds = start_poses_of(dataset, kind)
        assert 1 <= len(seeds) <= STARTS_PER_TYPE
        for seed in seeds:
            assert len(seed.features) == START_FRAMES
            assert any(begins(dataset, clip, kind, seed.features) for clip in dataset.select("train"))


def begins(dataset: Dataset, clip: Clip, kind: str, features: Array) -> bool:
    mine = np.flatnonzero(dataset.clip_types(clip) == dataset.types.index(kind))
    if len(mine) == 0:
        return False
    first = int(mine[0])
    return np.array_equal(dataset.read(clip, first, first + len(features)).features, features)


def test_a_seed_ends_where_its_type_does(tmp_path: Path) -> None:
    """Ten frames of walking, a while of idling, then walking again: the seed is not to hold the idling."""
    folder = tmp_path / "clips"
    folder.mkdir()
    write_bvh(folder / "a.bvh", make_walk(120))
    (folder / "labels.csv").write_text(
        "file,start_frame,end_frame,type,split\n"
        "a.bvh,0,10,walking,train\na.bvh,10,60,idle,train\na.bvh,60,-1,walking,train\n"
    )
    preprocess([folder], tmp_path / "ds", PreprocessOptions(jobs=1, mirror=False))
    (seed,) = start_poses_of(Dataset(tmp_path / "ds"), "walking")
    assert len(seed.features) == 10


def test_a_type_without_training_clips_starts_from_any(
    dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = tuple(c for c in dataset.clips if "wheel" not in c.name)
    monkeypatch.setattr(dataset, "clips", kept)
    (seed,) = start_poses_of(dataset, "cartwheel")
    assert len(seed.features) == START_FRAMES


def test_gaits_are_measured(dataset: Dataset) -> None:
    gaits = measure_gaits(dataset)
    assert gaits["idle"].speed < 10.0
    assert gaits["running"].speed > gaits["walking"].speed > 80.0
    assert abs(gaits["walking"].facing) < 0.1


def test_a_type_that_goes_backwards_has_the_angle_of_its_way(tmp_path: Path) -> None:
    folder = tmp_path / "clips"
    folder.mkdir()
    walk = make_walk(90, turn=0.0)
    root = walk.root_positions * np.array([1.0, 1.0, -1.0], np.float32)
    write_bvh(folder / "retreat.bvh", Motion(walk.skeleton, walk.local_rotations, root, walk.fps))
    preprocess([folder], tmp_path / "ds", PreprocessOptions(jobs=1, mirror=False))
    gait = measure_gaits(Dataset(tmp_path / "ds"))["retreat"]
    assert abs(gait.facing) == pytest.approx(math.pi, abs=0.1)
    assert gait.speed == pytest.approx(120.0, rel=0.05)


def test_a_bundle_holds_what_synthesis_needs(dataset: Dataset) -> None:
    network = PartTransformer(preset("tiny"), ControlLayout(dataset.types).size)
    model = bundle_model(network, dataset, {"note": "for a test"})
    assert model.types == dataset.types and model.fps == 60.0
    assert "default" in model.characters
    assert set(model.start_poses) == set(model.gaits) == set(dataset.types)
    assert model.card == {"note": "for a test"}
    assert np.array_equal(model.reference_rotations, dataset.reference_rotations)


def test_who_stands_takes_more_noise(dataset: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    def noise() -> dict[str, float]:
        return {kind: preset.noise for kind, preset in sampling_presets(dataset).items()}

    shares = noise()
    assert set(shares) == set(dataset.types)
    assert shares["idle"] > shares["running"] == shares["cartwheel"]
    monkeypatch.setattr("motionkit.training.bundle.QUIET", 0.0)
    assert len(set(noise().values())) == 1
    monkeypatch.setattr("motionkit.training.bundle.QUIET", float("inf"))
    assert noise()["walking"] == shares["idle"] and noise()["cartwheel"] == shares["cartwheel"]


def test_outlines_end_where_bodies_come_to_rest() -> None:
    reference_clip = moving(1.0, 300)
    reference_clip.poses[:, 0] = np.minimum(reference_clip.poses[:, 0], 100.0)
    ended = before_rest(reference_clip, 0.5)
    assert (
        reference_clip.movement[len(ended) - 1] >= 0.5 > reference_clip.movement[len(ended)]
        and 0 < len(ended) < 100
    )
    assert len(ended.poses) == len(ended) + REFERENCE_OFFSETS[-1]
    assert len(ended.ground) == len(ended.phases) == len(ended)
    assert len(before_rest(reference_clip, 2.0)) == 300


def test_outlines_are_those_of_training_stretches(dataset: Dataset) -> None:
    (first, *_) = recorded_references(dataset, "cartwheel")
    assert first.performed and float(first.phases[0]) == 0.0
    assert len(first.poses) == len(first) + REFERENCE_OFFSETS[-1]
    clip = next(c for c in dataset.select("train") if "wheel" in c.name)
    poses = dataset.pose_embedding.of(dataset.read(clip).features)
    assert float(distances_between(first.poses[:1], poses).min()) < 1e-3
    walks = recorded_references(dataset, "walking")
    assert not any(walk.performed for walk in walks)
    assert sum(map(len, walks)) <= (REFERENCE_SECONDS + LONGEST_REFERENCE) * dataset.fps


def moving(speed: float, frames: int = 60) -> ReferenceClip:
    """An reference_clip that changes by so much a frame."""
    poses = np.zeros((frames + REFERENCE_OFFSETS[-1], EMBEDDING_COUNT), np.float32)
    poses[:, 0] = speed * np.arange(len(poses))
    return ReferenceClip(poses, np.zeros((frames, 3), np.float32), np.full((frames,), -1.0, np.float32))


def test_parts_that_move_as_the_type_does_come_first_and_from_all_recordings() -> None:
    found = [("a", moving(s)) for s in (0.1, 4.0, 5.0)] + [("b", moving(s)) for s in (0.1, 9.0)]
    ordered = typical_first(found)
    assert [float(reference_clip.movement[0]) for reference_clip in ordered] == pytest.approx(
        [4.0, 9.0, 5.0, 0.1, 0.1]
    )


def test_movement_of_an_outline_is_the_mean_over_what_comes() -> None:
    reference_clip = moving(1.0, 300)
    reference_clip.poses[:, 0] = np.minimum(reference_clip.poses[:, 0], 100.0)
    assert reference_clip.movement[0] == pytest.approx(100 / MOVEMENT_FRAMES)
    assert reference_clip.movement[40] == pytest.approx(60 / MOVEMENT_FRAMES)
    assert reference_clip.movement[-1] == 0.0 and len(reference_clip.movement) == 300


def test_what_moves_sharply_is_guided_and_carried_on_in_its_own_way(
    dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    # What a type is follows from its events alone: types that the dataset has stand for others.
    events = {"cartwheel": "", "running": "jump", "walking": "kick"}
    monkeypatch.setattr(Dataset, "phase_events", events)
    monkeypatch.setattr("motionkit.training.bundle.STEERED_TYPES", ("idle",))
    monkeypatch.setattr("motionkit.training.bundle.QUIET", 0.0)
    kinds = ("idle", "running", "walking", "cartwheel")
    steered, jumping, kicking, cartwheel = (sampling_presets(dataset)[kind] for kind in kinds)
    monkeypatch.setattr(Dataset, "phase_events", {})
    dance = sampling_presets(dataset)["cartwheel"]
    assert (
        1.0
        == steered.reference_gain
        < kicking.reference_gain
        == cartwheel.reference_gain
        < dance.reference_gain
        < jumping.reference_gain
    )
    assert (
        0.0
        < steered.velocity_blend
        < jumping.velocity_blend
        < kicking.velocity_blend
        < dance.velocity_blend
        < cartwheel.velocity_blend
        < 1.0
    )
    assert (
        0.0
        < steered.slip_correction
        < jumping.slip_correction
        == cartwheel.slip_correction
        < kicking.slip_correction
        < dance.slip_correction
        < 1.0
    )
