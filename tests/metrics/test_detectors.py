"""Each detector accepts a motion made to show its type, and rejects similar ones."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from motionkit.arrays import Array, spans
from motionkit.metrics.body import STANDING_ANKLE, STANDING_TOE, Body, body_of
from motionkit.metrics.detectors import DETECTORS, detection_windows, take_offs, turns
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import expmap_to_quat, quat_identity, quat_multiply
from motionkit.motion.skeleton import JOINT_COUNT, JOINT_NAMES, canonical_skeleton
from synthetic_motions import make_cartwheel, make_idle, make_jump, make_walk, placed, standing_rotations


def about(axis: int, angle: Array) -> Array:
    expmap = np.zeros((len(angle), 3), np.float32)
    expmap[:, axis] = angle.astype(np.float32)
    return expmap_to_quat(expmap)


def make_run() -> Motion:
    """Strides with a hop in each, at 3 m/s."""
    motion = make_walk(180, speed=300.0, turn=0.0, swing=0.8, cadence=1.4)
    beat = 2 * math.pi * 2.8 * np.arange(180) / 60.0
    motion.root_positions[:, 1] += 12.0 * np.maximum(np.sin(beat), 0.0)
    return motion


def make_backwards() -> Motion:
    """A walk played backwards."""
    motion = make_walk(150, turn=0.0)
    return Motion(
        motion.skeleton, np.flip(motion.local_rotations, 0), np.flip(motion.root_positions, 0), motion.fps
    )


def make_leap(first: float, second: float) -> Motion:
    """A flight of half a second. Before it the left knee is bent by first, the right one by second (radians)."""
    motion = make_idle(90)
    rotations = motion.local_rotations.copy()
    for side, bend in (("Left", first), ("Right", second)):
        for name, angle in (("UpLeg", -bend), ("Leg", 2 * bend)):
            joint = JOINT_NAMES.index(side + name)
            rotations[:, joint] = quat_multiply(about(0, np.full((90,), angle)), rotations[:, joint])
    root = motion.root_positions.copy()
    root[30:60, 1] += 30.0 * np.sin(np.linspace(0.2, math.pi - 0.2, 30, dtype=np.float32))
    return Motion(motion.skeleton, rotations, root, motion.fps)


def make_flip(axis: int, angle: float, hips: float = 95.0) -> Motion:
    """A turn of the whole body about one axis of the hips, arms hanging."""
    share = np.clip((np.arange(180) - 60) / 60.0, 0.0, 1.0)
    rotations = standing_rotations(180).astype(np.float32)
    rotations[:, 0] = about(axis, angle * share)
    height = 95.0 + (hips - 95.0) * np.sin(math.pi * share)
    root = np.stack([np.zeros(180, np.float32), height, np.zeros(180, np.float32)], axis=-1)
    return Motion(make_idle(2).skeleton, rotations, root, 60.0)


def make_strike(joint: str, axis: int, angle: float, frames: int = 6) -> Motion:
    """A standing body that turns one joint fast, and back."""
    motion = make_idle(120)
    share = np.clip((np.arange(120) - 50) / frames, 0, 1) - np.clip((np.arange(120) - 80) / frames, 0, 1)
    rotations = motion.local_rotations.copy()
    number = JOINT_NAMES.index(joint)
    rotations[:, number] = quat_multiply(about(axis, angle * share), rotations[:, number])
    return Motion(motion.skeleton, rotations, motion.root_positions, motion.fps)


def make_punch(seconds: float = 0.1, aside: float = 0.0) -> Motion:
    """The bent left elbow opens; the arm points forwards, turned aside by an angle in radians."""
    motion = make_idle(120)
    share = np.clip((np.arange(120) - 50) / (60.0 * seconds), 0.0, 1.0)
    rotations = motion.local_rotations.copy()
    rotations[:, JOINT_NAMES.index("LeftArm")] = about(1, (aside - math.pi / 2) * np.ones(120, np.float32))
    rotations[:, JOINT_NAMES.index("LeftForeArm")] = about(1, -2.2 * (1.0 - share))
    return Motion(motion.skeleton, rotations, motion.root_positions, motion.fps)


def shown(motion: Motion) -> set[str]:
    """Return the types that are detected in all windows of a motion."""
    body = body_of(motion)
    return {
        kind
        for kind, detector in DETECTORS.items()
        if all(map(detector.shows, detection_windows(body, detector.window)))
    }


@pytest.mark.parametrize(
    ("motion", "kinds"),
    [
        (make_walk(turn=0.3), {"walking"}),
        (placed(make_walk(turn=-0.5), yaw=2.0, move=(300.0, -80.0)), {"walking"}),
        (make_walk(speed=20.0), set()),
        (make_backwards(), {"b-walking"}),
        (make_run(), {"running"}),
        (make_leap(0.3, 0.3), {"jumping-b"}),
        (make_leap(0.3, 0.8), {"jumping-l"}),
        (make_leap(0.8, 0.3), {"jumping-r"}),
        (make_flip(0, -2 * math.pi), {"backflip"}),
        (make_flip(2, 2 * math.pi), {"side-somersault"}),
        (make_flip(0, 2 * math.pi, hips=30.0), {"dive-roll"}),
        (make_strike("LeftUpLeg", 0, -2.2), {"kicking"}),
        (make_punch(), {"punching"}),
        (make_punch(seconds=1.0), set()),
        (make_punch(aside=1.5), set()),
    ],
)
def test_a_motion_shows_its_type_and_no_other(motion: Motion, kinds: set[str]) -> None:
    # A flip or strike on the spot may also be detected as standing.
    assert shown(motion) - {"idle"} == kinds


def test_standing_is_idle_and_walking_is_not() -> None:
    assert shown(make_idle()) == {"idle"}
    assert not DETECTORS["idle"].shows(body_of(make_walk(speed=20.0)))
    assert not DETECTORS["idle"].shows(body_of(make_walk(speed=0.0, swing=0.9)))


def test_a_cartwheel_needs_hands_on_the_ground() -> None:
    wheel = make_cartwheel(180)
    assert shown(wheel) >= {"cartwheel"} and "side-somersault" not in shown(wheel)
    (turn,) = turns(body_of(wheel))
    assert turn.sideways > 3.0 and turn.recovers and turn.spin < 1.0
    wheel.root_positions[:, 1] += 40.0 - turn.hands
    assert shown(wheel) >= {"side-somersault"} and "cartwheel" not in shown(wheel)


def test_a_flip_without_recovery_does_not_count() -> None:
    body = body_of(make_flip(0, -2 * math.pi))
    upside_down = int(np.flatnonzero(body.head_height < 0.0)[-1])
    assert DETECTORS["backflip"].shows(body)
    assert not DETECTORS["backflip"].shows(body.cut(0, upside_down))


def test_detectors_ignore_place_and_heading() -> None:
    for motion in (make_walk(), make_jump(side=1.0), make_flip(2, 2 * math.pi)):
        assert shown(motion) == shown(placed(motion, yaw=-1.2, move=(-500.0, 40.0)))


def test_take_offs_name_the_foot_of_every_long_flight() -> None:
    twice = make_leap(0.3, 0.8)
    body = body_of(
        Motion(
            twice.skeleton,
            np.concatenate([twice.local_rotations, make_leap(0.8, 0.3).local_rotations]),
            np.concatenate([twice.root_positions, twice.root_positions]),
            60.0,
        )
    )
    assert take_offs(body) == ["l", "r"]


def test_windows_cover_a_motion_and_keep_a_short_one_whole() -> None:
    body = body_of(make_idle(180))
    windows = detection_windows(body, 2.0)
    assert [len(w) for w in windows] == [120, 120, 120]
    assert np.array_equal(windows[1].positions, body.positions[30:150])
    assert [len(w) for w in detection_windows(body, 0.0)] == [180]
    assert [len(w) for w in detection_windows(body, 9.0)] == [180]


def test_spans_are_the_stretches_of_true_flags() -> None:
    assert spans(np.array([True, True, False, True])) == [(0, 2), (3, 4)]
    assert spans(np.zeros(3, bool)) == []


def test_the_velocity_is_to_the_left_and_ahead() -> None:
    body = body_of(placed(make_walk(turn=0.0, speed=120.0), yaw=1.0))
    assert isinstance(body, Body)
    assert body.velocity[:, 1].mean() == pytest.approx(1.2, abs=0.02)
    assert np.abs(body.velocity[:, 0]).mean() < 0.2


@pytest.mark.parametrize(("frames", "count"), [(11, 0), (12, 1), (13, 1)])
@pytest.mark.parametrize(("side", "foot"), [(0.0, "b"), (4.9, "b"), (5.1, "l"), (-5.1, "r")])
def test_the_shortest_flight_of_a_jump_and_its_foot(frames: int, count: int, side: float, foot: str) -> None:
    """A body that stands, lifted whole for some frames; before that, one foot is higher than the other."""
    body = body_of(
        Motion(canonical_skeleton(), quat_identity((60, JOINT_COUNT)), np.zeros((60, 3), np.float32), 60.0)
    )
    positions = np.zeros_like(body.positions)
    for name, height in (("LeftFoot", STANDING_ANKLE), ("LeftToeBase", STANDING_TOE)):
        positions[:, JOINT_NAMES.index(name), 1] = height + max(-side, 0.0)
        positions[:, JOINT_NAMES.index(name.replace("Left", "Right")), 1] = height + max(side, 0.0)
    positions[20 : 20 + frames, :, 1] += 20.0
    assert take_offs(replace(body, positions=positions)) == [foot] * count
