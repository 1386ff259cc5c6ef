"""Reference gains, found by the speed of roll-outs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from motionkit.data.dataset import Dataset
from motionkit.models.checkpoint import load_model
from motionkit.models.model import MotionModel
from motionkit.training import calibration
from motionkit.training.calibration import ENOUGH, GAINS, calibrated_gains, recorded_speeds, with_gains
from motionkit.training.trainer import train


@pytest.mark.parametrize(
    ("ratios", "gain"),
    [
        ((0.95, 1.2, 1.3), 1.0),  # as fast as 95 % of the recorded without more
        ((0.8, 0.9, 1.1), 1.62),  # between two that were tried
        ((0.5, 0.6, 0.7), 1.83),  # never as fast: 95 % of the fastest
        ((0.9, 0.9, 0.9), 1.0),  # no gain helps
    ],
)
def test_the_smallest_gain_that_is_as_fast_as_recorded(ratios: tuple[float, ...], gain: float) -> None:
    assert calibration._gain(np.array(ratios)) == pytest.approx(gain, abs=0.011)


def test_types_that_references_move_get_a_gain_by_their_speed(
    tiny_model: MotionModel, dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Roll-outs that move in proportion to their gain, half as fast as recorded at 1."""
    kinds = list(tiny_model.types)
    recorded = recorded_speeds(dataset, kinds)
    real = [recorded.get(kind, 0.0) for kind in kinds]
    assert recorded["running"] > recorded["walking"] > 2.0 * recorded["idle"]

    def speeds(model: MotionModel, frames: int, seeds: tuple[int, ...]) -> np.ndarray:
        gains = [kind.preset.reference_gain for kind in model.types.values()]
        return 0.6 * np.array(gains) * np.array(real)

    monkeypatch.setattr(calibration, "_speeds", speeds)
    found = calibrated_gains(tiny_model, dataset, 10)
    moved = {name for name, kind in tiny_model.types.items() if kind.reference_clips}
    assert {"walking", "cartwheel"} <= moved == set(found)
    assert all(gain == pytest.approx(ENOUGH / 0.6, abs=0.01) for gain in found.values())


def test_more_of_a_reference_moves_a_body_more(tiny_model: MotionModel, dataset: Dataset) -> None:
    gains = calibrated_gains(tiny_model, dataset, 20, seeds=(500,))
    assert gains and all(GAINS[0] <= gain <= GAINS[-1] for gain in gains.values())
    louder = with_gains(tiny_model, {"cartwheel": 2.0})
    assert louder.types["cartwheel"].preset.reference_gain == 2.0
    assert louder.types["walking"].preset == tiny_model.types["walking"].preset
    place = list(tiny_model.types).index("cartwheel")
    soft = calibration._speeds(with_gains(tiny_model, {"cartwheel": 1.0}), 20, (500,))[place]
    assert calibration._speeds(louder, 20, (500,))[place] != soft


def test_a_model_without_references_has_nothing_to_find(tiny_model: MotionModel, dataset: Dataset) -> None:
    assert calibrated_gains(tiny_model.with_reference("none"), dataset, 10) == {}


def test_training_ends_with_the_gains_in_the_file(
    dataset_folder: Path, tmp_path: Path, tiny_options: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("motionkit.training.trainer.calibrated_gains", lambda *_: {"cartwheel": 1.37})
    train(dataset_folder, tmp_path / "m.safetensors", tiny_options(steps=1, score_seconds=0.1), device="cpu")
    assert load_model(tmp_path / "m.safetensors").types["cartwheel"].preset.reference_gain == 1.37
