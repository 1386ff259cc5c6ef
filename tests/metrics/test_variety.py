"""How far motions are apart, what they show of the recordings, and whether they repeat themselves."""

from __future__ import annotations

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.metrics.variety import (
    POSE_RATE,
    STRAY,
    Places,
    RecordingWindows,
    drawn_share,
    loop_seconds,
    mean_pose_gap,
    pose_gap,
)


def wandering(seconds: float, seed: int) -> Array:
    """Poses (T, 69) that wander smoothly and do not come back."""
    drawn = np.random.default_rng(seed).standard_normal((round(seconds * POSE_RATE), 69))
    return np.cumsum(drawn, axis=0)


def test_poses_are_as_far_apart_as_their_joints() -> None:
    poses = wandering(3.0, 0)
    moved = poses.reshape(-1, 23, 3) + np.array([3.0, 4.0, 0.0])
    assert pose_gap(poses, moved.reshape(-1, 69)) == pytest.approx(5.0)
    assert pose_gap(poses, moved.reshape(-1, 69)[:20]) == pytest.approx(5.0)
    assert mean_pose_gap([poses, poses, moved.reshape(-1, 69)]) == pytest.approx(10.0 / 3.0)
    assert mean_pose_gap([poses, poses[:5]]) is None
    with pytest.raises(MotionkitError, match="found 0"):
        pose_gap(poses, poses[:0])


def test_a_replay_is_found_with_its_length() -> None:
    recordings = [wandering(10.0, 1), wandering(8.0, 2), wandering(6.0, 3)]
    windows = RecordingWindows([[each] for each in recordings])
    replay = recordings[1][20:120]
    places = windows.places(replay)
    assert set(places.recordings.tolist()) == {1} and places.distances.max() < 1e-3
    assert places.poses.tolist() == [20 + 5 * i for i in range(len(places.poses))]
    assert places.longest_stretch() == pytest.approx(5.0)
    lengths = np.array([10.0, 8.0, 6.0])
    assert drawn_share([places], lengths) == pytest.approx(8.0 / 24.0)
    moved = replay.reshape(-1, 23, 3) + np.array([3.0, 4.0, 0.0])
    assert windows.places(moved.reshape(-1, 69)).distances == pytest.approx(5.0, abs=1e-3)
    mixed = np.concatenate([recordings[0][:60], recordings[2][:40]])
    assert windows.places(mixed).longest_stretch() == pytest.approx(3.0, abs=0.26)
    assert drawn_share([places, windows.places(mixed)], lengths) == 1.0


@pytest.mark.parametrize(("first", "again", "share"), [(100, 0, 0.0), (100, 60, 0.35), (60, 60, 0.0)])
def test_what_is_shown_again_after_a_while_counts_as_replayed(first: int, again: int, share: float) -> None:
    """100 poses last 5 s; what comes again sooner is no replay."""
    recording = wandering(10.0, 7)
    windows = RecordingWindows([[recording]])
    shown = np.concatenate([recording[:first], recording[:again]])
    assert windows.places(shown).replayed() == pytest.approx(share, abs=0.03)


@pytest.mark.parametrize(("astray", "again"), [(STRAY, True), (-STRAY, True), (STRAY + 1, False)])
def test_a_place_may_be_shown_again_a_little_astray(astray: int, again: bool) -> None:
    tracks, poses = np.zeros(30, np.int64), 100 * np.arange(30)
    poses[29] = poses[0] + astray
    assert (Places(tracks, tracks, poses, 0.0 * poses).replayed() > 0.0) == again


def test_a_recording_can_be_left_out_and_have_a_mirrored_track() -> None:
    first, second = wandering(6.0, 4), wandering(6.0, 5)
    windows = RecordingWindows([[first, -first], [second]])
    assert set(windows.places(-first).recordings.tolist()) == {0}
    assert windows.places(-first).longest_stretch() == pytest.approx(6.0)
    places = windows.places(first, without=0)
    assert set(places.recordings.tolist()) == {1} and places.distances.min() > 1.0
    # From a track to its mirror image is no way along a recording.
    there_and_back = np.concatenate([first[:60], -first[60:]])
    assert windows.places(there_and_back).longest_stretch() < 4.0
    with pytest.raises(MotionkitError, match="at least 10 poses"):
        RecordingWindows([[first[:9]]])


def test_a_motion_that_repeats_has_the_period_of_its_loop() -> None:
    part = wandering(10.7, 6)
    looped = np.concatenate([part] * 6)[: round(60 * POSE_RATE)]
    assert loop_seconds(looped).value == pytest.approx(10.7, abs=0.05)
    late = np.concatenate([wandering(8.0, 7), looped])[: round(60 * POSE_RATE)]
    assert loop_seconds(late).value == pytest.approx(10.7, abs=0.05)
    assert loop_seconds(np.zeros((1200, 69))).value is not None, "who stands still repeats it"
    free = loop_seconds(wandering(60.0, 8))
    assert free.value is None and free.reason == "no repetition within 30 s"
