from __future__ import annotations

import math

import numpy as np
import pytest

from model_changes import with_clips
from motionkit.arrays import Array
from motionkit.control.drive import DriveOptions, Driver, Wish, together
from motionkit.control.follow import PathFollower
from motionkit.control.path import PathPart, make_path, shape_path
from motionkit.control.plan import plan_path
from motionkit.errors import ControlError
from motionkit.features.control import Controls, future_trajectory
from motionkit.features.reference import EMBEDDING_COUNT, reference_signal
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import ReferenceClip
from motionkit.motion.rotations import rotate_ground

AT_ORIGIN = np.zeros((1, 3), np.float32)


def obey(ground: Array, asked: Controls) -> Array:
    """Where a body is that goes just where its trajectory says; one without a trajectory stays."""
    if not bool(asked.trajectory_mask[0]):
        return ground
    positions, directions = asked.trajectory[0].reshape(2, 6, 2)
    step = rotate_ground(ground[0, 2], positions[0] / 10.0)
    turn = np.arctan2(directions[0, 0], directions[0, 1]) / 10.0
    return np.concatenate([ground[0, :2] + step, (ground[0, 2] + turn)[None]])[None]


def play(driver: Driver, frames: int, ground: Array = AT_ORIGIN, first: int = 0) -> tuple[list, Array]:
    """Controls of some frames of an obedient body, and where it ends."""
    out = []
    for frame in range(first, first + frames):
        asked = driver(frame, ground)
        out.append(asked)
        ground = obey(ground, asked)
    return out, ground


def shares(asked: list[Controls], model: MotionModel, kind: str) -> list[float]:
    return [float(a.type_weights[0, model.type_id(kind)]) for a in asked]


def test_it_stands_until_told(tiny_model: MotionModel) -> None:
    asked, ground = play(Driver(tiny_model), 60)
    assert shares(asked, tiny_model, "idle") == [1.0] * 60
    assert np.array_equal(ground, AT_ORIGIN)
    assert all(float(a.trajectory_mask[0]) == 1.0 and float(a.phase[0]) == -1.0 for a in asked)


def test_it_obeys_a_velocity_and_stops(tiny_model: MotionModel) -> None:
    driver = Driver(tiny_model)
    driver.set_wish(Wish((120.0, 0.0), type="walking"))
    _, ground = play(driver, 120)
    assert float(ground[0, 0]) > 180.0 and abs(float(ground[0, 1])) < 60.0
    assert float(ground[0, 2]) == pytest.approx(math.pi / 2, abs=0.05), "it faces its way"
    driver.set_wish(Wish())
    _, halt = play(driver, 90, ground, 120)
    _, later = play(driver, 60, halt, 210)
    assert float((halt - ground)[0, 0]) < 80.0, "it halts within less than a metre"
    assert float(np.abs(later - halt).max()) < 2.0


def test_a_wish_may_be_an_array(tiny_model: MotionModel) -> None:
    driver = Driver(tiny_model, "walking")
    driver.set_wish(Wish(np.array([0.0, 100.0])))  # type: ignore[arg-type]
    assert driver.wish == Wish((0.0, 100.0))


@pytest.mark.parametrize(
    "wish",
    [
        Wish((0.0, math.nan)),
        Wish((math.inf, 0.0)),
        Wish((0.0, 5000.0)),
        Wish(None, facing=math.nan),
        Wish((0.0, 0.0, 100.0)),  # type: ignore[arg-type]
        Wish((100.0,)),  # type: ignore[arg-type]
    ],
)
def test_an_unlikely_wish_is_refused_and_changes_nothing(tiny_model: MotionModel, wish: Wish) -> None:
    driver = Driver(tiny_model, "walking")
    before = driver.wish
    with pytest.raises(ControlError, match="expected"):
        driver.set_wish(wish)
    assert driver.wish == before


def test_a_facing_other_than_the_way(tiny_model: MotionModel) -> None:
    driver = Driver(tiny_model)
    driver.set_wish(Wish((0.0, 100.0), facing=0.6, type="walking"))
    _, ground = play(driver, 120)
    assert float(ground[0, 2]) == pytest.approx(0.6, abs=0.02)
    assert float(ground[0, 1]) > 120.0


def test_weights_blend_from_the_frame_of_the_wish(tiny_model: MotionModel) -> None:
    driver = Driver(tiny_model, "idle", DriveOptions(blend_frames=8))
    play(driver, 3)
    driver.set_wish(Wish((0.0, 120.0), type="walking"))
    walking = shares(play(driver, 12, first=3)[0], tiny_model, "walking")
    assert walking == pytest.approx([min(1.0, i / 8) for i in range(1, 13)])


def test_a_change_within_a_blend_has_no_jump(tiny_model: MotionModel) -> None:
    driver = Driver(tiny_model, "idle", DriveOptions(blend_frames=10))
    driver.set_wish(Wish((0.0, 120.0), type="walking"))
    asked = play(driver, 5)[0]
    driver.set_wish(Wish((0.0, 300.0), type="running"))
    asked += play(driver, 15, first=5)[0]
    weights = np.concatenate([a.type_weights for a in asked])
    assert np.abs(np.diff(weights, axis=0)).max() < 0.11
    assert np.allclose(weights.sum(-1), np.ones(len(weights), np.float32), atol=1e-5)
    assert shares(asked, tiny_model, "running")[-1] == 1.0


def test_a_path_after_another_blends_its_type_in(tiny_model: MotionModel) -> None:
    driver = Driver(tiny_model, "idle", DriveOptions(blend_frames=10))
    driver.set_wish(Wish(path=shape_path("line", 10.0, ["running"], None)))
    _, ground = play(driver, 60)
    driver.set_wish(Wish(path=shape_path("line", 10.0, ["walking"], None)))
    walking = shares(play(driver, 12, ground, 60)[0], tiny_model, "walking")
    assert walking == pytest.approx([min(1.0, i / 10) for i in range(1, 13)])


def test_a_stop_at_the_end_of_a_path_is_held(tiny_model: MotionModel) -> None:
    driver = Driver(tiny_model, "idle")
    line = np.array([[0.0, 0.0], [0.0, 200.0]])
    frames = {}
    for stop in (0.0, 2.0):
        driver.set_wish(Wish(path=make_path([PathPart(line, "walking", None, stop)])))
        _, ground = play(driver, 1)
        frames[stop] = 0
        while driver.following is not None and frames[stop] < 600:
            _, ground = play(driver, 1, ground, frames[stop] + 1)
            frames[stop] += 1
    assert frames[2.0] - frames[0.0] == pytest.approx(120, abs=20)


def test_no_velocity_gives_no_trajectory(tiny_model: MotionModel) -> None:
    driver = Driver(tiny_model)
    driver.set_wish(Wish(None, type="walking"))
    asked = driver(0, AT_ORIGIN)
    assert float(asked.trajectory_mask[0]) == 0.0 and not asked.trajectory.any()


def test_a_performance_runs_once_along_its_track(tiny_model: MotionModel) -> None:
    blend = 10
    driver = Driver(tiny_model, "idle", DriveOptions(blend_frames=blend))
    reference_clip = tiny_model.types["cartwheel"].reference_clips[0]
    track = future_trajectory(reference_clip.ground, np.arange(len(reference_clip)))
    driver.perform("cartwheel")
    asked = play(driver, len(track) + 40)[0]
    begins, ends = blend // 2, blend // 2 + len(track)
    phase = [float(a.phase[0]) for a in asked]
    assert phase[:begins] == [-1.0] * begins and phase[ends:] == [-1.0] * (len(asked) - ends)
    assert phase[begins:ends] == pytest.approx([i / len(track) for i in range(len(track))])
    shown = np.concatenate([a.trajectory for a in asked[begins:ends]])
    assert np.array_equal(shown, track)
    cartwheel = shares(asked, tiny_model, "cartwheel")
    assert cartwheel[begins - 1] == pytest.approx(0.5) and cartwheel[begins + blend] == 1.0
    assert cartwheel[ends - 1] == pytest.approx(0.5) and cartwheel[-1] == 0.0
    assert shares(asked, tiny_model, "idle")[-1] == 1.0, "back to what went before"
    assert driver.performing is None


def test_a_second_performance_waits_for_the_first(tiny_model: MotionModel) -> None:
    driver = Driver(tiny_model)
    length = len(tiny_model.types["cartwheel"].reference_clips[0])
    driver.perform("cartwheel")
    play(driver, 5)
    driver.perform("cartwheel", choice=1)
    asked = play(driver, 2 * length + 20, first=5)[0]
    starts = [i for i, a in enumerate(asked) if float(a.phase[0]) == 0.0]
    assert len(starts) == 2 and starts[1] - starts[0] == length
    references = [asked[start].reference for start in starts]
    for reference, reference_clip in zip(
        references, tiny_model.types["cartwheel"].reference_clips[:2], strict=True
    ):
        assert np.array_equal(reference, reference_signal(reference_clip.poses, np.array([0])))


def test_a_type_with_a_phase_that_is_held_is_repeated(tiny_model: MotionModel) -> None:
    driver = Driver(tiny_model)
    length = len(tiny_model.types["cartwheel"].reference_clips[0])
    driver.set_wish(Wish(type="cartwheel"))
    asked = play(driver, 3 * length)[0]
    starts = [i for i, a in enumerate(asked) if float(a.phase[0]) == 0.0]
    assert len(starts) == 3 and starts[2] - starts[1] == length
    assert min(shares(asked, tiny_model, "cartwheel")[20:]) == 1.0
    driver.set_wish(Wish())
    asked = play(driver, length + 30, first=3 * length)[0]
    assert shares(asked, tiny_model, "idle")[-1] == 1.0


@pytest.mark.parametrize("seconds", [float("nan"), float("inf"), 0.0, -1.0, 61.0])
def test_lengths_that_no_performance_has_are_refused(tiny_model: MotionModel, seconds: float) -> None:
    driver = Driver(tiny_model)
    with pytest.raises(ControlError, match="expected a length from 0 to 60 s"):
        driver.perform("running", seconds=seconds)
    play(driver, 3)
    assert driver.performing is None


def test_a_type_without_a_length_is_performed_for_the_seconds_given(tiny_model: MotionModel) -> None:
    driver = Driver(tiny_model)
    driver.perform("running", seconds=0.5)
    asked = play(driver, 60)[0]
    assert max(shares(asked, tiny_model, "running")) == 1.0
    assert shares(asked, tiny_model, "idle")[-1] == 1.0
    assert all(float(a.phase[0]) == -1.0 for a in asked)


@pytest.mark.parametrize(("velocity", "given"), [((0.0, 0.0), 0.0), (None, 0.0), ((0.0, 200.0), 1.0)])
def test_a_performance_without_a_way_leaves_one_who_stands_free(
    tiny_model: MotionModel, velocity: tuple[float, float] | None, given: float
) -> None:
    model = tiny_model.with_types({"walking": {"steered": False}})
    driver = Driver(model, "idle", DriveOptions(blend_frames=10))
    driver.set_wish(Wish(velocity))
    driver.perform("walking", seconds=1.0)
    asked = play(driver, 50)[0][5:]
    assert [float(a.trajectory_mask[0]) for a in asked] == [given] * 45
    assert all(a.reference_gain is not None and float(a.reference_gain[0]) > 0.0 for a in asked)
    assert all(float(a.phase[0]) == -1.0 for a in asked)


def test_a_strike_takes_its_own_time(tiny_model: MotionModel) -> None:
    phases = np.full((300,), -1.0, np.float32)
    phases[100:140] = np.arange(40) / 40.0
    kick = ReferenceClip(np.zeros((330, EMBEDDING_COUNT), np.float32), np.zeros((300, 3), np.float32), phases)
    driver = Driver(with_clips(tiny_model, {"running": [kick]}), "idle", DriveOptions(blend_frames=10))
    driver.perform("running", seconds=5.0)
    asked = play(driver, 120)[0]
    phase = [float(a.phase[0]) for a in asked]
    assert phase.count(-1.0) == 80 and max(phase) == pytest.approx(39 / 40)
    assert driver.performing is None


def test_the_choice_picks_the_recordings_of_a_wish(tiny_model: MotionModel) -> None:
    chance = np.random.default_rng(1)
    clips = [
        ReferenceClip(
            chance.standard_normal((330, EMBEDDING_COUNT), np.float32),
            np.zeros((300, 3), np.float32),
            np.full((300,), -1.0, np.float32),
        )
        for _ in range(3)
    ]
    model = with_clips(tiny_model, {"running": clips})

    def shown(choice: int) -> Array:
        driver = Driver(model, "idle", choice=choice)
        driver.set_wish(Wish(None, type="running"))
        return np.concatenate([asked.reference for asked in play(driver, 30)[0]])

    assert np.array_equal(shown(1), shown(1))
    assert not np.array_equal(shown(1), shown(2))


def test_a_path_is_followed_as_follow_path_does_and_then_it_stands(tiny_model: MotionModel) -> None:
    path = shape_path("line", 2.0, ["walking", "running"], 1.5)
    driver, follower = Driver(tiny_model, "walking"), PathFollower(tiny_model, plan_path(tiny_model, path))
    driver.set_wish(Wish(path=path))
    ground, frame = AT_ORIGIN, 0
    while driver.following is not None and frame < 300:
        asked, expected = driver(frame, ground), follower(frame, ground)
        assert np.array_equal(asked.trajectory, expected.trajectory)
        if frame >= driver.options.blend_frames:
            assert np.allclose(asked.type_weights, expected.type_weights)
        ground, frame = obey(ground, asked), frame + 1
    assert frame < 300 and float(ground[0, 1]) == pytest.approx(200.0, abs=8.0)
    asked, halt = play(driver, 120, ground, frame)
    assert shares(asked, tiny_model, "idle")[-1] == 1.0
    assert float((halt - ground)[0, 1]) < 60.0


def test_a_new_wish_leaves_the_path(tiny_model: MotionModel) -> None:
    driver = Driver(tiny_model)
    driver.set_wish(Wish(path=shape_path("circle", 2.0, ["walking"], 1.5)))
    play(driver, 10)
    assert driver.following is not None
    driver.set_wish(Wish((0.0, 100.0)))
    assert driver.following is None


def test_the_same_wishes_give_the_same_controls(tiny_model: MotionModel) -> None:
    def run() -> Array:
        driver = Driver(tiny_model)
        asked, ground = play(driver, 10)
        driver.set_wish(Wish((90.0, 90.0), type="walking"))
        more, ground = play(driver, 10, ground, 10)
        driver.perform("cartwheel")
        return np.concatenate([a.trajectory for a in asked + more + play(driver, 60, ground, 20)[0]])

    assert np.array_equal(run(), run())


def test_unknown_types_are_refused_and_change_nothing(tiny_model: MotionModel) -> None:
    driver = Driver(tiny_model)
    with pytest.raises(ControlError, match="unknown motion type 'flying'"):
        driver.set_wish(Wish(type="flying"))
    with pytest.raises(ControlError, match="unknown motion type 'flying'"):
        driver.set_wish(Wish(path=shape_path("line", 2.0, ["flying"], 1.0)))
    with pytest.raises(ControlError, match="unknown motion type 'flying'"):
        driver.perform("flying")
    assert driver.wish == Wish() and driver.performing is None


def test_characters_together_are_a_batch(tiny_model: MotionModel) -> None:
    one, two = Driver(tiny_model), Driver(tiny_model)
    two.set_wish(Wish(None, type="walking"))
    both = together([one(0, AT_ORIGIN), two(0, AT_ORIGIN)])
    assert both.type_weights.shape == (2, len(tiny_model.types))
    assert both.trajectory.shape == (2, 24) and both.trajectory_mask.tolist() == [1.0, 0.0]
    assert both.phase.tolist() == [-1.0, -1.0]
