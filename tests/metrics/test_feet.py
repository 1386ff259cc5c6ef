"""Floor, average foot sliding, foot skate and penetration."""

from __future__ import annotations

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.metrics.ground import average_foot_sliding, foot_skate_ratio, penetration
from motionkit.metrics.value import MetricSettings
from motionkit.motion.floor import floor_height

from .conftest import still_feet


def sliding(cm_per_frame: float, height: float = 0.0, joint: int = 1, frames: int = 61) -> Array:
    feet = still_feet(frames)
    feet[:, joint, 0] = 0.6 * cm_per_frame * np.arange(frames)
    feet[:, joint, 2] = -0.8 * cm_per_frame * np.arange(frames)
    feet[:, joint, 1] += height
    return feet


def test_floor_is_the_height_of_standing_toes_wherever_the_clip_stands() -> None:
    feet = still_feet()
    assert floor_height(feet) == 0.0
    feet[..., 1] += 17.5
    assert floor_height(feet) == 17.5


def test_floor_ignores_jumps_swings_and_single_sunken_frames() -> None:
    feet = still_feet(200)
    feet[60:110, :, 1] += 50.0  # a jump
    feet[120:150, 1, 1] += 8.0  # a lifted toe, the other stands
    feet[20, 1, 1] = -30.0  # one bad frame
    assert floor_height(feet) == 0.0


def test_floor_of_a_clip_that_never_stands_still_is_near_its_lowest_level() -> None:
    feet = still_feet(100)
    feet[..., 2] = np.arange(100)[:, None] * 5.0
    assert floor_height(feet) == 0.0
    assert floor_height(feet[:1]) == 0.0


def test_the_floor_of_a_short_run_is_not_the_height_of_its_feet_in_the_air() -> None:
    feet = still_feet(40)
    feet[..., 2] = 6.0 * np.arange(40)[:, None]  # 360 cm/s
    feet[..., 1] += 20.0 * np.abs(np.sin(0.3 * np.arange(40)))[:, None]
    assert floor_height(feet) < 2.0
    feet[20:26, 1, 2], feet[20:26, 1, 1] = 120.0, 0.5  # a toe stands, slow in four frames
    assert floor_height(feet) == 0.5


def test_afs_of_a_toe_sliding_on_the_floor() -> None:
    result = average_foot_sliding(sliding(2.0), floor=0.0)
    assert result.value == pytest.approx(2.0 / 4)  # one of four joints, weight 2 - 2^0
    assert result.parameters == {"foot_height_cm": 10.85, "toe_height_cm": 1.55, "floor_cm": 0.0}


@pytest.mark.parametrize(("height", "weight"), [(0.775, 2 - 2**0.5), (1.55, 0.0), (9.0, 0.0), (-3.0, 1.0)])
def test_afs_weight_falls_to_zero_at_the_height_limit_and_is_one_below_the_floor(
    height: float, weight: float
) -> None:
    result = average_foot_sliding(sliding(2.0, height), floor=0.0)
    assert result.value == pytest.approx(weight * 2.0 / 4)


def test_afs_of_a_foot_uses_the_limit_of_feet() -> None:
    weight = 2 - 2 ** (9.0 / 10.85)
    assert average_foot_sliding(sliding(2.0, joint=0), floor=0.0).value == pytest.approx(weight * 2.0 / 4)
    lower = MetricSettings(foot_height=9.0)
    assert average_foot_sliding(sliding(2.0, joint=0), 0.0, lower).value == pytest.approx(0.0)


def test_afs_counts_heights_above_the_floor_given() -> None:
    feet = sliding(2.0)
    feet[..., 1] += 40.0
    assert average_foot_sliding(feet, floor=40.0).value == pytest.approx(0.5)


def test_skate_ratio_counts_standing_toes_over_the_speed() -> None:
    assert foot_skate_ratio(sliding(2.0), 0.0).value == pytest.approx(0.5)  # 120 cm/s, one toe of two
    assert foot_skate_ratio(sliding(0.5), 0.0).value == 0.0  # 30 cm/s
    assert foot_skate_ratio(sliding(0.5), 0.0, MetricSettings(skate_speed=20.0)).value == pytest.approx(0.5)
    # A toe in the air is not a sample: only the standing one is left.
    assert foot_skate_ratio(sliding(2.0, height=20.0), 0.0).value == 0.0


def test_penetration() -> None:
    feet = still_feet(100)
    feet[10:20, 3, 1] = -4.0
    mean, largest = penetration(feet, floor=0.0)
    assert (mean.value, largest.value) == pytest.approx((0.4, 4.0))
    assert [value.value for value in penetration(still_feet(), 0.0)] == [0.0, 0.0]


def test_refusals() -> None:
    one, none = still_feet(1), still_feet(0)
    for refused in (
        lambda: floor_height(none),
        lambda: average_foot_sliding(one, 0.0),
        lambda: foot_skate_ratio(one, 0.0),
        lambda: foot_skate_ratio(still_feet(), -50.0),
        lambda: penetration(none, 0.0),
    ):
        with pytest.raises(MotionkitError):
            refused()
