"""Datasets that lack what larger ones have: training clips of a type, long clips, a second recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motionkit.data.dataset import Clip, Dataset
from motionkit.lab.classifier import recorded_windows
from motionkit.lab.floors import Matching, nearest_clip
from motionkit.lab.held_out import HeldOut
from motionkit.lab.matched_motion import MatchedMotion
from motionkit.lab.paper.datasets import _plain
from motionkit.models.bundled import load_bundled_model


def changed(dataset: Dataset, change: Callable[[Clip], Clip]) -> Dataset:
    """A copy of a dataset with other clips."""
    made = Dataset(dataset.folder)
    made.clips = tuple(map(change, dataset.clips))
    return made


@pytest.fixture
def swapped(dataset: Dataset) -> Dataset:
    """Every recording is held out, and its mirror image trains: what preprocess makes of types with one recording."""
    starts = {clip.start for clip in dataset.clips if clip.mirrored}
    assert starts
    split = {True: "train", False: "test"}
    return changed(dataset, lambda c: replace(c, split=split[c.mirrored]) if c.start in starts else c)


def test_mirror_images_train_where_the_recording_is_held_out(dataset: Dataset, swapped: Dataset) -> None:
    known = set(recorded_windows(dataset, "train", mirrored=True))
    assert known and known <= set(recorded_windows(swapped, "train", mirrored=True))
    train = {clip.start for clip in _plain(swapped, "train")}
    assert train == {clip.start for clip in swapped.select("train")}
    assert not any(clip.mirrored or clip.start in train for clip in _plain(swapped, "test"))


def test_a_type_that_is_held_out_only_is_not_matched(dataset: Dataset) -> None:
    trained = {kind for _, _, _, kind in dataset.stretches("train")}
    lost = min(trained)
    kinds = {clip.name for clip, _, _, kind in dataset.stretches(None) if kind == lost}
    without = changed(dataset, lambda c: replace(c, split="test") if c.name in kinds else c)
    matched = MatchedMotion(load_bundled_model(), without)
    assert not matched.knows(lost) and lost in without.types
    assert matched.knows(*{kind for _, _, _, kind in without.stretches("train")})


@pytest.mark.parametrize("frames", [15, 60])
def test_floors_of_short_clips(dataset: Dataset, frames: int) -> None:
    whole = max(dataset.select("train"), key=lambda clip: clip.frames)
    short = changed(dataset, lambda c: replace(c, frames=min(c.frames, frames)))
    sequence = HeldOut(whole, dataset.read(whole), 30, 50, "walking")
    rows = nearest_clip(short)(sequence, 0)
    assert rows.shape == (50, sequence.data.features.shape[1]) and np.isfinite(rows).all()
    matching = Matching(short)
    matching.begin()
    number = int(sequence.data.types[0])
    for frame in range(50):
        row = matching.next(frame, sequence.data.features[29], number, np.zeros(24, np.float32))
        assert 0 <= row < len(matching.library.ends)
