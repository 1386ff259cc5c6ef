from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from motionkit.errors import MotionkitError, SkeletonError
from motionkit.metrics.report import PAIR_METRICS, MetricReport, evaluate_motion, placed_like
from motionkit.metrics.value import MetricSettings
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_from_yaw
from motionkit.motion.skeleton import Skeleton, canonical_skeleton

from .conftest import placed, swaying

ALONE = [
    "bm-euler",
    "bm-geodesic",
    "afs",
    "afs-ground",
    "skate-ratio",
    "jerk",
    "jerk-peak",
    "jerk-area",
    "penetration-mean",
    "penetration-max",
    "leaps",
    "turn-max",
    "planted-share",
    "hover-share",
    "lowest-feet",
    "lowest-hands",
    "lowest-head",
    "lowest-body",
    "flight-acceleration",
    "floor-height",
]


def values(report: MetricReport) -> dict[str, float | None]:
    return {row.id: row.motion.value for row in report.rows}


def test_one_motion_gives_what_one_can(motion: Motion) -> None:
    report = evaluate_motion(motion)
    assert [row.id for row in report.rows] == ALONE
    assert report.frames == 120 and report.notes == ()
    assert all(value is not None for value in values(report).values())


def test_a_motion_beside_itself_is_perfect(motion: Motion) -> None:
    report = evaluate_motion(motion, motion)
    assert [row.id for row in report.rows] == ALONE + list(PAIR_METRICS)
    for name, (_, best) in PAIR_METRICS.items():
        assert report.value(name) == pytest.approx(best, abs=1e-9)
    assert report.notes == ()
    ratios = {row.id: row.ratio for row in report.rows}
    assert ratios["bm-euler"] == ratios["jerk"] == 1.0
    assert ratios["mpjpe"] is None and ratios["floor-height"] is None and ratios["lowest-feet"] is None


def test_place_and_heading_do_not_matter(motion: Motion) -> None:
    here = values(evaluate_motion(motion))
    there = values(evaluate_motion(placed(motion, yaw=1.2, move=(500.0, 0.0, -80.0))))
    lifted = values(evaluate_motion(placed(motion, move=(0.0, 30.0, 0.0))))
    for name in ALONE:
        if name != "bm-euler":
            assert there[name] == pytest.approx(here[name], abs=2e-3, rel=1e-4), name
        if name not in ("floor-height", "afs-ground"):
            assert lifted[name] == pytest.approx(here[name], abs=2e-3), name
    assert lifted["floor-height"] == pytest.approx(here["floor-height"] + 30.0, abs=1e-3)


def test_a_pair_turned_together_does_not_change() -> None:
    a, b = swaying(seed=1), swaying(seed=2, speed=130.0)
    here = evaluate_motion(a, b)
    there = evaluate_motion(*(placed(m, yaw=-2.0, move=(9.0, 0.0, 7.0)) for m in (a, b)))
    for name in PAIR_METRICS:
        least = 1.0 / here.frames if name.startswith("location-") else 1e-3  # a frame may be at the limit
        assert there.value(name) == pytest.approx(here.value(name), abs=least), name


def test_a_path_beside_the_other_is_that_far_away(motion: Motion) -> None:
    report = evaluate_motion(placed(motion, move=(12.0, 0.0, 0.0)), motion)
    assert report.value("path-mean") == pytest.approx(12.0)
    assert report.value("path-coverage") == 0.0
    assert report.value("mpjpe") == pytest.approx(0.0, abs=1e-4)
    wide = evaluate_motion(placed(motion, move=(12.0, 0.0, 0.0)), motion, MetricSettings(path_tolerance=13.0))
    assert wide.value("path-coverage") == 1.0


def test_align_start_undoes_place_and_heading(motion: Motion) -> None:
    away = placed(motion, yaw=2.0, move=(300.0, 0.0, 50.0))
    assert evaluate_motion(away, motion).value("path-mean") > 100.0
    report = evaluate_motion(away, motion, align_start=True)
    assert report.value("path-mean") == pytest.approx(0.0, abs=1e-3)
    assert report.value("mpjpe") == pytest.approx(0.0, abs=1e-3)
    assert any("turned and moved" in note for note in report.notes)
    later = evaluate_motion(away, motion, skip=30, align_start=True)
    assert later.value("path-mean") == pytest.approx(0.0, abs=1e-3)
    assert placed_like(away, motion).root_positions == pytest.approx(motion.root_positions, abs=1e-3)
    raised = replace(
        motion, root_positions=motion.root_positions + np.float32([0.0, 20.0, 0.0])
    )  # heights stay
    assert placed_like(raised, motion).root_positions == pytest.approx(raised.root_positions, abs=1e-3)


def test_other_lengths_are_compared_over_the_common_frames(motion: Motion) -> None:
    report = evaluate_motion(motion.cut(0, 80), motion)
    assert report.frames == 80
    assert "ground truth has 120 frames, generated 80; compared over the first 80" in report.notes
    assert report.value("mpjpe") == 0.0


def test_other_rates_meet_at_60() -> None:
    fast, slow = swaying(frames=241, fps=120.0), swaying(frames=121, fps=60.0)
    report = evaluate_motion(fast, slow)
    assert report.frames == 121
    assert "generated motion: 120 fps, resampled to 60" in report.notes
    for row in report.rows:
        if row.ratio is not None and row.id != "skate-ratio":
            assert row.ratio == pytest.approx(1.0, abs=1e-3), row.id


def test_jerk_is_compared_at_the_lowest_rate_given() -> None:
    slow, fast = swaying(frames=61, fps=30.0), swaying(frames=121, fps=60.0)
    rows = {row.id: row for row in evaluate_motion(slow, fast).rows}
    assert rows["jerk"].motion.parameters == {"fps": 30.0}
    assert rows["jerk"].ratio == pytest.approx(1.0, abs=1e-3)
    assert rows["bm-geodesic"].ratio == pytest.approx(1.0, abs=0.01)


def test_skipped_frames_do_not_count(motion: Motion) -> None:
    spoiled = replace(motion, root_positions=motion.root_positions.copy())
    spoiled.root_positions[:20, 0] += 500.0
    assert evaluate_motion(spoiled, motion).value("path-mean") > 50.0
    report = evaluate_motion(spoiled, motion, skip=20)
    assert report.frames == 100 and report.value("path-mean") == 0.0
    assert report.value("jerk") == pytest.approx(values(evaluate_motion(motion.cut(20, 120)))["jerk"])


def test_frames_are_those_of_the_file_whatever_is_left_out(motion: Motion) -> None:
    """A turn into frame 100 of the ground truth, which is frame 70 of a motion that goes on after 30 frames."""
    truth = replace(motion, local_rotations=motion.local_rotations.copy())
    truth.local_rotations[100:, 2] = quat_from_yaw(np.array(2.0))
    made = truth.cut(30, 120)
    whole = {row.id: row.motion for row in evaluate_motion(truth).rows}["turn-max"]
    skipped = {row.id: row.motion for row in evaluate_motion(truth, skip=20).rows}["turn-max"]
    assert whole.parameters == skipped.parameters == {"joint": "LeftLeg", "frame": 100.0}
    row = {row.id: row for row in evaluate_motion(made, truth, skip=10, given=30).rows}["turn-max"]
    assert row.ground_truth is not None
    assert (row.motion.parameters["frame"], row.ground_truth.parameters["frame"]) == (70.0, 100.0)


def test_the_frame_of_a_flight_is_that_of_the_file(motion: Motion) -> None:
    places = motion.root_positions.copy()
    places[60:90, 1] += 60.0
    flying = replace(motion, root_positions=places)
    for skip in (0, 40):
        row = {row.id: row for row in evaluate_motion(flying, skip=skip).rows}["flight-acceleration"]
        assert row.motion.parameters["frame"] == 60.0


def test_a_given_floor_is_used(motion: Motion) -> None:
    report = evaluate_motion(motion, settings=MetricSettings(floor=200.0))
    assert report.value("floor-height") == 200.0
    assert report.value("penetration-max") > 100.0
    assert report.rows[-1].motion.parameters == {"floor": "given"}


def test_the_floor_of_the_ground_truth_holds_for_both(motion: Motion) -> None:
    lower = placed(motion, move=(0.0, -2.0, 0.0))
    pair = {row.id: row for row in evaluate_motion(lower, motion).rows}
    assert pair["floor-height"].motion.value == pytest.approx(pair["floor-height"].ground_truth.value - 2.0)
    floor = pair["floor-height"].ground_truth.value
    known = {row.id: row for row in evaluate_motion(lower, motion, MetricSettings(floor=floor)).rows}
    for name in ("afs", "penetration-mean", "planted-share", "lowest-feet"):
        assert pair[name].motion.value == known[name].motion.value, name
    assert pair["afs"].motion.value > pair["afs"].ground_truth.value
    assert pair["lowest-feet"].motion.value == pytest.approx(pair["lowest-feet"].ground_truth.value - 2.0)
    assert not any("standing toes" in note for note in evaluate_motion(lower, motion).notes)
    far = evaluate_motion(placed(motion, move=(0.0, 30.0, 0.0)), motion)
    assert any("measured from the latter" in note for note in far.notes)


def test_sliding_over_the_ground_takes_heights_above_zero(motion: Motion) -> None:
    low = evaluate_motion(motion, settings=MetricSettings(floor=0.0))
    assert low.value("afs") == low.value("afs-ground")
    lifted = evaluate_motion(placed(motion, move=(0.0, 30.0, 0.0)))
    assert lifted.value("afs-ground") == 0.0 and lifted.value("afs") > 0.0


def test_given_frames_begin_the_ground_truth_alone(motion: Motion) -> None:
    going_on = motion.cut(87, 120)
    assert evaluate_motion(going_on, motion).value("mpjpe") > 1.0
    report = evaluate_motion(going_on, motion, given=87)
    assert report.frames == 33 and report.value("mpjpe") == 0.0 and report.value("path-mean") == 0.0
    assert report.notes == ("the first 87 frames of the ground truth were given to the model",)
    later = evaluate_motion(going_on, motion, skip=10, given=87)
    assert later.frames == 23 and later.value("mpjpe") == 0.0
    with pytest.raises(MotionkitError, match="less the 119 given"):
        evaluate_motion(going_on, motion, given=119)


def test_short_motions_keep_what_they_can_give_and_say_why_not(motion: Motion) -> None:
    report = evaluate_motion(motion.cut(0, 5), motion)
    rows = {row.id: row for row in report.rows}
    assert rows["ssim-window"].motion.value is None
    assert rows["ssim-window"].motion.reason == "SSIM needs at least 12 frames, found 5"
    assert rows["mpjpe"].motion.value == 0.0


def test_other_bodies_are_remarked(motion: Motion) -> None:
    small = replace(motion, skeleton=canonical_skeleton(canonical_skeleton().offsets * 0.8))
    assert any("bodies differ" in note for note in evaluate_motion(small, motion).notes)


def test_numbers_are_plain(motion: Motion) -> None:
    out = evaluate_motion(motion, motion).as_dict()
    assert out["frames"] == 120 and out["fps"] == 60.0
    first = out["metrics"][0]
    assert first["id"] == "bm-euler" and first["ratio"] == 1.0 and first["value"] == first["ground_truth"]


def test_refusals(motion: Motion) -> None:
    with pytest.raises(MotionkitError, match="to measure, found 120 and 80, less the 80 skipped"):
        evaluate_motion(motion.cut(0, 80), motion, skip=80)
    with pytest.raises(MotionkitError, match="expected at least 2"):
        evaluate_motion(motion.cut(0, 1))
    with pytest.raises(MotionkitError, match="unknown metric 'fid'"):
        evaluate_motion(motion).value("fid")
    with pytest.raises(SkeletonError, match="the ground truth has 1"):
        bone = Skeleton(("Hips",), (-1,), np.zeros((1, 3), np.float32))
        evaluate_motion(motion, Motion(bone, motion.local_rotations[:, :1], motion.root_positions, 60.0))
    broken = replace(motion, root_positions=motion.root_positions.copy())
    broken.root_positions[7, 1] = float("nan")
    with pytest.raises(MotionkitError, match="not finite in frame 7"):
        evaluate_motion(broken)
    with pytest.raises(MotionkitError, match="expected more than 0"):
        evaluate_motion(replace(motion, fps=0.0))


@pytest.mark.parametrize("frames", [{"skip": -3}, {"given": -1}])
def test_frames_to_leave_out_are_not_negative(motion: Motion, frames: dict[str, int]) -> None:
    with pytest.raises(MotionkitError, match=r"expected 0 or more frames to skip and given frames"):
        evaluate_motion(motion, motion, **frames)


@pytest.mark.parametrize("words", [{"given": 30}, {"align_start": True}])
def test_what_needs_a_ground_truth_is_refused_without_one(motion: Motion, words: dict[str, Any]) -> None:
    with pytest.raises(MotionkitError, match="need a ground truth, found none"):
        evaluate_motion(motion, **words)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"floor": float("nan")}, "expected a finite floor, found nan"),
        ({"ssim_window": 0}, "expected ssim_window above 0, found 0"),
        ({"foot_height": float("inf")}, "expected foot_height above 0, found inf"),
    ],
)
def test_thresholds_are_numbers(words: dict[str, Any], said: str) -> None:
    with pytest.raises(MotionkitError, match=said):
        MetricSettings(**words)
