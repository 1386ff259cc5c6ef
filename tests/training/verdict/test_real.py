from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motionkit.data.dataset import Dataset
from motionkit.errors import DatasetError
from motionkit.features.decode import decode_motion
from motionkit.lab.scoreboard.accuracy import calibrate
from motionkit.metrics.body import body_of
from motionkit.training.verdict.judge import Judge
from motionkit.training.verdict.real import RealMotion
from synthetic_motions import make_walk, placed


def test_a_training_pose_is_at_distance_zero_unless_its_clip_is_left_out(
    real: RealMotion, dataset: Dataset
) -> None:
    stretch = real.of_type("walking", "train")[0]
    kind = real.types.index("walking")
    first = real.pose_distances(stretch.body)[0]
    assert first[kind] == pytest.approx(0.0, abs=0.1)
    assert real.pose_distances(stretch.body, without=stretch.clip)[0, kind] > 0.1
    mirror = next(c for c in dataset.clips if c.mirrored and c.start == dataset.clips[stretch.clip].start)
    data = dataset.read(mirror)
    twin = decode_motion(
        data.features,
        dataset.skeleton(mirror),
        dataset.fps,
        data.ground[0],
        dataset.reference_rotations,
        dataset.layout.version,
    )
    assert real.pose_distances(body_of(twin))[0, kind] == pytest.approx(0.0, abs=0.1)
    assert real.pose_distances(body_of(twin), without=stretch.clip)[0, kind] > 0.1


def test_distances_do_not_depend_on_place_or_heading(real: RealMotion) -> None:
    walk = make_walk(60)
    moved = real.pose_distances(body_of(placed(walk, yaw=2.0, move=(90.0, -40.0))))
    assert np.allclose(real.pose_distances(body_of(walk)), moved, atol=0.1)


def test_recordings_are_within_their_own_motion_profile(real: RealMotion) -> None:
    stretch = real.of_type("walking", "train")[0]
    profile = real.profile("walking")
    assert profile is not None and profile.speeds[0] < profile.joint_speed < profile.speeds[1]
    assert profile.speeds[0] < profile.usual[0] <= profile.joint_speed <= profile.usual[1] < profile.speeds[1]
    distances = real.pose_distances(stretch.body).mean(axis=0)
    assert profile.shows(stretch.body, distances)
    assert not profile.shows(stretch.body, distances + 100.0)
    frozen = body_of(make_walk(60, speed=0.0, swing=0.0))
    assert not profile.shows(frozen, distances)
    assert real.profile("unheard-of") is None


def test_calibration_counts_every_stretch_for_its_own_type(real: RealMotion) -> None:
    kinds = ("idle", "walking", "cartwheel")
    found = {c.type: c for c in calibrate(Judge(real), kinds)}
    assert set(found) == set(kinds)
    assert found["idle"].accepted == found["idle"].windows > 0
    assert all(bool(c.failing) == (c.accepted < c.windows) for c in found.values())
    assert found["cartwheel"].share == 1.0 and found["cartwheel"].windows == len(real.of_type("cartwheel"))
    assert "walking" not in found["walking"].others
    assert "idle" not in found["walking"].others


def test_a_type_whose_mirror_image_trains_is_not_missing(
    dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    wheel = next(clip for clip in dataset.clips if "wheel" in clip.name and not clip.mirrored)
    others = [clip for clip in dataset.clips if "wheel" not in clip.name]
    swapped = (replace(wheel, split="test"), replace(wheel, split="train", mirrored=True))
    monkeypatch.setattr(dataset, "clips", (*others, *swapped))
    found = RealMotion(dataset).of_type("cartwheel")
    assert sorted(stretch.split for stretch in found) == ["test", "train"]
    assert RealMotion(dataset).profile("cartwheel") is not None
    left = [stretch.body.positions[:, 15, 0] - stretch.body.positions[:, 19, 0] for stretch in found]
    assert np.allclose(np.abs(left[0]), np.abs(left[1]), atol=1e-2)


def test_test_clips_are_not_read_for_validation(dataset: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    held = [clip.name for clip in dataset.clips if clip.split == "test"]
    assert {s.name for s in RealMotion(dataset).stretches} >= set(held)
    monkeypatch.setattr(
        dataset,
        "clips",
        tuple(replace(c, split="validation") if "walk_02" in c.name else c for c in dataset.clips),
    )
    seen = RealMotion(dataset, "validation")
    assert not {s.name for s in seen.stretches} & set(held)
    assert seen.of_type("walking", "validation") and seen.held_out == "validation"


def test_a_dataset_without_training_clips_is_refused(dataset: Dataset, monkeypatch) -> None:
    monkeypatch.setattr(dataset, "clips", tuple(c for c in dataset.clips if c.split == "test"))
    with pytest.raises(DatasetError, match="no training clips"):
        RealMotion(dataset)


@pytest.mark.filterwarnings("error")
def test_a_single_clip_has_a_profile_that_judges_nothing(
    dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    only = tuple(clip for clip in dataset.select("train") if "idle" in clip.name and not clip.mirrored)
    monkeypatch.setattr(dataset, "clips", only)
    profile = RealMotion(dataset).profile("idle")
    assert profile is not None and not profile.judges and profile.joint_speed > 0.0
