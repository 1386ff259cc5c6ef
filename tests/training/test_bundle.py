from __future__ import annotations

import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.arrays import Array, distances_between
from motionkit.data.dataset import Clip, Dataset
from motionkit.data.options import PreprocessOptions
from motionkit.data.preprocess import preprocess
from motionkit.features.control import ControlLayout
from motionkit.features.reference import EMBEDDING_COUNT, REFERENCE_OFFSETS
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MOVEMENT_FRAMES, MotionKind, MotionType, ReferenceClip
from motionkit.models.network import PartTransformer
from motionkit.models.presets import preset
from motionkit.motion.bvh import write_bvh
from motionkit.motion.motion import Motion
from motionkit.training import bundle
from motionkit.training.bundle import (
    LONGEST_REFERENCE,
    REFERENCE_SECONDS,
    STANCES,
    START_FRAMES,
    STARTS_PER_TYPE,
    before_rest,
    bundle_model,
    measure_gaits,
    recorded_references,
    sampling_preset,
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


def test_standing_has_stances_that_are_unlike(dataset: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """As many as there are of the beginnings of three stretches, not only those nearest to the usual pose."""
    monkeypatch.setattr(bundle, "STANCE_SHARE", 1.0)
    nearest, all_of_them = (
        start_poses_of(dataset, "walking"),
        start_poses_of(dataset, "walking", standing=True),
    )
    assert len(nearest) == STARTS_PER_TYPE < len(all_of_them) <= STANCES
    assert np.array_equal(nearest[0].features, all_of_them[0].features)
    monkeypatch.setattr(bundle, "STANCES", 2)
    first, far = start_poses_of(dataset, "walking", standing=True)
    assert np.array_equal(first.features, nearest[0].features)
    assert not any(np.array_equal(far.features, one.features) for one in nearest[:2])


def test_where_there_are_enough_recordings_a_mirror_image_is_no_other_stance(
    dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bundle, "STANCE_SHARE", 1.0)

    def recordings() -> list[int]:
        starts = start_poses_of(dataset, "walking", standing=True)
        return [
            clip.start
            for one in starts
            for clip in dataset.select("train")
            if begins(dataset, clip, "walking", one.features)
        ]

    many = recordings()
    count = len(set(many))
    assert len(many) == 2 * count, "few recordings: each and its mirror image"
    monkeypatch.setattr(bundle, "STANCES", count)
    few = recordings()
    assert len(few) == len(set(few)) == count


def test_a_type_without_training_clips_has_no_references(tmp_path: Path) -> None:
    """It once ended a run that was over."""
    (tmp_path / "clips").mkdir()
    for name in ("go", "stay"):
        write_bvh(tmp_path / "clips" / f"{name}.bvh", make_walk(60))
    (tmp_path / "clips" / "labels.csv").write_text(
        "file,start_frame,end_frame,type,split\ngo.bvh,0,-1,go,train\nstay.bvh,0,-1,stay,test\n", "utf-8"
    )
    preprocess([tmp_path / "clips"], tmp_path / "data", PreprocessOptions(jobs=1))
    dataset = Dataset(tmp_path / "data")
    network = PartTransformer(preset("tiny"), ControlLayout(dataset.types).size)
    model = bundle_model(network.weights(), dataset, {})
    assert model.types["go"].reference_clips and not model.types["stay"].reference_clips


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
    assert model.type_names == dataset.types and model.fps == 60.0
    assert "default" in model.characters
    assert all(kind.start_poses and kind.gait is not None for kind in model.types.values())
    assert model.card == {"note": "for a test"}
    assert np.array_equal(model.reference_rotations, dataset.reference_rotations)


def test_what_is_steered_is_found_from_the_motion(dataset: Dataset) -> None:
    network = PartTransformer(preset("tiny"), ControlLayout(dataset.types).size)
    model = bundle_model(network.weights(), dataset, {})
    assert {name for name, kind in model.types.items() if kind.steered} == {"idle", "walking", "running"}
    assert [name for name in model.types if model.kind(name) is MotionKind.STANCE] == ["idle"]
    noise = {name: kind.preset.noise_scale for name, kind in model.types.items()}
    assert noise["idle"] > noise["running"] == noise["cartwheel"], "a standing body needs noise to sway"


def test_names_do_not_matter_to_what_is_steered(clips_folder: Path, tmp_path: Path) -> None:
    """The same recordings under names nobody knows give the same model."""
    shutil.copytree(clips_folder, tmp_path / "clips")
    labels = tmp_path / "clips" / "labels.csv"
    text = labels.read_text()
    for old, new in (("walking", "Lauf_02"), ("running", "zombie"), ("idle", "warten")):
        text = text.replace(f",{old}", f",{new}")
    labels.write_text(text)
    preprocess([tmp_path / "clips"], tmp_path / "ds", PreprocessOptions(jobs=1))
    other = Dataset(tmp_path / "ds")
    network = PartTransformer(preset("tiny"), ControlLayout(other.types).size)
    model = bundle_model(network.weights(), other, {})
    assert {name for name, kind in model.types.items() if kind.steered} == {"warten", "Lauf_02", "zombie"}


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


def test_there_is_more_room_where_it_takes_more_to_show_every_recording(
    dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A part of each, the mirror images left out; no more than MOST_SECONDS."""
    wanted = dataset.types.index("walking")
    walks = [clip for clip in dataset.select("train") if (dataset.clip_types(clip) == wanted).any()]
    recordings = {clip.start for clip in walks}
    monkeypatch.setattr(bundle, "LONGEST_REFERENCE", 1.0)
    assert len(recorded_references(dataset, "walking")) > len(walks) > len(recordings) > 1
    monkeypatch.setattr(bundle, "REFERENCE_SECONDS", 1.0)
    assert len(recorded_references(dataset, "walking")) == len(recordings)
    monkeypatch.setattr(bundle, "MOST_SECONDS", 1.0)
    assert len(recorded_references(dataset, "walking")) == 1


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


def test_a_recording_comes_before_its_mirror_image_whatever_the_last_digits() -> None:
    found = [
        ("b (mirrored)", moving(2.0 - 1e-6)),
        ("b", moving(2.0)),
        ("a", moving(2.0 + 1e-6)),
        ("c", moving(9.0)),
    ]
    assert typical_first(found) == [found[i][1] for i in (2, 1, 0, 3)]


def test_movement_of_an_outline_is_the_mean_over_what_comes() -> None:
    reference_clip = moving(1.0, 300)
    reference_clip.poses[:, 0] = np.minimum(reference_clip.poses[:, 0], 100.0)
    assert reference_clip.movement[0] == pytest.approx(100 / MOVEMENT_FRAMES)
    assert reference_clip.movement[40] == pytest.approx(60 / MOVEMENT_FRAMES)
    assert reference_clip.movement[-1] == 0.0 and len(reference_clip.movement) == 300


def test_what_helps_a_motion_depends_on_its_kind(tiny_model: MotionModel) -> None:
    gait, other = replace(tiny_model.types["walking"], steered=True), MotionType()
    steered, kicking, jumping, cartwheel, dance = (
        sampling_preset(kind, event)
        for kind, event in ((gait, None), (other, "kick"), (other, "jump"), (other, ""), (other, None))
    )
    gains = {p.reference_gain for p in (steered, kicking, jumping, cartwheel, dance)}
    assert gains == {1.0}  # until they are found
    blends = [p.velocity_blend for p in (steered, jumping, kicking, dance, cartwheel)]
    assert blends == sorted(blends) and 0.0 < blends[0]
    slips = [p.slip_correction for p in (steered, kicking, dance)]
    assert slips == sorted(slips) and 0.0 < slips[0]
