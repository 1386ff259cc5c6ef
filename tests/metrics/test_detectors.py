"""Each detector accepts a motion made to show its type, and rejects similar ones."""

from __future__ import annotations

import math
from collections.abc import Callable
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


# ---- bounds: what is measured of a body just within and just beyond each ----


FRAMES = 240


class Measured:
    """A body of which only the measures are known; those not given are of no motion at all."""

    fps = 60.0
    flat = ("speed", "foot_ahead", "head_height", "ankle_height")
    pairs = ("velocity", "lifts", "hand_heights", "arm_extension", "arm_ahead", "arm_thrust")

    def __init__(self, **given: object) -> None:
        self.__dict__ |= {name: np.zeros(FRAMES) for name in self.flat}
        self.__dict__ |= {name: np.zeros((FRAMES, 2)) for name in self.pairs}
        self.positions, self.turned = np.zeros((FRAMES, 1, 3)), np.zeros((FRAMES, 3))
        self.flights, self.flight, self.stride_flight, self.joints = [], 0.0, 0, 0.0
        self.__dict__ |= given

    def __len__(self) -> int:
        return FRAMES

    def cut(self, start: int, end: int) -> Measured:
        return self

    def joint_speed(self) -> float:
        return self.joints

    def flight_seconds(self) -> float:
        return self.flight

    def stride_flight_frames(self) -> int:
        return self.stride_flight


def going(speed: float, ahead: float, swing: float = 30.0, flight: int = 0) -> Measured:
    """Legs swing by 30 cm, at a speed in m/s and one ahead."""
    velocity = np.tile([0.0, ahead], (FRAMES, 1))
    lead = np.linspace(0.0, swing, FRAMES)
    return Measured(speed=np.full(FRAMES, speed), velocity=velocity, foot_ahead=lead, stride_flight=flight)


def between(outside: float, inside: float) -> Array:
    """A measure that is another one from frame 50 to 70."""
    values = np.full(FRAMES, outside)
    values[50:70] = inside
    return values


def kick(
    ankle: float = 40.0, hands: float = 60.0, head: float = 50.0, spin: float = 5.0, flight: float = 0.3,
    late: int = 0,
) -> Measured:  # fmt: skip
    """An ankle that is high from frame 50 to 70; the body spins some frames after that, by radians."""
    turned = np.zeros((FRAMES, 3))
    turned[70 + late :, 1] = spin
    return Measured(
        ankle_height=between(-50.0, ankle), hand_heights=np.full((FRAMES, 2), hands),
        head_height=np.full(FRAMES, head), turned=turned, flight=flight,
    )  # fmt: skip


def thrust(
    extension: float = 0.95, ahead: float = 0.8, height: float = 30.0, speed: float = 70.0,
    bent: float = 0.7, seconds: float = 0.4,
) -> Measured:  # fmt: skip
    """An arm that thrusts while it is bent, and is straight after some seconds."""
    at = 30 + round(60 * seconds)
    arms = {
        name: np.zeros((FRAMES, 2)) for name in ("arm_extension", "arm_ahead", "arm_thrust", "hand_heights")
    }
    arms["arm_extension"][:, 0] = 0.85
    arms["arm_thrust"][30, 0], arms["arm_extension"][30, 0] = speed, bent
    arms["arm_extension"][at, 0], arms["arm_ahead"][at, 0], arms["hand_heights"][at, 0] = (
        extension,
        ahead,
        height,
    )
    return Measured(**arms)


def over(
    forwards: float = 0.0, spin: float = 0.0, sideways: float = 0.0, hands: float = 60.0, hips: float = 90.0,
    flight: float = 0.0, up_after: float = 0.5, up: float = 50.0,
) -> Measured:  # fmt: skip
    """A head below the hips from frame 50 to 70 that is up again after some seconds; angles in radians."""
    head, turned = between(0.0, -30.0), np.zeros((FRAMES, 3))
    head[70 + round(60 * up_after)] = up
    turned[60:] = forwards, spin, sideways
    positions = np.zeros((FRAMES, 1, 3))
    positions[:, 0, 1] = hips
    return Measured(
        head_height=head, turned=turned, hand_heights=np.full((FRAMES, 2), hands), positions=positions,
        flight=flight,
    )  # fmt: skip


def duck(
    speed: float = 1.2, head: float = 0.0, ankle: float = 0.0, up: float = 50.0, after: float = 1.0
) -> Measured:
    heights = between(20.0, head)
    heights[70 + round(60 * after)] = up
    return Measured(speed=np.full(FRAMES, speed), head_height=heights, ankle_height=np.full(FRAMES, ankle))


def idle(speed: float = 0.0, lift: float = 0.0, joints: float = 0.0) -> Measured:
    return Measured(speed=np.full(FRAMES, speed), lifts=np.full((FRAMES, 2), lift), joints=joints)


@pytest.mark.parametrize(
    ("kind", "make", "given", "beyond"),
    [
        ("idle", idle, {"speed": 0.149}, {"speed": 0.151}),
        ("idle", idle, {"lift": 9.9}, {"lift": 10.1}),
        ("idle", idle, {"joints": 0.99}, {"joints": 1.01}),
        ("walking", going, {"speed": 0.41, "ahead": 0.4}, {"speed": 0.39}),
        ("walking", going, {"speed": 1.99, "ahead": 1.9}, {"speed": 2.01}),
        ("walking", going, {"speed": 1.0, "ahead": 0.51}, {"ahead": 0.49}),
        ("walking", going, {"speed": 1.0, "ahead": 0.9, "swing": 25.1}, {"swing": 24.9}),
        ("walking", going, {"speed": 1.0, "ahead": 0.9, "flight": 2}, {"flight": 3}),
        ("b-walking", going, {"speed": 0.31, "ahead": -0.3}, {"speed": 0.29}),
        ("b-walking", going, {"speed": 1.99, "ahead": -1.9}, {"speed": 2.01}),
        ("b-walking", going, {"speed": 1.0, "ahead": -0.51}, {"ahead": -0.49}),
        ("b-walking", going, {"speed": 1.0, "ahead": -0.9, "flight": 2}, {"flight": 3}),
        ("running", going, {"speed": 1.41, "ahead": 1.4, "flight": 2}, {"speed": 1.39}),
        ("running", going, {"speed": 7.9, "ahead": 7.0, "flight": 2}, {"speed": 8.1}),
        ("running", going, {"speed": 3.0, "ahead": 2.9, "flight": 2}, {"flight": 1}),
        ("running", going, {"speed": 3.0, "ahead": 2.9, "flight": 2}, {"ahead": -2.9}),
        ("kicking", kick, {"ankle": 0.1}, {"ankle": -0.1}),
        ("kicking", kick, {"hands": 40.1}, {"hands": 39.9}),
        ("kicking", kick, {"head": 10.1}, {"head": 9.9}),
        ("w-kicking", kick, {"ankle": 30.1}, {"ankle": 29.9}),
        ("w-kicking", kick, {"flight": 0.21}, {"flight": 0.19}),
        ("w-kicking", kick, {"spin": 4.1}, {"spin": 3.9}),
        ("w-kicking", kick, {"late": 44}, {"late": 46}),
        ("punching", thrust, {"extension": 0.91}, {"extension": 0.89}),
        ("punching", thrust, {"ahead": 0.76}, {"ahead": 0.74}),
        ("punching", thrust, {"height": 20.1}, {"height": 19.9}),
        ("punching", thrust, {"speed": 65.1}, {"speed": 64.9}),
        ("punching", thrust, {"bent": 0.79}, {"bent": 0.81}),
        ("punching", thrust, {"seconds": 0.5}, {"seconds": 0.52}),
        ("cartwheel", over, {"sideways": 3.1, "hands": 25.0}, {"sideways": 2.9}),
        ("cartwheel", over, {"sideways": 3.1, "hands": 25.0}, {"hands": 25.1}),
        ("cartwheel", over, {"sideways": 3.1, "hands": 25.0, "hips": 50.1}, {"hips": 49.9}),
        ("cartwheel", over, {"sideways": 3.1, "hands": 25.0, "spin": 3.9}, {"spin": 4.1}),
        ("cartwheel", over, {"sideways": 3.1, "hands": 25.0, "up": 25.1}, {"up": 24.9}),
        ("cartwheel", over, {"sideways": 3.1, "hands": 25.0, "up_after": 1.48}, {"up_after": 1.5}),
        ("backflip", over, {"forwards": -4.1}, {"forwards": -3.9}),
        ("backflip", over, {"forwards": -4.1, "hands": 25.1}, {"hands": 25.0}),
        ("handspring", over, {"forwards": 3.1, "hands": 25.0}, {"forwards": 2.9}),
        ("handspring", over, {"forwards": 3.1, "hands": 25.0, "sideways": 3.0}, {"sideways": 3.2}),
        ("handspring", over, {"forwards": 3.1, "hands": 25.0}, {"hands": 25.1}),
        ("handspring", over, {"forwards": 3.1, "hands": 25.0, "hips": 50.1}, {"hips": 49.9}),
        ("side-somersault", over, {"sideways": 3.1}, {"sideways": 2.9}),
        ("side-somersault", over, {"sideways": 3.1, "hands": 25.1}, {"hands": 25.0}),
        ("side-somersault", over, {"sideways": 3.1, "spin": 3.9}, {"spin": 4.1}),
        ("dive-roll", over, {"forwards": 2.6, "hips": 39.9}, {"forwards": 2.4}),
        ("dive-roll", over, {"forwards": 2.6, "hips": 39.9}, {"hips": 40.1}),
        ("twist", over, {"spin": 4.1, "flight": 0.31}, {"spin": 3.9}),
        ("twist", over, {"spin": 4.1, "flight": 0.31}, {"flight": 0.29}),
        ("duck", duck, {"speed": 1.01}, {"speed": 0.99}),
        ("duck", duck, {"head": 4.9}, {"head": 5.1}),
        ("duck", duck, {"ankle": 9.9}, {"ankle": 10.1}),
        ("duck", duck, {"up": 25.1}, {"up": 24.9}),
        ("duck", duck, {"after": 1.48}, {"after": 1.5}),
    ],
)
def test_what_is_within_and_beyond_each_bound(
    kind: str, make: Callable[..., Body], given: dict[str, float], beyond: dict[str, float]
) -> None:
    assert DETECTORS[kind].shows(make(**given))
    assert not DETECTORS[kind].shows(make(**given | beyond))


@pytest.mark.parametrize(("gap", "count"), [(11, 1), (12, 2)])
def test_turns_that_follow_soon_are_one(gap: int, count: int) -> None:
    head = between(0.0, -30.0)
    head[70 + gap : 90 + gap] = -30.0
    found = turns(Measured(head_height=head))
    assert [round(turn.seconds * 60) for turn in found] == ([40 + gap] if count == 1 else [20, 20])


@pytest.mark.parametrize(
    ("kinds", "shows"), [("lb", True), ("lbb", False), ("lrl", True), ("", False), ("b", False)]
)
def test_a_jump_from_a_foot_is_half_of_the_flights(kinds: str, shows: bool) -> None:
    lifts, flights = np.zeros((FRAMES, 2)), []
    for number, kind in enumerate(kinds):
        start = 60 * (number + 1)
        lifts[start - 9 : start, {"l": 1, "r": 0}.get(kind, 0)] = 0.0 if kind == "b" else 20.0
        lifts[start - 10] = 1000.0  # before the take-off
        flights.append((start, start + 12))
    body = Measured(lifts=lifts, flights=flights, head_height=np.ones(FRAMES))
    assert take_offs(body) == list(kinds) and DETECTORS["jumping-l"].shows(body) == shows
    assert not DETECTORS["jumping-l"].shows(
        Measured(lifts=lifts, flights=flights, head_height=-np.ones(FRAMES))
    )
    assert take_offs(Measured(flights=[(0, 30)])) == [], "a flight whose take-off is not seen"


@pytest.mark.parametrize(("side", "row"), [("Left", 0), ("Right", 1)])
def test_a_foot_is_lifted_as_far_as_the_lower_of_ankle_and_toe(side: str, row: int) -> None:
    body = body_of(make_idle(2))
    positions = np.zeros_like(body.positions)
    for ankle, toe in ((3.0, 7.0), (9.0, 4.0), (-1.0, 2.0)):
        positions[:, JOINT_NAMES.index(f"{side}Foot"), 1] = STANDING_ANKLE + ankle
        positions[:, JOINT_NAMES.index(f"{side}ToeBase"), 1] = STANDING_TOE + toe
        assert replace(body, positions=positions).lifts[:, row] == pytest.approx(min(ankle, toe), abs=1e-4)
