"""The action classifier: it knows its own recordings, and what is measured with it has known values."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from motionkit.data.dataset import Dataset
from motionkit.errors import DatasetError, MotionkitError
from motionkit.lab.classifier import (
    WIDTH,
    Classifier,
    classified,
    described,
    recorded_windows,
    train_classifier,
)
from motionkit.metrics.body import body_of
from motionkit.metrics.distribution import multimodality
from synthetic_motions import make_walk


@pytest.fixture(scope="module")
def classifier(dataset: Dataset) -> Classifier:
    return train_classifier(dataset)


def test_it_knows_the_recordings_it_was_trained_on(classifier: Classifier, dataset: Dataset) -> None:
    windows = recorded_windows(dataset, "train")
    assert set(windows) <= set(classifier.types)
    found = classified(classifier, {kind: [rows] for kind, rows in windows.items()}, windows.values())
    assert found["class-accuracy"].value > 0.9
    assert found["fid-class"].value == pytest.approx(0.0, abs=1e-3)
    assert found["multimodality"].value is None and found["multimodality"].reason  # one motion of each type
    kinds = list(windows)
    swapped = dict(zip(kinds, [[windows[kind]] for kind in kinds[1:] + kinds[:1]], strict=True))
    assert classified(classifier, swapped, windows.values())["class-accuracy"].value < 0.2
    assert classified(classifier, {kinds[0]: []}, [])["class-accuracy"].value is None


def test_it_does_not_know_mirror_images_that_are_held_out(dataset: Dataset) -> None:
    twin = next(clip for clip in dataset.select("train") if clip.mirrored)
    moved = copy(dataset)
    moved.clips = tuple(replace(clip, split="test") if clip is twin else clip for clip in dataset.clips)
    before, after = (
        sum(map(len, recorded_windows(each, "train", mirrored=True).values())) for each in (dataset, moved)
    )
    assert 0 < after < before


def test_the_same_seed_gives_the_same_classifier(classifier: Classifier, dataset: Dataset) -> None:
    again = train_classifier(dataset)
    assert all(np.array_equal(a, b) for a, b in zip(again.layers, classifier.layers, strict=True))


def test_windows_follow_the_motion_not_the_place(classifier: Classifier) -> None:
    walk = make_walk(120)
    here, there = described(body_of(walk)), described(body_of(walk.turned(1.0)))
    assert len(here) == 7  # a second, every ten frames
    assert there == pytest.approx(here, abs=1e-2)
    assert described(body_of(walk.cut(0, 50))).shape == (0, here.shape[1])
    assert classifier.features(here).shape == (7, WIDTH)


def test_one_type_cannot_be_told_from_others(dataset: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    some = {"walk": np.zeros((3, 5), np.float32)}
    monkeypatch.setattr("motionkit.lab.classifier.recorded_windows", lambda *asked, **more: some)
    with pytest.raises(DatasetError, match="two types"):
        train_classifier(dataset)


def test_multimodality_is_the_distance_of_two_motions_of_a_type() -> None:
    motions = [np.full((4, 2), value) for value in (0.0, 3.0)]
    assert multimodality([motions, motions[:1]]).value == pytest.approx(3.0 * 2**0.5)
    with pytest.raises(MotionkitError, match="two motions"):
        multimodality([motions[:1]])
