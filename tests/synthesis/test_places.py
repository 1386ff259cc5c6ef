"""Places of recordings that suit a pose and a way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.features.control import future_trajectory
from motionkit.features.guide import OUTLINE_COUNT
from motionkit.models.checkpoint import MotionModel, Outline
from motionkit.synthesis.outline_player import CLEARLY, RECONSIDERED, OutlinePlayer
from motionkit.synthesis.places import STATE_FRAMES, Places, pose_state


def walk(speed: float, frames: int = 200) -> Outline:
    """A recording that goes straight ahead at so many cm a frame, its poses all alike."""
    ground = np.zeros((frames, 3), np.float32)
    ground[:, 1] = speed * np.arange(frames)
    return Outline(
        np.zeros((frames + 30, OUTLINE_COUNT), np.float32), ground, np.full((frames,), -1.0, np.float32)
    )


@pytest.fixture
def outlines() -> list[Outline]:
    return [walk(0.0), walk(1.0), walk(2.0)]


def way_of(outline: Outline, at: int = 0) -> Array:
    return future_trajectory(outline.ground, np.array([at]))[0]


def test_the_place_that_goes_the_way_is_found(outlines: list[Outline]) -> None:
    places = Places(outlines)
    for number, outline in enumerate(outlines):
        found, at = places.nearest(pose_state(outline, 0), way_of(outline), least=60)
        assert found == number and at + 60 <= len(outline)


def test_poses_count_beside_the_way(outlines: list[Outline]) -> None:
    outlines[1].poses[:, 3] = 9.0
    places = Places(outlines)
    state = np.zeros((len(STATE_FRAMES), OUTLINE_COUNT), np.float32)
    state[:, 3] = 9.0
    assert places.nearest(state, way_of(outlines[2]), least=60)[0] == 1


def test_one_stays_unless_another_place_is_clearly_better(outlines: list[Outline]) -> None:
    places, way = Places(outlines), way_of(walk(1.6))
    stay = places.first[1] + 7
    assert places.nearest(pose_state(outlines[1], 7), way, 20, stay, gain=0.1) == (1, 7)
    assert places.nearest(pose_state(outlines[1], 7), way, 20, stay, gain=1.0)[0] == 2


def test_a_player_goes_over_to_what_suits_the_way(tiny_model: MotionModel, outlines: list[Outline]) -> None:
    assert CLEARLY < 1.0
    for number, outline in enumerate(outlines):
        outline.poses[:, 0] = 0.01 * number
    player = OutlinePlayer(replace(tiny_model, outlines={"walking": outlines}))
    player.begin("walking", np.zeros((len(STATE_FRAMES), OUTLINE_COUNT), np.float32), way=way_of(outlines[1]))
    assert player.outline is outlines[1]
    slow, fast = (np.tile(way_of(outlines[n]), (RECONSIDERED + 20, 1)) for n in (1, 2))
    player.play(len(slow), slow)
    assert player.outline is outlines[1], "nothing suits better"
    asked = player.play(len(fast), fast)
    assert player.outline is outlines[2]
    steps = np.diff(asked.guide[:, 0])
    assert float(asked.guide[-1, 0]) == pytest.approx(0.02)
    assert 0.0 <= float(steps.min()) and float(steps.max()) < 0.002, "gone over to little by little"


def test_strikes_are_not_left_for_a_better_way(tiny_model: MotionModel, outlines: list[Outline]) -> None:
    outlines[1].phases[:100] = np.arange(100) / 100.0
    player = OutlinePlayer(replace(tiny_model, outlines={"walking": outlines}))
    player.kind, player.outline, player.at = "walking", outlines[1], 1
    fast = np.tile(way_of(outlines[2]), (RECONSIDERED + 60, 1))
    player.play(len(fast), fast)
    assert player.outline is outlines[1] and player.at == 1 + len(fast)


def test_the_same_second_is_not_played_again_and_again(tiny_model: MotionModel) -> None:
    """Poses that hardly differ on a way that suits none: every place is as good as the last."""
    slow = walk(0.0, 600)
    slow.poses[:, 0] = 1e-3 * np.arange(630)
    player = OutlinePlayer(replace(tiny_model, outlines={"walking": [slow]}))
    player.kind, player.outline, player.at = "walking", slow, 0
    way = np.tile(way_of(walk(0.5)), (400, 1))
    player.play(400, way)
    assert player.at >= 400


def test_what_stands_is_no_place_to_go_over_to(outlines: list[Outline]) -> None:
    for number in (0, 2):
        outlines[number].poses[:, 0] = 0.01 * np.arange(230)
    found, _ = Places(outlines).nearest(
        np.zeros((len(STATE_FRAMES), OUTLINE_COUNT), np.float32), way_of(outlines[1]), least=60
    )
    assert found != 1, "although it goes the way"
