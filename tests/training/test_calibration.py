"""Reference gains and noise, found by how roll-outs move."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.data.dataset import Dataset
from motionkit.metrics.body import Body, body_of
from motionkit.models.checkpoint import load_model, save_model
from motionkit.models.model import MotionModel
from motionkit.training import calibration
from motionkit.training.calibration import (
    Movement,
    calibrated_gains,
    calibrated_noise,
    made_movements,
    movement_of,
    recorded_movements,
    training_judge,
    with_presets,
)
from motionkit.training.trainer import train
from motionkit.training.verdict.judge import Judge
from synthetic_motions import make_walk

RECORDED = Movement(2.0, 50.0, 0.5, 0.1)


@pytest.mark.parametrize(
    ("made", "cost"),
    [
        (Movement(2.0, 50.0, 0.5, 0.1), 0.0),
        (Movement(2.0, 10.0, 0.5, 0.1), 0.0),  # smoother is no fault
        (Movement(2.0, 60.0, 0.5, 0.1), 0.0),
        (Movement(2.0, 65.0, 0.5, 0.1), 0.25 * math.log(65.0 / 60.0)),  # more than 1.2 times the jerk
        (Movement(2.0, 120.0, 0.5, 0.1), 0.25 * math.log(2.0) + math.log(2.4 / 1.4)),
        (Movement(1.0, 50.0, 0.5, 0.1), math.log(2.0)),
        (Movement(2.0, 50.0, 0.5, 0.0), 0.0),
        (Movement(2.0, 50.0, 0.5, 0.12), 0.0),
        (Movement(2.0, 50.0, 0.5, 0.29), math.log(2.0)),
        (Movement(4.0, 50.0, 0.5, 0.1), math.log(2.0)),  # too fast is as bad as too slow
        (
            Movement(2.0, 50.0, 0.5, 0.1, 0.475),
            3.0 * math.log(2.0),
        ),  # half of the roll-outs do not show the type
        (Movement(1.0, 120.0, 0.1, 0.1), 1.25 * math.log(2.0) + math.log(2.4 / 1.4) + math.log(5.5 / 1.5)),
    ],
)
def test_the_cost_of_a_manner(made: Movement, cost: float) -> None:
    assert made.cost(RECORDED) == pytest.approx(cost)


@pytest.mark.parametrize(
    ("costs", "gain"),
    [
        ((0.5, 0.4, 0.3, 0.1, 0.2, 0.4), 1.5),
        ((0.28, 0.27, 0.26, 0.26, 0.26, 0.26), 1.0),  # neither more nor less is much better
        ((0.1, 0.3, 0.3, 0.3, 0.3, 0.3), 0.5),
        ((0.4, 0.36, 0.32, 0.28, 0.27, 0.26), 1.5),
    ],
)
def test_the_gain_nearest_to_one_that_is_nearly_the_best(costs: tuple[float, ...], gain: float) -> None:
    assert calibration._cheapest((0.5, 0.7, 1.0, 1.5, 2.0, 2.5), costs) == gain


def test_the_manner_of_a_motion() -> None:
    walk = make_walk(120)
    found, faster = movement_of(body_of(walk)), movement_of(body_of(replace(walk, fps=2.0 * walk.fps)))
    assert 0.1 < found.planted <= 1.0 and found.speed > 0.1
    assert faster.speed == pytest.approx(2.0 * found.speed) and faster.jerk == pytest.approx(8.0 * found.jerk)
    lifted = replace(walk, root_positions=walk.root_positions + np.float32([0.0, 50.0, 0.0]))
    above = movement_of(body_of(lifted))
    assert above.planted == 0.0 < 0.9 < above.hovering


def test_types_that_references_move_get_the_gain_that_moves_them_as_recorded(
    tiny_model: MotionModel, dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Roll-outs whose speed is half of the recorded one times their gain, and that are planted as long."""
    kinds = list(tiny_model.types)
    recorded = recorded_movements(training_judge(dataset).real, kinds)
    assert recorded["running"].speed > recorded["walking"].speed > 2.0 * recorded["idle"].speed
    assert recorded["running"].planted < recorded["walking"].planted

    def made(model: MotionModel, moved: list[str], frames: int, judge: Judge) -> dict[str, Movement]:
        return {
            kind: Movement(
                0.5 * model.types[kind].preset.reference_gain * recorded[kind].speed,
                0.0,
                recorded[kind].planted,
                0.0,
            )
            for kind in moved
        }

    monkeypatch.setattr(calibration, "made_movements", made)
    found = calibrated_gains(tiny_model, training_judge(dataset), 10)
    moved = {name for name, kind in tiny_model.types.items() if kind.reference_clips}
    assert {"walking", "cartwheel"} <= moved == set(found)
    assert set(found.values()) == {2.0}


def test_roll_outs_depend_on_the_gain(
    tiny_model: MotionModel, dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(calibration, "REPEATS", 1)
    monkeypatch.setattr(calibration, "GAINS", (1.0, 2.5))
    gains = calibrated_gains(tiny_model, training_judge(dataset), 20)
    assert gains and set(gains.values()) <= {1.0, 2.5}
    louder = with_presets(tiny_model, "reference_gain", {"cartwheel": 2.0})
    assert louder.types["cartwheel"].preset.reference_gain == 2.0
    assert louder.types["walking"].preset == tiny_model.types["walking"].preset
    judge = training_judge(dataset)
    soft, loud = (made_movements(model, ["cartwheel"], 20, judge) for model in (tiny_model, louder))
    assert soft["cartwheel"] != loud["cartwheel"]


def test_a_type_that_is_not_shown_costs(
    tiny_model: MotionModel, dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every third roll-out is judged to show its type; without a judgement all count as shown."""
    monkeypatch.setattr(calibration, "REPEATS", 3)
    judge, asked = training_judge(dataset), []

    def performs(kind: str, body: Body) -> bool:
        asked.append((kind, len(body)))
        return len(asked) == 1

    monkeypatch.setattr(judge, "knows", lambda kind: kind == "walking")
    monkeypatch.setattr(judge, "performs", performs)
    found = made_movements(tiny_model, ["walking", "cartwheel"], 20, judge)
    assert found["walking"].shown == pytest.approx(1 / 3) and found["cartwheel"].shown == 1.0
    seconds = calibration.CHANGE + 20 / tiny_model.fps
    assert asked == [("walking", round(seconds * tiny_model.fps))] * 3


def test_a_type_that_is_shown_too_seldom_is_measured_in_longer_roll_outs(
    tiny_model: MotionModel, dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Short roll-outs show a walk half of the time; long ones show it with a gain of 2 alone."""
    recorded = recorded_movements(training_judge(dataset).real, list(tiny_model.types))
    asked: list[tuple[int, tuple[str, ...]]] = []

    def made(model: MotionModel, moved: list[str], frames: int, judge: Judge) -> dict[str, Movement]:
        asked.append((frames, tuple(moved)))
        gain = model.types["walking"].preset.reference_gain
        shown = 0.5 if frames == 10 else float(gain == 2.0)
        return {kind: replace(recorded[kind], shown=shown if kind == "walking" else 1.0) for kind in moved}

    monkeypatch.setattr(calibration, "made_movements", made)
    found = calibrated_gains(tiny_model, training_judge(dataset), 10)
    assert found["walking"] == 2.0 and {gain for kind, gain in found.items() if kind != "walking"} == {1.0}
    assert asked[len(calibration.GAINS) :] == [(20, ("walking",))] * len(calibration.GAINS)


def test_a_model_without_references_has_nothing_to_find(tiny_model: MotionModel, dataset: Dataset) -> None:
    assert calibrated_gains(tiny_model.with_reference("none"), training_judge(dataset), 10) == {}


def moved_by_noise(model: MotionModel) -> MotionModel:
    """The model with a type that no velocity steers and no phase moves."""
    walking = model.types["walking"]
    assert walking.gait is not None and walking.gait.cycle_seconds == 0.0
    return model.with_types({"walking": {"steered": False}})


def test_types_that_noise_alone_moves_get_as_much_as_moves_them_as_recorded(
    tiny_model: MotionModel, dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Roll-outs whose speed is the recorded one times their noise, without references."""
    model = moved_by_noise(tiny_model)
    recorded = recorded_movements(training_judge(dataset).real, ["walking"])["walking"]

    def made(alone: MotionModel, moved: list[str], frames: int, judge: Judge) -> dict[str, Movement]:
        assert not alone.uses_references and moved == ["walking"]
        noise = alone.types["walking"].preset.noise_scale
        return {"walking": replace(recorded, speed=noise / 1.2 * recorded.speed)}

    monkeypatch.setattr(calibration, "made_movements", made)
    assert calibrated_noise(model, training_judge(dataset), 10) == {"walking": 1.2}
    assert calibrated_noise(model.with_reference("none"), training_judge(dataset), 10) == {}


def test_noise_of_its_own_is_for_roll_outs_without_references(
    tiny_model: MotionModel, tmp_path: Path
) -> None:
    model = with_presets(tiny_model, "noise_alone", {"cartwheel": 1.3})
    save_model(tmp_path / "m.safetensors", model)
    read = load_model(tmp_path / "m.safetensors")
    for kind, scale in (("cartwheel", 1.3), ("walking", read.types["walking"].preset.noise_scale)):
        assert read.types[kind].preset.noise_scale == tiny_model.types[kind].preset.noise_scale
        assert read.with_reference("none").types[kind].preset.noise_scale == scale
    assert read.types["walking"].preset.noise_alone is None


def test_training_ends_with_gains_and_noise_in_the_file(
    dataset_folder: Path, tmp_path: Path, tiny_options: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("motionkit.training.outcome.calibrated_noise", lambda *_, **__: {"cartwheel": 1.21})
    monkeypatch.setattr("motionkit.training.outcome.calibrated_gains", lambda *_, **__: {"cartwheel": 1.37})
    train(dataset_folder, tmp_path / "m.safetensors", tiny_options(steps=1, score_seconds=0.1), device="cpu")
    read = load_model(tmp_path / "m.safetensors").types["cartwheel"].preset
    assert read.noise_alone == 1.21
    assert read.reference_gain == 1.37
