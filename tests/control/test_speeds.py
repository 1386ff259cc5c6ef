"""Speeds of paths, within what recordings of a gait show."""

from __future__ import annotations

import numpy as np
import pytest

import motionkit as mk
from model_changes import with_clips
from motionkit.control.path import Path2D, shape_path
from motionkit.control.path_place import plan_route
from motionkit.control.speeds import check_speeds, other_speeds, part_speeds
from motionkit.errors import ControlError
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import ReferenceClip, recorded_speeds


def recording(speed: float, frames: int = 160) -> ReferenceClip:
    """A recording that goes straight ahead at a speed in cm/s."""
    ground = np.zeros((frames, 3), np.float32)
    ground[:, 1] = np.arange(frames) * speed / 60.0
    return ReferenceClip(np.zeros((frames + 30, 24), np.float32), ground, np.full(frames, -1.0, np.float32))


@pytest.fixture
def model(tiny_model: MotionModel) -> MotionModel:
    """A model whose walk is recorded at 100 and at 150 cm/s."""
    assert tiny_model.types["walking"].steered
    return with_clips(tiny_model, {"walking": [recording(100.0), recording(150.0)]}, gaits=True)


def line(speed: float | None, kind: str = "walking") -> Path2D:
    """A path of 4 m at a speed in m/s."""
    return shape_path("line", 4.0, [kind], speed)


def test_the_range_is_that_of_the_recordings_and_a_tenth_more() -> None:
    clips = [recording(100.0), recording(150.0), recording(900.0, 30)]
    assert recorded_speeds(clips, 60.0) == pytest.approx((90.0, 165.0), rel=1e-4)
    assert recorded_speeds(clips[2:], 60.0) is None, "less than a second tells no speed"
    assert recorded_speeds(clips[:1], 60.0) == pytest.approx((75.0, 125.0), rel=1e-4), "all alike"


@pytest.mark.parametrize(("asked", "gone"), [(1.2, 120.0), (0.3, 90.0), (0.05, 90.0), (5.0, 165.0)])
def test_a_gait_goes_as_its_recordings_do(model: MotionModel, asked: float, gone: float) -> None:
    assert part_speeds(model, line(asked)) == pytest.approx([gone], rel=1e-4)
    assert plan_route(model, line(asked)).speeds[50] == pytest.approx(gone, rel=1e-4)
    if asked == 1.2:
        assert other_speeds(model, line(asked)) == []
        check_speeds(model, line(asked))
        return
    said = "0.90 to 1.65 m/s by its recordings"
    expected = f"part 1: walking goes at {gone / 100:.2f} m/s instead of {asked:g}: {said}"
    assert other_speeds(model, line(asked)) == [expected]
    with pytest.raises(ControlError, match=f"part 1: expected .*{said}, found {asked:g} m/s"):
        check_speeds(model, line(asked))


@pytest.mark.parametrize(("asked", "fits"), [(2.4, True), (1.2, False)])
def test_on_a_rig_speeds_are_those_of_its_world(model: MotionModel, asked: float, fits: bool) -> None:
    """A body twice as large walks at twice the speed; both ways of asking say the same."""
    path = line(asked).scaled(0.5)
    if fits:
        assert other_speeds(model, path, 2.0) == []
        check_speeds(model, path, 2.0)
        return
    said = "1.80 to 3.30 m/s by its recordings"
    assert other_speeds(model, path, 2.0) == [f"part 1: walking goes at 1.80 m/s instead of 1.2: {said}"]
    with pytest.raises(ControlError, match=f"{said}, found 1.2 m/s"):
        check_speeds(model, path, 2.0)


def test_no_limits_without_a_gait_or_a_wish(model: MotionModel) -> None:
    usual = model.types["walking"].gait.speed
    assert part_speeds(model, line(None)) == pytest.approx([usual], rel=1e-4)
    assert part_speeds(model, line(5.0, "cartwheel")) == pytest.approx([500.0])
    assert other_speeds(model, line(5.0, "cartwheel")) == []
    slow = "part 1: cartwheel goes at 0.20 m/s instead of 0.05: at least 0.2 m/s on a path"
    assert other_speeds(model, line(0.05, "cartwheel")) == [slow]
    assert model.speed_range("idle") is None and model.speed_range("unknown") is None


def test_limits_stay_without_references(model: MotionModel) -> None:
    without = model.with_reference("none")
    assert without.speed_range("walking") == model.speed_range("walking") != None  # noqa: E711


def test_python_refuses_a_speed_where_it_is_told_to(model: MotionModel) -> None:
    with pytest.raises(ControlError, match="looks right"):
        mk.follow_path(line(0.3), model=model, strict=True)
