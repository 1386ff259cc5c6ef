"""Recordings in reference_clip, played as references, and the ways of recorded performances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from model_changes import with_clips
from motionkit.arrays import Array, lerp
from motionkit.control.blending import LONGEST_BLEND, SHORTEST_BLEND, Crossfade
from motionkit.control.character_start import last_poses, last_speed
from motionkit.control.momentum import CHANGE
from motionkit.control.motion_index import STATE_FRAMES
from motionkit.control.plan import whole_performances
from motionkit.control.recording_choice import GAIT, drawn_evenly
from motionkit.control.reference_controls import RECORDED_SHARE
from motionkit.control.reference_player import ReferencePlayer
from motionkit.control.script import TypePart
from motionkit.errors import ControlError
from motionkit.features.control import future_trajectory, straight_trajectory
from motionkit.features.reference import (
    BEFORE_EVENT,
    EMBEDDING_COUNT,
    PAUSE,
    REFERENCE_COUNT,
    reference_signal,
)
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind, ReferenceClip, recorded_rhythm, recorded_velocity
from planned import controls_of

NEAR = np.zeros((len(STATE_FRAMES), EMBEDDING_COUNT), np.float32)


@pytest.fixture
def flips(tiny_model: MotionModel) -> MotionModel:
    assert tiny_model.kind("cartwheel") is MotionKind.PERFORMANCE, (
        "the tiny dataset has a type that turns over"
    )
    return tiny_model


def recording(frames: int, phases: Array | None = None, first: float = 0.0) -> ReferenceClip:
    """A reference clip whose poses count frames."""
    poses = np.zeros((frames + 30, EMBEDDING_COUNT), np.float32)
    poses[:, 0] = first + np.arange(frames + 30)
    return ReferenceClip(
        poses,
        np.zeros((frames, 3), np.float32),
        np.full((frames,), -1.0, np.float32) if phases is None else phases,
    )


def test_the_way_counts_only_while_a_performance_is_asked_for(
    flips: MotionModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("motionkit.control.planned_controls.carried_over", lambda asked, *speeds: asked)
    model = flips.with_types({"walking": {"steered": False}})
    parts = [TypePart("walking", 1.0), TypePart("cartwheel", 0.5), TypePart("walking", 0.5)]
    asked = controls_of(model, parts, NEAR)
    assert asked.trajectory.shape == (120, 24) and asked.reference.shape == (120, REFERENCE_COUNT)
    assert asked.trajectory_mask.tolist() == [0.0] * 60 + [1.0] * 30 + [0.0] * 30
    assert asked.reference_gain.tolist() == pytest.approx(
        [1.0] * 60 + [flips.types["cartwheel"].preset.reference_gain] * 30 + [1.0] * 30
    )
    reference_clip = flips.types["cartwheel"].reference_clips[0]
    frames = np.arange(30)
    assert np.array_equal(asked.trajectory[60:90], future_trajectory(reference_clip.ground, frames))
    assert np.array_equal(asked.phase[60:90], reference_clip.phases[:30])
    # A performance begins without a blend.
    assert np.array_equal(asked.reference[60:90], reference_signal(reference_clip.poses, frames))


def test_a_change_of_type_carries_the_speed_over(tiny_model: MotionModel) -> None:
    """A run that goes over into balancing on one leg brakes; what begins with that has nothing to brake."""
    run, still = recording(300), recording(300)
    run.ground[:, 1] = np.arange(300) * 5.0
    model = with_clips(tiny_model, {"running": [run], "idle": [still]})
    model = model.with_types({"idle": {"steered": False}})
    parts = [TypePart("running", 1.0), TypePart("idle", 2.0)]
    asked = controls_of(model, parts, NEAR)
    braking = asked.trajectory_mask[60:].sum()
    assert 300.0 / CHANGE - 0.1 < braking / 60.0 < 300.0 / CHANGE + 0.1
    assert asked.trajectory[60, 1] > 3.5 * 10 and not asked.trajectory_mask[:60].any()
    assert not controls_of(model, parts[1:], NEAR).trajectory_mask.any()


@pytest.mark.parametrize(("apart", "blend"), [(8.0, SHORTEST_BLEND), (30.0, 30), (1000.0, LONGEST_BLEND)])
def test_references_are_blended_at_the_pace_of_the_clip_entered(
    tiny_model: MotionModel, apart: float, blend: int
) -> None:
    """Clips that move by 1 a frame, which are so far apart where one is left for the other."""
    model = with_clips(tiny_model, {"walking": [recording(300)], "running": [recording(300)]})
    walking = model.types["walking"].reference_clips[0]
    running = model.types["running"].reference_clips[0]
    player = ReferencePlayer(model)
    player.begin("walking", NEAR)
    player.at = 100
    player.begin("running")
    entered = player.at
    running.poses[:, 0] += walking.poses[100, 0] + apart - running.poses[entered, 0]
    player.left = Crossfade(walking, 100, running, entered)
    shown = player.play(70).reference[:, 0]
    alone = reference_signal(running.poses, np.arange(entered, entered + 70))[:, 0]
    assert np.flatnonzero(shown != alone).tolist() == list(range(blend))
    assert shown[0] == walking.poses[105, 0]
    assert float(np.diff(shown).max()) < 1.5 * (1.0 + apart / blend)


def test_another_performance_follows_after_a_pause_that_leads_over(flips: MotionModel) -> None:
    first = flips.types["cartwheel"].reference_clips[0]
    shifted = replace(first, poses=first.poses + np.float32(0.01))
    model = with_clips(flips, {"cartwheel": [first, shifted]})
    length = len(first)
    asked = controls_of(model, [TypePart("cartwheel", (3 * length + 2 * PAUSE) / flips.fps)], NEAR)
    starts = [0, length + PAUSE, 2 * (length + PAUSE)]
    for start, clip in zip(starts, (first, shifted, first), strict=True):
        played = slice(start, start + length)
        assert np.array_equal(asked.reference[played], reference_signal(clip.poses, np.arange(length)))
        assert np.array_equal(asked.phase[played], clip.phases)
    pause = slice(length, length + PAUSE)
    assert (asked.phase[pause] < 0.0).all() and (asked.trajectory_mask[pause] == 1.0).all()
    way = asked.reference[length + PAUSE] - asked.reference[length - 1]
    steps = np.diff(asked.reference[length - 1 : length + PAUSE], axis=0)
    assert float(np.linalg.norm(steps, axis=1).max()) < 1.5 * float(np.linalg.norm(way)) / PAUSE + 1e-4
    assert flips.phase_seconds("cartwheel") == pytest.approx(length / flips.fps)


def test_a_performance_begins_after_another_one_by_a_pause(flips: MotionModel) -> None:
    """What stands at its end would be over its hands in a few frames."""
    model = replace(flips, types={**flips.types, "jumping-l": flips.types["cartwheel"]})
    clip = flips.types["cartwheel"].reference_clips[0]
    model, length = with_clips(model, {"cartwheel": [clip], "jumping-l": [clip]}), len(clip)
    seconds = length / flips.fps
    parts = [TypePart("cartwheel", seconds), TypePart("jumping-l", seconds), TypePart("idle", 1.0)]
    whole = whole_performances(model, parts)
    assert [round(part.seconds * flips.fps) for part in whole] == [length, PAUSE + length, 60]
    asked = controls_of(model, whole, NEAR)
    assert (asked.phase[length : length + PAUSE] < 0.0).all()
    assert np.array_equal(asked.phase[length + PAUSE : 2 * length + PAUSE], clip.phases)
    # No pause where the first is not shown to its end, and none is asked for where there is time.
    short = [TypePart("cartwheel", 0.5 * seconds), TypePart("jumping-l", seconds), TypePart("idle", 1.0)]
    assert [part.seconds for part in whole_performances(model, short)] == pytest.approx(
        [part.seconds for part in short], abs=1.0 / flips.fps
    )
    assert (controls_of(model, short, NEAR).phase[round(0.5 * length) : length] >= 0.0).all()
    long = [TypePart("cartwheel", seconds), TypePart("jumping-l", seconds + 1.0), TypePart("idle", 1.0)]
    assert sum(part.seconds for part in whole_performances(model, long)) == pytest.approx(2.0 * seconds + 2.0)


def test_a_performance_to_the_other_side_is_not_taken_for_the_one_that_was_begun(flips: MotionModel) -> None:
    first = flips.types["cartwheel"].reference_clips[0]
    other = replace(first, poses=-first.poses - np.float32(5.0))
    model = with_clips(flips, {"cartwheel": [first, other]})
    for clip in (first, other):
        near = clip.poses[np.maximum(30 - np.array(STATE_FRAMES), 0)]
        for choice in range(4):
            player = ReferencePlayer(model, choice)
            player.begin("cartwheel", near, behind=30)
            assert player.clip is clip and player.at == 30


def test_first_part_goes_on_from_its_seed_and_choice_picks_a_recording(flips: MotionModel) -> None:
    reference_clips, parts = flips.types["cartwheel"].reference_clips, [TypePart("cartwheel", 10 / flips.fps)]
    asked = controls_of(flips, parts, NEAR, behind=5)
    assert np.array_equal(asked.phase, reference_clips[0].phases[5:15])
    other = controls_of(flips, parts, NEAR, choice=1)
    assert np.array_equal(other.reference, reference_signal(reference_clips[1].poses, np.arange(10)))
    again = controls_of(flips, parts, NEAR, choice=len(reference_clips))
    assert np.array_equal(again.reference, reference_signal(reference_clips[0].poses, np.arange(10)))


def test_a_model_without_guides_gives_none(flips: MotionModel) -> None:
    asked = controls_of(replace(flips, uses_references=False), [TypePart("walking", 1.0)], NEAR)
    assert not asked.reference_gain.any()
    unknown = with_clips(flips, {})
    asked = controls_of(unknown, [TypePart("walking", 1.0)], NEAR)
    assert not asked.reference_gain.any() and not asked.reference.any() and float(asked.phase.max()) == -1.0


def test_a_recording_is_entered_where_its_pose_is_most_alike(tiny_model: MotionModel) -> None:
    model = with_clips(tiny_model, {"walking": [recording(200)]})
    player = ReferencePlayer(model, choice=3)
    near = NEAR.copy()
    near[:, 0] = 50.0 - np.array(STATE_FRAMES)
    player.begin("walking", near)
    assert abs(player.at - 50) < 20, "one of a few places drawn"
    at = player.at
    first = player.play(40)
    assert first.reference[:, 0].tolist() == [at + 5 + i for i in range(40)]
    rest = player.play(400)
    assert len(rest.phase) == 400, "another part of it follows"


def test_all_recordings_are_played_before_one_is_again(tiny_model: MotionModel) -> None:
    clips = [recording(150, first=1000.0 * i) for i in range(6)]
    model = with_clips(tiny_model, {"walking": clips})
    entered = []
    for choice in range(4):
        player = ReferencePlayer(model, choice)
        player.begin("walking", NEAR)
        order = []
        for _ in range(6):
            assert player.clip is not None
            order.append(next(i for i, clip in enumerate(clips) if clip is player.clip))
            player.at = 0
            player.play(len(player.clip))
            player.begin("walking")
        assert sorted(order) == list(range(6))
        entered.append(tuple(order))
    assert len(set(entered)) > 1, "each choice has an order of its own"


def test_the_first_choice_begins_with_the_most_typical_clip(tiny_model: MotionModel) -> None:
    for kind, known in tiny_model.types.items():
        player = ReferencePlayer(tiny_model, choice=0)
        player.begin(kind)
        entered = [clip for clip, _ in player.recordings.entry_frames(kind, known.reference_clips)]
        assert player.clip is (known.reference_clips[0] if tiny_model.kind(kind).phased else entered[0]), kind


def test_successive_choices_draw_evenly() -> None:
    for number in (1, 2, 3):
        some = [drawn_evenly([7] * 30, choice, number) for choice in range(992, 1012)]
        assert len(set(some)) >= 18, "of thirty; twenty random draws show fifteen"
    large = [drawn_evenly([1, 0, 3], choice, 1) for choice in range(400)]
    assert large.count(1) == 0 and large.count(0) == pytest.approx(100, abs=4)
    assert len({drawn_evenly([1] * 8, 0, number) for number in range(1, 9)}) >= 6, (
        "and so do draws of one choice"
    )


def test_what_stands_is_not_entered(tiny_model: MotionModel) -> None:
    """Whoever asks for a dance and stands would find a dancer who stands most alike."""
    dance = recording(400)
    dance.poses[:200, 0] = 0.0
    player = ReferencePlayer(with_clips(tiny_model, {"walking": [dance]}), choice=1)
    player.begin("walking", NEAR)
    assert player.at > 80, "most of the two seconds that movement is averaged over lie beyond 200"


def test_gaits_are_entered_anywhere_else_still_clips_nowhere_and_calm_and_lively_ones_as_they_are(
    tiny_model: MotionModel,
) -> None:
    clips = [recording(400), recording(110), recording(110), recording(110)]
    for clip, pace in zip(clips, (4.0, 0.5, 9.0, 1.5), strict=True):
        clip.poses[:, 0] = pace * np.arange(len(clip.poses))
    player = ReferencePlayer(with_clips(tiny_model, {"walking": clips}))
    player.begin("walking", NEAR)
    entered = {id(clip): frames for clip, frames in player.recordings.entry_frames("walking", clips)}
    assert entered.keys() == {id(clips[0]), id(clips[2]), id(clips[3])}
    for other in clips[2:]:
        assert 0 < len(entered[id(other)]) <= 20, "those that a second and a half follow"
    gait = ReferencePlayer(with_clips(tiny_model, {"walking": clips}, gaits=True))
    gait.begin("walking", NEAR)
    last = [frames[-1] for _, frames in gait.recordings.entry_frames("walking", clips)]
    assert last == [len(clip) - round(GAIT.seconds * 60.0) - 1 for clip in clips]


@pytest.mark.parametrize("slow", [0.2, 0.9])
def test_gaits_leave_a_clip_before_it_brakes(tiny_model: MotionModel, slow: float) -> None:
    """Steps of 5 cm a frame; from frame 200 on of less, which brakes or is a calmer walk."""
    clip, other = recording(300), recording(300, first=1000.0)
    steps = np.full(300, 5.0)
    other.ground[:, 1] = np.cumsum(steps)
    steps[200:] *= slow
    clip.ground[:, 1] = np.cumsum(steps)
    player = ReferencePlayer(with_clips(tiny_model, {"walking": [clip, other]}, gaits=True))
    player.begin("walking", NEAR)
    shown = player.model.types["walking"].reference_clips[0]
    entered = dict((id(each), frames) for each, frames in player.recordings.entry_frames("walking", [shown]))[
        id(shown)
    ]
    brakes = slow < 0.5
    assert entered[-1] < (200 if brakes else 300) - round(GAIT.seconds * 60.0)
    player._jump((shown, 100))
    assert player.leaves <= 200 if brakes else player.leaves == 300
    player.play(150)
    assert brakes or (player.clip, player.at) == (shown, 250)


def test_gaits_leave_a_clip_before_its_last_pose_is_held(tiny_model: MotionModel) -> None:
    clip = recording(100)
    clip.poses[100:] = clip.poses[99]
    assert clip.recorded == 100
    player = ReferencePlayer(with_clips(tiny_model, {"walking": [clip]}, gaits=True))
    player.begin("walking", NEAR)
    player._jump((player.model.types["walking"].reference_clips[0], 10))
    assert player.leaves == 100 - GAIT.ahead


@pytest.mark.parametrize("strikes", [False, True])
def test_clips_are_left_where_they_have_been_played(tiny_model: MotionModel, strikes: bool) -> None:
    """Played from frame 400 on; a strike there is shown to its end."""
    phases = np.full((600,), -1.0, np.float32)
    phases[380:440] = np.arange(60) / 60.0 if strikes else -1.0
    clip, other = recording(600, phases), recording(600, first=1000.0)
    player = ReferencePlayer(with_clips(tiny_model, {"running": [clip, other]}))
    player.begin("running", NEAR)
    shown = player.model.types["running"].reference_clips[0]
    player.recordings.played.forget([shown])
    player.recordings.played.mark(shown, 400, 200)
    player._jump((shown, 100))
    assert player.leaves == (440 if strikes else 400)
    player.play(player.leaves - 100)
    assert player.clip is shown
    player.play(1)
    assert (player.clip, player.at) != (shown, player.leaves + 1)


def test_a_gait_that_is_slow_all_along_brakes_nowhere(tiny_model: MotionModel) -> None:
    fast, slow = recording(300), recording(300)
    fast.ground[:, 1], slow.ground[:, 1] = 8.0 * np.arange(300), 0.5 * np.arange(300)
    player = ReferencePlayer(with_clips(tiny_model, {"walking": [fast, slow]}, gaits=True))
    player.begin("walking", NEAR)
    for _, frames in player.recordings.entry_frames("walking", player.model.types["walking"].reference_clips):
        assert frames == list(range(300 - round(GAIT.seconds * 60.0)))


def test_gaits_go_where_their_recordings_went(tiny_model: MotionModel) -> None:
    """Also while one recording fades into another; a model that was not trained with references goes as it likes."""
    clips = {"walking": [recording(300)], "running": [recording(300)]}
    for kind, pace in (("walking", 2.0), ("running", 5.0)):
        clips[kind][0].ground[:, 1] = pace * np.arange(300)
    model = with_clips(tiny_model, clips, gaits=True)
    player = ReferencePlayer(model)
    player.begin("walking", NEAR)
    walked = player.play(20)
    player.begin("running")
    ran = player.play(100)
    slow, fast = (straight_trajectory((0.0, 60.0 * pace), 60.0) for pace in (2.0, 5.0))
    assert np.allclose(walked.trajectory, slow, atol=1e-3) and (walked.trajectory_mask == 1.0).all()
    assert np.allclose(ran.trajectory[0], slow, atol=1e-3) and np.allclose(
        ran.trajectory[-1], fast, atol=1e-3
    )
    ahead = ran.trajectory[:, 1]
    assert (np.diff(ahead) > -1e-3).all() and float(np.diff(ahead).max()) < 1.5 * (
        ahead[-1] - ahead[0]
    ) / SHORTEST_BLEND
    free = ReferencePlayer(replace(model, uses_references=False))
    free.begin("walking", NEAR)
    assert not free.play(20).trajectory_mask.any()


def test_a_strike_is_entered_shortly_before_it(tiny_model: MotionModel) -> None:
    phases = np.full((300,), -1.0, np.float32)
    phases[100:140] = np.arange(40) / 40.0
    model = with_clips(tiny_model, {"walking": [recording(300, phases)]})
    player = ReferencePlayer(model)
    player.begin("walking")
    assert player.at == 100 - BEFORE_EVENT
    assert player.event_frames() == BEFORE_EVENT + 40
    asked = player.play(BEFORE_EVENT + 41)
    assert float(asked.phase[BEFORE_EVENT]) == 0.0 and float(asked.phase[-1]) == -1.0
    assert not asked.trajectory_mask.any(), "only whole performances bring their way along"


def test_a_clip_that_is_left_before_it_is_reached_fades_with_what_it_faded_from(
    tiny_model: MotionModel,
) -> None:
    clips = {name: [recording(400, first=first)] for name, first in (("walking", 0.0), ("running", 2000.0))}
    player = ReferencePlayer(with_clips(tiny_model, clips))
    shown = []
    for kind in ("walking", "running", "walking", "running"):
        player.begin(kind)
        shown.append(player.play(20).reference[:, 0])
    steps = np.abs(np.diff(np.concatenate(shown)))
    assert float(steps.max()) < 1.5 * 2500.0 / LONGEST_BLEND


def test_types_that_change_in_every_frame_leave_no_chain_of_clips(tiny_model: MotionModel) -> None:
    """As a client may ask for: thousands of clips that fade into one another would be too deep to follow."""
    clips = {name: [recording(400, first=first)] for name, first in (("walking", 0.0), ("running", 2000.0))}
    player = ReferencePlayer(with_clips(tiny_model, clips))
    for frame in range(1500):
        player.begin(("walking", "running")[frame % 2])
        player.play(1)
    depth, left = 0, player.left
    while left is not None:
        depth, left = depth + 1, left.before
    assert 1 < depth <= LONGEST_BLEND + 1


def test_jumps_that_fill_their_clips_are_not_blended_but_follow_after_a_pause(
    tiny_model: MotionModel,
) -> None:
    phases = np.arange(60, dtype=np.float32) / 50.0
    phases[50:] = -1.0
    hops = [recording(60, phases, first) for first in (0.0, 500.0)]
    player = ReferencePlayer(with_clips(tiny_model, {"walking": hops}))
    player.begin("walking")
    first, second = (hops[0], hops[1]) if player.clip is hops[0] else (hops[1], hops[0])
    at = player.at
    before = player.play(60 - at)
    parts = [player.play(1) for _ in range(PAUSE)]
    after = player.play(30)
    assert before.reference[-1, 0] == first.poses[64, 0], "the first is played to its end"
    assert all(part.phase[0] == -1.0 and part.trajectory_mask[0] == 0.0 for part in parts)
    entered = round(float(after.phase[0]) * 50)
    between = [float(part.reference[0, 0]) for part in parts]
    ends = first.poses[64, 0], second.poses[entered + 5, 0]
    assert between == pytest.approx(np.linspace(*ends, PAUSE + 1)[1:].tolist(), abs=0.01)
    assert np.array_equal(
        after.reference, reference_signal(second.poses, np.arange(entered, entered + 30))
    ), "and the second is shown without any of the first"


def test_the_same_choice_plays_the_same(tiny_model: MotionModel) -> None:
    plays = [controls_of(tiny_model, [TypePart("running", 8.0)], NEAR, choice=c).reference for c in (4, 4, 5)]
    assert np.array_equal(plays[0], plays[1]) and not np.array_equal(plays[0], plays[2])


def test_last_poses_are_those_of_the_last_frames(tiny_model: MotionModel) -> None:
    features = tiny_model.types["walking"].start_poses[0].features
    features = np.concatenate([features, np.flip(features, 0)])
    before = [-1 - frames for frames in STATE_FRAMES]
    assert np.allclose(last_poses(tiny_model, features), tiny_model.pose_embedding.of(features[before]))
    first = tiny_model.pose_embedding.of(features[[1, 0, 0, 0]])
    assert STATE_FRAMES[:2] == (0, 5) and np.allclose(last_poses(tiny_model, features[:2]), first)


@pytest.mark.parametrize("frames", [1, 2, 3, 91, 92])
def test_recordings_of_a_few_frames_are_entered_too(tiny_model: MotionModel, frames: int) -> None:
    reference_clip = recording(frames)
    reference_clip.poses[:, 0] = reference_clip.poses[:, 0] ** 2  # no two places move as much
    player = ReferencePlayer(with_clips(tiny_model, {"walking": [reference_clip]}))
    player.begin("walking", NEAR)
    assert player.clip is reference_clip and 0 <= player.at < frames
    assert len(player.play(10).phase) == 10


def hop(speed: float) -> ReferenceClip:
    """A hop of 40 frames in the middle of 100, straight ahead at a speed in cm/s."""
    phases = np.full(100, -1.0, np.float32)
    phases[30:70] = np.arange(40) / 40
    made = recording(100, phases)
    made.ground[:, 1] = np.arange(100, dtype=np.float32) * np.float32(speed / 60.0)
    return made


@pytest.mark.parametrize(("speed", "suited"), [(0.0, {0, 1}), (160.0, {1, 2}), (900.0, {3})])
def test_a_jump_is_about_as_fast_as_the_body(tiny_model: MotionModel, speed: float, suited: set[int]) -> None:
    clips = [hop(0.0), hop(50.0), hop(220.0), hop(300.0)]
    model = with_clips(tiny_model, {"jumping-l": clips})
    entered = set()
    for choice in range(20):
        player = ReferencePlayer(model, choice)
        player.begin("jumping-l", NEAR, speed=speed)
        entered |= {n for n, clip in enumerate(clips) if clip is player.clip}
        player.play(200)
        now = {n for n, clip in enumerate(clips) if clip is player.clip}
        assert now <= ({0, 1} if speed < 100.0 else {0, 1, 2, 3})
    assert entered == suited


def test_without_a_known_speed_any_jump_is_drawn(tiny_model: MotionModel) -> None:
    clips = [hop(0.0), hop(300.0)]
    model = with_clips(tiny_model, {"jumping-l": clips})
    players = [ReferencePlayer(model, choice) for choice in range(8)]
    for player in players:
        player.begin("jumping-l", NEAR)
    assert {id(player.clip) for player in players} == {id(clip) for clip in clips}


def test_the_speed_of_the_last_frames(tiny_model: MotionModel) -> None:
    running, idle = (tiny_model.types[kind].start_poses[0].features for kind in ("running", "idle"))
    assert last_speed(tiny_model, running) > 150.0 > 20.0 > last_speed(tiny_model, idle)
    assert last_speed(tiny_model, running[:1]) == 0.0


@pytest.mark.parametrize("share", [0.0, RECORDED_SHARE])
def test_a_way_asked_for_is_met_by_the_recordings_own(tiny_model: MotionModel, share: float) -> None:
    reference_clip = recording(200)
    reference_clip.ground[:, 1] = np.arange(200.0, dtype=np.float32)  # straight ahead, 1 cm a frame
    asked = np.zeros((40, 24), np.float32)
    asked[:, 12:] = np.tile(np.float32([0.0, 1.0]), 6)
    asked[:, 0:12:2] = np.arange(10.0, 70.0, 10.0, dtype=np.float32)  # to the side
    player = ReferencePlayer(with_clips(tiny_model, {"walking": [reference_clip]}), recorded_share=share)
    player.begin("walking", NEAR, trajectory=asked[0])
    shown = player.play(40, asked)
    own = future_trajectory(reference_clip.ground, np.arange(player.at - 40, player.at))
    assert np.allclose(shown.trajectory, lerp(asked, own, share), atol=1e-4)
    assert shown.trajectory_mask.tolist() == [1.0] * 40
    assert player.play(3).trajectory_mask.tolist() == [0.0] * 3


def test_a_performance_goes_the_way_asked_for(flips: MotionModel) -> None:
    player = ReferencePlayer(flips)
    player.begin("cartwheel")
    length = len(flips.types["cartwheel"].reference_clips[0])
    asked = np.random.default_rng(0).random((2 * length, 24), np.float32)
    shown = player.play(2 * length, asked)
    assert float(shown.trajectory_mask.min()) == 1.0
    between = slice(length, length + PAUSE)
    assert np.array_equal(shown.trajectory[between], asked[between])


def test_without_recordings_a_clock_counts_the_phase(flips: MotionModel) -> None:
    alone = flips.with_reference("none")
    assert alone.phase_seconds("cartwheel") == flips.phase_seconds("cartwheel")
    length = round(alone.phase_seconds("cartwheel") * alone.fps)
    parts = [TypePart("walking", 0.5), TypePart("cartwheel", (length + PAUSE + 10) / alone.fps)]
    asked = controls_of(alone, parts, NEAR)
    assert not asked.reference.any() and not asked.trajectory_mask[30:].any()
    assert (asked.phase[:30] == -1.0).all()
    wheel = asked.phase[30:]
    assert wheel[:length] == pytest.approx(np.arange(length) / length)
    assert (wheel[length : length + PAUSE] == -1.0).all() and wheel[length + PAUSE] == 0.0
    begun = controls_of(alone, parts[1:], NEAR, behind=7)
    assert begun.phase[0] == pytest.approx(7 / length)
    player = ReferencePlayer(alone)
    player.begin("cartwheel")
    assert player.event_frames() == length
    player.begin("walking")
    assert player.event_frames() == 0


def test_jumps_without_recordings_keep_their_pace_and_period(tiny_model: MotionModel) -> None:
    jump = np.r_[np.full(10, -1.0), np.arange(60) / 60.0, np.full(20, -1.0)].astype(
        np.float32
    )  # one in 90 frames
    twice = np.r_[np.arange(45) / 60.0, np.arange(45) / 60.0, np.full(60, -1.0)].astype(
        np.float32
    )  # two in 150
    clips = [recording(90, jump), recording(150, twice), recording(90, jump)]
    model = with_clips(tiny_model, {"jumping-l": clips}).with_reference("none")
    rhythm = model.types["jumping-l"].rhythm
    assert rhythm is not None and rhythm.frames == pytest.approx(60.0) and rhythm.period == 90
    phases = controls_of(model, [TypePart("jumping-l", 3.0)], NEAR).phase
    assert phases[[0, 30, 59]] == pytest.approx([0.0, 0.5, 59 / 60], abs=1e-4) and (phases[60:90] < 0.0).all()
    assert phases[90] == 0.0
    assert ReferencePlayer(model).event_frames() == 0, "of no type"
    # Of strikes one half of the phase is left and one is right: a clock goes through both.
    strike = np.r_[np.full(10, -1.0), 0.5 + np.arange(30) / 60.0, np.full(20, -1.0)].astype(np.float32)
    assert recorded_rhythm([recording(60, strike)]) is None
    assert recorded_rhythm([recording(60)]) is None


def test_gaits_and_jumps_without_recordings_go_at_their_usual_velocity(tiny_model: MotionModel) -> None:
    ahead = np.stack(
        [np.arange(180), 0.0 * np.arange(180), np.full(180, 0.5 * np.pi)], axis=1
    )  # to +X, facing +X
    jump = np.r_[np.full(10, -1.0), np.arange(60) / 60.0, np.full(110, -1.0)].astype(np.float32)
    gait = replace(recording(180), ground=ahead.astype(np.float32))
    clips = {
        "walking": [gait],
        "jumping-l": [replace(gait, phases=jump), recording(59)],
        "idle": [recording(180)],
    }
    model = with_clips(tiny_model, clips, gaits=True).with_reference("none")
    assert model.types["walking"].velocity == pytest.approx((0.0, 60.0), abs=1e-3)
    assert model.types["idle"].velocity is None and model.types["cartwheel"].velocity is None
    for kind in ("walking", "jumping-l"):
        asked = controls_of(model, [TypePart(kind, 0.5)], NEAR)
        assert (asked.trajectory_mask == 1.0).all() and not asked.reference.any()
        assert np.allclose(asked.trajectory, straight_trajectory((0.0, 60.0), 60.0), atol=1e-3)
    assert not controls_of(model, [TypePart("idle", 0.5)], NEAR).trajectory_mask.any()
    # A trajectory that is asked for comes first.
    player = ReferencePlayer(model)
    player.begin("walking")
    assert not player.play(5, np.zeros((5, 24), np.float32)).trajectory.any()
    assert recorded_velocity([recording(59)], 60.0) is None, "less than a second tells no velocity"


def test_references_are_auto_or_none(flips: MotionModel) -> None:
    assert flips.with_reference("auto") is flips
    with pytest.raises(ControlError, match="unknown reference 'on'"):
        flips.with_reference("on")


def test_a_body_that_begins_by_standing_keeps_its_stance(tiny_model: MotionModel) -> None:
    chance = np.random.default_rng(0)
    clips = [
        replace(recording(120), poses=(mean + 0.1 * chance.standard_normal((150, EMBEDDING_COUNT))).astype(np.float32))
        for mean in (-1.0, 1.0, 2.0)
    ]  # fmt: skip
    model = with_clips(tiny_model, {"idle": clips, "walking": [recording(120)]})
    assert model.kind("idle") is MotionKind.STANCE
    stance = NEAR + 0.5
    player = ReferencePlayer(model)
    player.begin("idle", stance)
    shown = player.play(600).reference.reshape(-1, EMBEDDING_COUNT)
    assert np.abs(shown.mean(axis=0) - 0.5).max() < 0.05 and 0.05 < shown.std(axis=0).mean() < 0.2
    alone = ReferencePlayer(model.with_reference("none"))
    alone.begin("idle", stance)
    assert not alone.play(10).reference.any(), "without recordings there is nothing to move"
    # Not a stance that is unlike all that are recorded, such as a stride, nor one that another type has led to.
    far, after = ReferencePlayer(model), ReferencePlayer(model)
    far.begin("idle", NEAR + 5.0)
    after.begin("walking", NEAR)
    after.begin("idle", stance)
    player.begin("walking")
    player.begin("idle")
    for one in (far, after, player):
        means = one.play(600).reference.reshape(-1, EMBEDDING_COUNT).mean(axis=1)
        assert np.abs(means - 0.5).max() > 1.3
