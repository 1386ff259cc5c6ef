from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from motionkit.arrays import Array, spans
from motionkit.control.follow import GUIDED, PathFollower, follow_path
from motionkit.control.path import SHAPES, SPACING, Path2D, PathPart, make_path, shape_path
from motionkit.control.path_place import PathPlace, plan_route
from motionkit.control.plan import plan_path
from motionkit.control.speeds import PROFILE, lateral_limit
from motionkit.control.synthesize import SynthesisOptions
from motionkit.errors import ControlError
from motionkit.metrics.trajectory import trajectory_distance
from motionkit.models.bundled import load_bundled_model
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import ReferenceClip
from motionkit.motion.rotations import rotate_ground
from oracle.path import PathInNumpy, even_path


def following(model: MotionModel, path: Path2D) -> PathFollower:
    return PathFollower(model, plan_path(model, path))


def speeds_along(model: MotionModel, path: Path2D) -> Array:
    return plan_route(model, path).speeds


def walk_obediently(follower: PathFollower, path: Path2D, frames: int) -> tuple[Array, list[Array]]:
    """Ground track (T, 3) of a body that goes just where its trajectory says, and the controls it got."""
    heading = np.arctan2(path.tangents[0, 0], path.tangents[0, 1]) - follower.route.facings[0]
    ground = np.concatenate([path.points[0], heading[None]])[None]
    track, asked = [], []
    for frame in range(frames):
        controls = follower(frame, ground)
        asked.append(controls)
        positions, directions = controls.trajectory[0].reshape(2, 6, 2)
        step = rotate_ground(ground[0, 2], positions[0] / 10.0)  # the first sample is 10 frames ahead
        turn = np.arctan2(directions[0, 0], directions[0, 1]) / 10.0
        ground = np.concatenate([ground[0, :2] + step, (ground[0, 2] + turn)[None]])[None]
        track.append(ground[0])
        if follower.place.arc >= path.length - SPACING:
            break
    return np.stack(track), asked


@pytest.mark.parametrize(
    ("name", "size", "mean", "largest"),
    [
        ("line", 8.0, 0.5, 1.0),
        ("circle", 2.0, 2.0, 4.0),
        ("figure-eight", 2.0, 2.0, 5.0),
        ("square", 3.0, 3.0, 20.0),
        ("pentagram", 3.0, 5.0, 25.0),
        ("u-turn", 5.0, 2.0, 6.0),
    ],
)
def test_an_obedient_body_follows_to_the_end(
    tiny_model: MotionModel, name: str, size: float, mean: float, largest: float
) -> None:
    path = shape_path(name, size, ["walking"], 1.2)
    follower = following(tiny_model, path)
    frames = int(1.6 * 60 * follower.plan.seconds)
    track, _ = walk_obediently(follower, path, frames)
    assert follower.place.arc >= path.length - SPACING, "the end was not reached"
    distance = trajectory_distance(track[:, :2], path.points)
    assert distance.mean < mean and distance.max < largest
    assert distance.coverage > 0.95, "no part of the path was left out"
    assert len(track) / 60 == pytest.approx(follower.plan.seconds, rel=0.15), "at the planned speed"


LOOP = [[0, 0], [0, 400], [300, 400], [300, 200], [-200, 200]]  # crosses itself
PATHS: dict[str, list[PathPart]] = {
    "shapes": [PathPart(shape_path(name, 1.5, [""], None).points, "walking") for name in SHAPES],
    "crossing": [PathPart(np.array(LOOP, np.float64), "running", 250.0)],
    "way back": [PathPart(np.array([[0, 0], [0, 300], [0, 0], [0, 300]], np.float64), "walking", 120.0, 1.0)],
    "stops": [
        PathPart(np.array([[0, 0], [0, 300], [0, 300], [200, 300]], np.float64), "running", None, 0.5),
        PathPart(np.array([[200, 304.1]]), "b-walking", 5.0, 2.0),
        PathPart(np.array([[200, 600], [500, 600]], np.float64), "cartwheel", 400.0),
    ],
}  # fmt: skip


@pytest.mark.parametrize("name", PATHS)
def test_c_follows_as_numpy_does(name: str) -> None:
    """Points, speeds, types, and each frame of a body that goes along beside the path, stops and is pushed."""
    model, rng = load_bundled_model(), np.random.default_rng(3)
    path, expected = make_path(PATHS[name]), even_path(PATHS[name])
    route, theirs = plan_route(model, path), PathInNumpy(model, expected)
    for ours, their in ((path.points, expected.points), (path.tangents, expected.tangents)):
        np.testing.assert_allclose(ours, their, atol=1e-9)
    assert np.array_equal(path.part, expected.part) and np.array_equal(route.track, theirs.track)
    np.testing.assert_allclose(route.speeds, theirs.speeds, rtol=1e-6)
    place, ground = PathPlace(route), np.zeros(3)
    for frame in range(3000):
        standing = place.move(ground)
        stands, trajectory, weights = theirs.follow(ground)
        assert standing == stands and place.arc == pytest.approx(theirs.arc, abs=1e-9)
        np.testing.assert_allclose(place.words.trajectory, trajectory, rtol=1e-6, atol=1e-5)
        np.testing.assert_allclose(place.weights, weights, atol=1e-6)
        if place.finished:
            break
        pushed = rng.normal(0.0, rng.choice([0.0, 4.0, 30.0]), 2) if frame % 40 == 0 else 0.0
        ground[:2] += rotate_ground(ground[2], trajectory[:2] / 10.0) + pushed
        ground[2] += rng.normal(0.0, 0.05)
    assert place.finished and not theirs.stops, "it arrived"


def test_samples_are_where_the_path_is_at_the_asked_speed(tiny_model: MotionModel) -> None:
    path = shape_path("line", 10.0, ["walking"], 1.2)
    follower = following(tiny_model, path)
    ground = np.array([[0.0, 100.0, 0.0]], np.float32)
    follower.place.words.arc = 100.0
    positions, directions = follower(0, ground).trajectory[0].reshape(2, 6, 2)
    assert np.allclose(positions[:, 1], 120.0 * np.arange(1, 7) / 6.0, atol=1e-2)
    assert np.abs(positions[:, 0]).max() < 1e-3
    assert np.allclose(directions, np.broadcast_to(np.array([0.0, 1.0], np.float32), (6, 2)))


def test_samples_are_in_the_heading_frame(tiny_model: MotionModel) -> None:
    follower = following(tiny_model, shape_path("line", 10.0, ["walking"], 1.2))
    quarter = np.array(
        [[30.0, 0.0, math.pi / 2]], np.float32
    )  # faces +X, the path goes along +Z to its right
    positions, directions = follower(0, quarter).trajectory[0].reshape(2, 6, 2)
    assert (positions[:, 0] < 0).all(), "along +Z is to the right of one who faces +X"
    assert np.allclose(positions[:, 1], np.full((6,), -30.0, np.float32), atol=1e-3)
    assert np.allclose(directions, np.broadcast_to(np.array([-1.0, 0.0], np.float32), (6, 2)), atol=1e-5)


def test_a_stop_is_held_and_braked_for(tiny_model: MotionModel) -> None:
    line = np.array([[0.0, 0.0], [0.0, 600.0]])
    path = make_path([
        PathPart(line, "walking", 200.0, stop=2.0),
        PathPart(np.array([[0.0, 1200.0]]), "walking", 200.0, stop=1.0),
    ])  # fmt: skip
    follower = following(tiny_model, path)
    ground, speeds, standing = np.array([[0.0, 0.0, 0.0]], np.float32), [], []
    while not follower.finished:
        assert len(speeds) < 1200, "the end was not reached"
        controls = follower(len(speeds), ground)
        # What is asked for in the next frames, without lag.
        step = float(controls.trajectory[0, 1]) / 10.0
        ground = ground + np.array([[0.0, step, 0.0]], np.float32)
        speeds.append(60.0 * step)
        standing.append(float(controls.type_weights[0, tiny_model.type_id("idle")]))
    still, idle = np.array(speeds) < 20.0, np.array(standing)
    stops = [(start, end) for start, end in spans(still) if end - start > 6]
    assert [(end - start) / 60 for start, end in stops] == [
        pytest.approx(2.0, abs=0.4),
        pytest.approx(1.0, abs=0.4),
    ]
    assert [idle[start:end].max() for start, end in stops] == [1.0, 1.0] and idle[0] == 0.0
    assert (
        np.abs(np.diff(np.convolve(speeds, np.ones(20) / 20, "valid"))).max() * 60
        < 1.6 * PROFILE.acceleration
    )
    assert len(speeds) / 60 == pytest.approx(follower.plan.seconds, rel=0.15)


def test_a_performance_after_a_stop_is_shown(tiny_model: MotionModel) -> None:
    path = make_path([
        PathPart(np.array([[0.0, 0.0], [0.0, 200.0]]), "walking", 130.0, stop=1.0),
        PathPart(np.array([[0.0, 400.0]]), "cartwheel", 130.0),
    ])  # fmt: skip
    follower = following(tiny_model, path)
    _, asked = walk_obediently(follower, path, 600)
    shown = [bool(np.abs(controls.reference).any()) for controls in asked]
    of_it = [float(controls.type_weights[0, tiny_model.type_id("cartwheel")]) for controls in asked]
    assert follower.finished and follower.player.kind == "cartwheel" and follower.entered == 1
    assert all(is_shown for is_shown, w in zip(shown, of_it, strict=True) if w == 1.0)


@pytest.mark.parametrize(("seconds", "share"), [(3.0, GUIDED), (1.5, 0.0)])
def test_gaits_with_long_recordings_show_them_on_paths(
    tiny_model: MotionModel, seconds: float, share: float
) -> None:
    """Short recordings would follow one another too quickly for the feet."""
    frames = round(60.0 * seconds)
    clip = max(tiny_model.types["walking"].reference_clips, key=len)
    assert len(clip) >= frames
    clip = ReferenceClip(clip.poses[: frames + 30], clip.ground[:frames], clip.phases[:frames])
    model = tiny_model.with_types({"walking": {"reference_clips": (clip,)}})
    follower = following(model, make_path([PathPart(np.array([[0.0, 0.0], [0.0, 400.0]]), "walking", 130.0)]))
    _, asked = walk_obediently(follower, follower.route.path, 200)
    gains = np.array([float(controls.reference_gain[0]) for controls in asked])
    assert gains == pytest.approx(share * model.types["walking"].preset.reference_gain)


def test_bodies_slow_down_before_turns_the_more_the_sharper(tiny_model: MotionModel) -> None:
    ways = [(0.0, 300.0), (200.0, 500.0), (300.0, 600.0), (300.0, 200.0), (0.0, 0.0)]
    corners = [np.array([[0.0, 0.0], [0.0, 600.0], [0.0, 600.0] + 0.5 * np.array(way)]) for way in ways[:3]]
    corners += [np.array([[0.0, 0.0], [0.0, 600.0], way]) for way in ways[3:]]
    paths = [make_path([PathPart(points, "running", 300.0)]) for points in corners]
    slowest = [float(speeds_along(tiny_model, path).min()) for path in paths]
    assert slowest[0] == 300.0 and all(a > b for a, b in pairwise(slowest))
    assert slowest[-1] < 60.0, "it turns on the spot"


@pytest.mark.parametrize("radius", [1.0, 3.0])
def test_a_curve_is_gone_at_a_speed_that_its_radius_allows(tiny_model: MotionModel, radius: float) -> None:
    speeds = speeds_along(tiny_model, shape_path("circle", radius, ["running"], 4.5))
    most = math.sqrt(100.0 * radius * lateral_limit(tiny_model, "running"))
    assert speeds[len(speeds) // 2] == pytest.approx(min(450.0, most), rel=0.02)


@pytest.mark.parametrize(
    "corners",
    [[[0, 0], [0, 200], [0, 0]], [[0, 0], [0, 200], [0, 0], [0, 200]], [[0, 0], [90, 90], [0, 0.5]]],
)
def test_a_way_back_on_the_way_there_is_gone(tiny_model: MotionModel, corners: list) -> None:
    path = make_path([PathPart(np.array(corners, np.float64), "walking", 120.0)])
    follower = following(tiny_model, path)
    track, _ = walk_obediently(follower, path, int(1.6 * 60 * follower.plan.seconds))
    assert follower.finished
    assert len(track) / 60 < 1.15 * follower.plan.seconds
    furthest = np.linalg.norm(track[:, :2], axis=1).max()
    assert furthest > np.linalg.norm(corners[1]) - 15.0, "it turned too early"


def test_the_speed_changes_no_faster_than_bodies_brake(tiny_model: MotionModel) -> None:
    line = [np.array([[0.0, 0.0], [0.0, 800.0]]), np.array([[0.0, 1400.0]]), np.array([[0.0, 2000.0]])]
    path = make_path([PathPart(p, "cartwheel", v) for p, v in zip(line, (360.0, 100.0, 300.0), strict=True)])
    speeds = speeds_along(tiny_model, path)
    accelerations = np.diff(speeds.astype(np.float64) ** 2) / (2.0 * SPACING)
    assert np.abs(accelerations).max() <= 1.001 * PROFILE.acceleration
    assert (speeds <= np.array([360.0, 100.0, 300.0])[path.part] + 1e-3).all()
    for part, speed in enumerate((360.0, 100.0, 300.0)):
        assert speeds[path.part == part].max() == pytest.approx(speed)


def test_a_type_that_goes_backwards_faces_against_its_way(tiny_model: MotionModel) -> None:
    from dataclasses import replace

    gait = tiny_model.types["walking"].gait
    assert gait is not None
    model = tiny_model.with_types({"walking": {"gait": replace(gait, facing=math.pi)}})
    path = shape_path("line", 5.0, ["walking"], 1.2)
    track, asked = walk_obediently(following(model, path), path, 400)
    facing = np.remainder(track[:, 2] + math.pi, 2 * math.pi)
    assert np.minimum(facing, 2 * math.pi - facing).max() < 1e-3, "it faces -Z all the way"
    assert float(track[-1, 1]) == pytest.approx(500.0, abs=5.0)
    assert all(float(c.trajectory[0, 1]) < 0 for c in asked), "and goes to its back"


def test_types_blend_over_40_frames_between_parts(tiny_model: MotionModel) -> None:
    path = shape_path("line", 12.0, ["walking", "running"], 1.2)
    follower = following(tiny_model, path)
    _, asked = walk_obediently(follower, path, 1000)
    weights = np.concatenate([c.type_weights for c in asked])
    running = weights[:, tiny_model.type_id("running")]
    assert np.allclose(weights.sum(-1), np.ones(len(weights), np.float32), atol=1e-5)
    assert float(running[0]) == 0.0 and float(running[-1]) == 1.0
    assert (np.diff(running) >= -1e-6).all()
    mixed = int(((running > 0) & (running < 1)).sum())
    assert mixed == pytest.approx(40, abs=6)


def test_who_runs_walks_around_a_sharp_turn_and_to_a_stop(tiny_model: MotionModel) -> None:
    there_and_back = np.array([[0.0, 0.0], [0.0, 900.0], [0.0, 0.0]], np.float32)
    path = make_path(
        [PathPart(there_and_back, "running", None, 1.0), PathPart(there_and_back[:2], "running")]
    )
    follower = following(tiny_model, path)
    running, walking = (tiny_model.type_id(kind) for kind in ("running", "walking"))
    slowest, _ = tiny_model.speed_range("running") or (0.0, 0.0)
    slow = follower.route.speeds < 0.98 * slowest
    assert (follower.plan.track[slow] == walking).all() and (
        follower.plan.track[follower.route.speeds >= slowest] == running
    ).all()
    assert slow[450] and slow[900] and 0.0 < slow.mean() < 0.5
    weights = follower.place.type_weights(900.0)
    assert float(weights[walking]) == 1.0 and float(follower.place.type_weights(300.0)[running]) == 1.0
    walked = following(tiny_model, make_path([PathPart(there_and_back, "walking")]))
    assert (walked.plan.track == walking).all(), "who walks has nothing slower"
    straight = following(tiny_model, shape_path("line", 10.0, ["running"], None))
    assert (straight.plan.track == running).all()


def test_a_type_goes_at_its_own_speed_unless_told(tiny_model: MotionModel) -> None:
    path = shape_path("line", 10.0, ["running"], None)
    follower = following(tiny_model, path)
    assert float(follower.route.speeds[0]) == pytest.approx(tiny_model.types["running"].gait.speed, rel=1e-3)
    slow = following(tiny_model, shape_path("line", 10.0, ["idle"], None))
    assert float(slow.route.speeds[0]) == 20.0, "one who stands would never arrive"
    assert slow.plan.seconds == pytest.approx(50.0, rel=0.01)


def test_a_body_pushed_off_the_path_is_led_back(tiny_model: MotionModel) -> None:
    path = shape_path("line", 10.0, ["walking"], 1.2)
    follower = following(tiny_model, path)
    positions = follower(0, np.array([[40.0, 50.0, 0.0]], np.float32)).trajectory[0, :12].reshape(6, 2)
    assert np.allclose(positions[:, 0], np.full((6,), -40.0, np.float32), atol=1e-3)


def test_unknown_type_on_a_path(tiny_model: MotionModel) -> None:
    path = make_path([PathPart(np.array([[0.0, 0.0], [0.0, 100.0]], np.float32), "flying")])
    with pytest.raises(ControlError, match="unknown motion type 'flying'"):
        follow_path(tiny_model, path)


def test_a_whole_roll_out(tiny_model: MotionModel) -> None:
    """The tiny model cannot follow the path. The result is complete and says so."""
    path = shape_path("line", 0.4, ["walking", "cartwheel"], 3.0)
    seen: list[float] = []
    result = follow_path(tiny_model, path, progress=seen.append)
    again = follow_path(tiny_model, path)
    assert result.frames == len(result.motion) == len(seen)
    assert np.array_equal(result.motion.local_rotations, again.motion.local_rotations)
    assert len(result.part_distances) == 2
    limit = int((1.6 * following(tiny_model, path).plan.seconds + 3.0) * 60)
    assert result.frames <= limit + 1
    assert result.finished == (seen[-1] >= 0.9)
    assert seen == sorted(seen) and max(seen) <= 1.0, "progress is a share that never falls"
    free = follow_path(
        tiny_model, path, SynthesisOptions(ik=False)
    ).motion  # held feet move the hips a little
    track = free.root_positions[:, [0, 2]]
    assert result.distance.mean == pytest.approx(trajectory_distance(track, path.points).mean, rel=1e-5)
    assert result.distance.mean > 0.0, "a body sways off the line"


def test_one_character_at_a_time(tiny_model: MotionModel) -> None:
    path = shape_path("line", 1.0, ["walking"], 1.0)
    with pytest.raises(ControlError, match="one character at a time"):
        follow_path(tiny_model, path, SynthesisOptions(count=2))


def test_a_path_that_starts_elsewhere_starts_there(tiny_model: MotionModel) -> None:
    points = np.array([[300.0, -200.0], [350.0, -200.0]], np.float32)
    result = follow_path(tiny_model, make_path([PathPart(points, "walking", 150.0)]))
    assert float(np.linalg.norm(result.motion.root_positions[0, [0, 2]] - points[0])) < 30.0
