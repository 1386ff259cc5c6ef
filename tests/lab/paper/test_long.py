"""Long roll-outs: what they begin from, and what counts as holding."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from motionkit.data.dataset import Dataset
from motionkit.data.phases import type_stretches
from motionkit.errors import ControlError, DatasetError, MotionkitError
from motionkit.lab.paper.bodies import show_bodies
from motionkit.lab.paper.long_rollouts import (
    INITIAL,
    LONG_HEADER,
    _distances,
    _swing,
    fastest_recorded,
    initial_stretch,
    long_rollout,
    long_row,
    long_types,
    types_known,
)
from motionkit.lab.paper.model_results import read_models
from motionkit.lab.paper.shipped import run_shipped
from motionkit.models.checkpoint import load_model
from motionkit.models.model import MotionModel
from motionkit.training.presets import train_options
from motionkit.training.trainer import train

SMALL = {"width": 48, "heads": 4, "ffn": 96, "layers": 1, "control_width": 16, "control_embedding": 16}


@pytest.fixture(scope="module")
def paper_data(paper_folder: Path) -> Dataset:
    return Dataset(paper_folder)


@pytest.fixture(scope="module")
def paper_model(paper_data: Dataset, tmp_path_factory: pytest.TempPathFactory) -> MotionModel:
    path = tmp_path_factory.mktemp("long-model") / "small.safetensors"
    options = train_options(
        "tptn-paper", steps=4, batch=2, window=24, precision="float32", score_seconds=0.0,
        config={**SMALL, "shared_channels": 12},
    )  # fmt: skip
    train(paper_data.folder, path, options, device="cpu")
    return load_model(path)


def a_tested_type(dataset: Dataset) -> str:
    clip = max(dataset.select("test"), key=lambda clip: clip.frames)
    return dataset.types[int(dataset.clip_types(clip)[0])]


def test_it_begins_in_the_longest_stretch_of_a_type(paper_data: Dataset) -> None:
    kind = a_tested_type(paper_data)
    sequence = initial_stretch(paper_data, kind)
    number = paper_data.types.index(kind)
    assert (sequence.data.types == number).all() and sequence.initial == INITIAL
    longest = max(int((paper_data.clip_types(c) == number).sum()) for c in paper_data.select("test"))
    assert len(sequence.data.types) == INITIAL + sequence.frames <= longest


def test_a_dataset_without_a_dance_is_refused(paper_data: Dataset) -> None:
    with pytest.raises(DatasetError, match="no test clip of"):
        long_types(paper_data)
    kind = a_tested_type(paper_data)
    assert long_types(paper_data, [kind]) == [kind]
    with pytest.raises(DatasetError, match="no test clip of flying"):
        long_types(paper_data, [kind, "flying"])


def test_a_roll_out_is_measured_in_four_parts_and_repeats(
    paper_model: MotionModel, paper_data: Dataset, tmp_path: Path
) -> None:
    kind = a_tested_type(paper_data)
    made = [long_rollout(paper_model, paper_data, kind, 1.0, seed, lambda share: None) for seed in (0, 0, 1)]
    facts = made[0].facts
    assert len(made[0].motion) == 60 and len(facts["distance"]) == len(facts["speed"]) == 4
    assert facts == made[1].facts and facts["distance"] != made[2].facts["distance"]
    assert not facts["holds"]  # four steps of training are none
    row = long_row(facts)
    assert len(row) == len(LONG_HEADER) and row[0] == kind and row[-1] == "no"
    (tmp_path / "small.json").write_text(json.dumps({"model": "small", "steps": 4, "rollouts": [facts]}))
    assert read_models(tmp_path, "long")[0]["rollouts"] == [facts]
    (tmp_path / "other.json").write_text("[]")
    with pytest.raises(MotionkitError, match=r"other\.json: not the results of long roll-outs"):
        read_models(tmp_path, "long")


def test_a_dataset_of_another_layout_is_refused(paper_model: MotionModel, dataset_folder: Path) -> None:
    other = Dataset(dataset_folder)
    assert other.layout.version != paper_model.config.layout
    with pytest.raises(DatasetError, match=r"layout .*, but the model needs expmap-root-1"):
        long_rollout(paper_model, other, a_tested_type(other), 1.0, 0, lambda share: None)
    with pytest.raises(DatasetError, match="but the model needs expmap-root-1"):
        show_bodies(paper_model, other, a_tested_type(other), 1, lambda share: None)
    with pytest.raises(DatasetError, match="but the networks to compare with need expmap-root-1"):
        run_shipped({}, other, "all", 1, 30, Path("results"), lambda share: None)


def test_types_that_a_model_does_not_know_are_left_out(paper_model: MotionModel) -> None:
    first = next(iter(paper_model.types))
    assert types_known(paper_model, [first, "dance-salsa"], requested=False) == [first]
    with pytest.raises(ControlError, match="unknown motion type 'dance-salsa'"):
        types_known(paper_model, [first, "dance-salsa"], requested=True)
    with pytest.raises(ControlError, match="knows none of dance-salsa; choose others"):
        types_known(paper_model, ["dance-salsa"], requested=False)


def test_only_models_that_feed_their_trajectory_back(tiny_model: MotionModel, paper_data: Dataset) -> None:
    with pytest.raises(MotionkitError, match="tptn-paper"):
        long_rollout(tiny_model, paper_data, a_tested_type(paper_data), 1.0, 0, lambda share: None)


def test_distances_are_those_to_the_nearest_pose() -> None:
    draw = np.random.default_rng(0)
    library = draw.normal(size=(50, 69)).astype(np.float32)
    np.testing.assert_allclose(_distances(library[[3, 20]], library), 0.0, atol=1e-3)
    # One joint of 23 moved by 3 cm.
    moved = library[:1].copy()
    moved[0, :3] += np.array([3.0, 0.0, 0.0], np.float32)
    assert _distances(moved, library)[0] == pytest.approx(3.0 / 23**0.5, rel=1e-3)


def test_the_fastest_frames_of_a_type_are_those_in_a_row(paper_data: Dataset) -> None:
    """By hand: the fastest 30 frames are faster than whole stretches, and all frames are the stretches as they are."""
    kind = a_tested_type(paper_data)
    number = paper_data.types.index(kind)
    ways = []
    for clip in paper_data.select("train"):
        data = paper_data.read(clip)
        for start, end, shown in type_stretches(data.types):
            if shown == number and end - start >= paper_data.fps:
                ways.append(
                    np.linalg.norm(np.diff(data.ground[start:end, :2], axis=0), axis=1) * paper_data.fps
                )
    short = max(way[i : i + 29].mean() for way in ways for i in range(len(way) - 28))
    assert fastest_recorded(paper_data, kind, 30) == pytest.approx(short, rel=1e-3)
    whole = max(way.mean() for way in ways)
    assert fastest_recorded(paper_data, kind, 10**6) == pytest.approx(whole, rel=1e-3) and whole < short


def test_trembling_is_no_swing() -> None:
    time = np.arange(120) / 60.0
    steps = np.zeros((120, 12))
    steps[:, [2, 5, 8, 11]] = 25.0 * np.sin(2 * np.pi * time)[:, None]
    trembling = np.random.default_rng(0).normal(size=(120, 12))
    assert _swing(steps) == pytest.approx(25.0 / 2**0.5, rel=1e-3)
    assert _swing(trembling) < 2.0
