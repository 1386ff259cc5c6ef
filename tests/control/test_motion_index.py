"""MotionIndex of recordings that suit a pose and a way."""

from __future__ import annotations

import numpy as np
import pytest

from model_changes import with_clips
from motionkit.arrays import Array
from motionkit.control.blending import LONGEST_BLEND
from motionkit.control.motion_index import STATE_FRAMES, MotionIndex, pose_state
from motionkit.control.recording_choice import MATCHING
from motionkit.control.reference_player import ReferencePlayer
from motionkit.features.control import future_trajectory
from motionkit.features.reference import EMBEDDING_COUNT
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import ReferenceClip


def walk(speed: float, frames: int = 200) -> ReferenceClip:
    """A recording that goes straight ahead at so many cm a frame, its poses all alike."""
    ground = np.zeros((frames, 3), np.float32)
    ground[:, 1] = speed * np.arange(frames)
    return ReferenceClip(
        np.zeros((frames + 30, EMBEDDING_COUNT), np.float32), ground, np.full((frames,), -1.0, np.float32)
    )


@pytest.fixture
def reference_clips() -> list[ReferenceClip]:
    return [walk(0.0), walk(1.0), walk(2.0)]


def way_of(reference_clip: ReferenceClip, at: int = 0) -> Array:
    return future_trajectory(reference_clip.ground, np.array([at]))[0]


def test_the_place_that_goes_the_way_is_found(reference_clips: list[ReferenceClip]) -> None:
    places = MotionIndex(reference_clips)
    for number, reference_clip in enumerate(reference_clips):
        found, at = places.nearest(pose_state(reference_clip, 0), way_of(reference_clip), least=60)
        assert found == number and at + 60 <= len(reference_clip)


def test_poses_count_beside_the_way(reference_clips: list[ReferenceClip]) -> None:
    reference_clips[1].poses[:, 3] = 9.0
    places = MotionIndex(reference_clips)
    state = np.zeros((len(STATE_FRAMES), EMBEDDING_COUNT), np.float32)
    state[:, 3] = 9.0
    assert places.nearest(state, way_of(reference_clips[2]), least=60)[0] == 1


def test_one_stays_unless_another_place_is_clearly_better(reference_clips: list[ReferenceClip]) -> None:
    places, way = MotionIndex(reference_clips), way_of(walk(1.6))
    stay = places.first[1] + 7
    assert places.nearest(pose_state(reference_clips[1], 7), way, 20, stay, gain=0.1) == (1, 7)
    assert places.nearest(pose_state(reference_clips[1], 7), way, 20, stay, gain=1.0)[0] == 2


def test_a_player_goes_over_to_what_suits_the_way(
    tiny_model: MotionModel, reference_clips: list[ReferenceClip]
) -> None:
    assert MATCHING.clearly < 1.0
    for number, reference_clip in enumerate(reference_clips):
        reference_clip.poses[:, 0] = 0.01 * number
    player = ReferencePlayer(with_clips(tiny_model, {"walking": reference_clips}))
    player.begin(
        "walking",
        np.zeros((len(STATE_FRAMES), EMBEDDING_COUNT), np.float32),
        trajectory=way_of(reference_clips[1]),
    )
    assert player.clip is reference_clips[1]
    frames = MATCHING.every + LONGEST_BLEND + 1
    slow, fast = (np.tile(way_of(reference_clips[n]), (frames, 1)) for n in (1, 2))
    player.play(len(slow), slow)
    assert player.clip is reference_clips[1], "nothing suits better"
    asked = player.play(len(fast), fast)
    assert player.clip is reference_clips[2]
    steps = np.diff(asked.reference[:, 0])
    assert float(asked.reference[-1, 0]) == pytest.approx(0.02)
    assert 0.0 <= float(steps.min()) and float(steps.max()) < 0.002, "gone over to little by little"


def test_strikes_are_not_left_for_a_better_way(
    tiny_model: MotionModel, reference_clips: list[ReferenceClip]
) -> None:
    reference_clips[1].phases[:100] = np.arange(100) / 100.0
    player = ReferencePlayer(with_clips(tiny_model, {"walking": reference_clips}))
    player.kind, player.clip, player.at = "walking", reference_clips[1], 1
    fast = np.tile(way_of(reference_clips[2]), (MATCHING.every + 60, 1))
    player.play(len(fast), fast)
    assert player.clip is reference_clips[1] and player.at == 1 + len(fast)


def test_the_same_second_is_not_played_again_and_again(tiny_model: MotionModel) -> None:
    """Poses that hardly differ on a way that suits none: every place is as good as the last."""
    slow = walk(0.0, 600)
    slow.poses[:, 0] = 1e-3 * np.arange(630)
    player = ReferencePlayer(with_clips(tiny_model, {"walking": [slow]}))
    player.kind, player.clip, player.at = "walking", slow, 0
    way = np.tile(way_of(walk(0.5)), (400, 1))
    player.play(400, way)
    assert player.at >= 400


def test_what_stands_is_no_place_to_go_over_to(reference_clips: list[ReferenceClip]) -> None:
    for number in (0, 2):
        reference_clips[number].poses[:, 0] = 0.01 * np.arange(230)
    found, _ = MotionIndex(reference_clips).nearest(
        np.zeros((len(STATE_FRAMES), EMBEDDING_COUNT), np.float32), way_of(reference_clips[1]), least=60
    )
    assert found != 1, "although it goes the way"
