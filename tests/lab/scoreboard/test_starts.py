"""Feet of bodies that begin to go, or come to a stand."""

from __future__ import annotations

import numpy as np
import pytest

from motionkit.lab.scoreboard.starts import sliding_share, sliding_toes
from motionkit.metrics.body import STANDING_TOE, Body
from motionkit.motion.skeleton import FOOT_JOINTS


@pytest.mark.parametrize(
    ("speed", "height", "slides", "low"),
    [(10.0, 0.0, 0, 118), (25.0, 0.0, 118, 118), (25.0, 1.0, 118, 118), (25.0, 2.0, 0, 0)],
)
def test_low_toes_slide_from_a_speed_on(speed: float, height: float, slides: int, low: int) -> None:
    """A second of toes that go over the ground, so many cm above standing ones."""
    positions = np.zeros((60, 23, 3), np.float32)
    positions[..., 1] = 50.0
    positions[:, list(FOOT_JOINTS), 1] = STANDING_TOE + height
    positions[..., 2] = np.arange(60)[:, None] * speed / 60.0
    body = Body(np.zeros((60, 23, 4), np.float32), positions, np.zeros(60, np.float32), 60.0)
    assert sliding_toes(body) == (slides, low)


def test_recordings_that_are_shown_as_they_are_slide_as_recorded() -> None:
    """Of two standing toes none slides; of a gait's few low toes all do."""

    def body(speed: float, lifted: int) -> Body:
        positions = np.zeros((60, 23, 3), np.float32)
        positions[:, list(FOOT_JOINTS), 1] = STANDING_TOE
        positions[:lifted, list(FOOT_JOINTS), 1] = STANDING_TOE + 20.0
        positions[..., 2] = np.arange(60)[:, None] * speed / 60.0
        return Body(np.zeros((60, 23, 4), np.float32), positions, np.zeros(60, np.float32), 60.0)

    stand, gait = body(0.0, 0), body(100.0, 40)
    assert sliding_share([gait]) == 1.0 and sliding_share([stand]) == 0.0
    shown = [stand, gait, stand]
    assert sliding_share([stand, stand], [gait, gait], [stand]) == pytest.approx(sliding_share(shown))
    assert sliding_share(shown) == pytest.approx(40 / (2 * 118 + 40))
