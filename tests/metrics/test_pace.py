from __future__ import annotations

import numpy as np
import pytest

from motionkit.metrics.pace import ground_acceleration, ground_velocity


def test_speed_and_braking_are_those_of_the_track() -> None:
    time = np.arange(121) / 60.0
    root = np.zeros((121, 3))
    root[:, 2] = 300.0 * time - 0.5 * 150.0 * time**2  # 3 m/s, braked by 1.5 m/s^2 to a stand
    root[:, 1] = 90.0 + 5.0 * np.sin(20.0 * time)  # heights do not count
    velocity = ground_velocity(root, 60.0)
    assert velocity[0] == pytest.approx([0.0, 2.85], abs=1e-6) and velocity[-1, 1] == pytest.approx(
        0.15, abs=1e-6
    )
    assert ground_acceleration(root, 60.0) == pytest.approx(np.full(97, 1.5), abs=1e-6)


def test_pace_is_that_over_a_fifth_of_a_second() -> None:
    root = np.zeros((100, 3))
    root[50:, 0] = 6.0
    for fps, frames in ((60.0, 12), (30.0, 6), (2.0, 1)):
        velocity = ground_velocity(root, fps)
        assert len(velocity) == 100 - frames and (velocity[:, 0] > 0).sum() == frames
        assert velocity[:, 0].max() == pytest.approx(0.06 * fps / frames)
        assert len(ground_acceleration(root, fps)) == 100 - 2 * frames
        assert ground_acceleration(root, fps).max() == pytest.approx(0.06 * (fps / frames) ** 2)
