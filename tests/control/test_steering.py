from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from control.steered import AT_ONCE, FPS, FREE, walk_as_told
from motionkit.control.steering import (
    STANDS_BELOW,
    Gaits,
    Steering,
    SteeringOptions,
    steered_type,
    usual_gaits,
    walking_type,
)
from motionkit.models.bundled import load_bundled_model
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import Gait, MotionType
from oracle import steering as oracle
from oracle.steering import nearest_turn, spring, spring_rate, spring_travel


def numbers_of(steering: Steering, velocity: tuple[float, float], facing: float | None) -> list[float]:
    """The 24 numbers of a trajectory."""
    return steering.trajectory(FREE, velocity, facing)[0][0].tolist()


@pytest.mark.parametrize("seed", range(4))
def test_c_steers_as_python_does(seed: int) -> None:
    """Wishes and bodies at random: gaits, limits, speed controller, springs and anchor, frame by frame."""
    rng, model = np.random.default_rng(seed), load_bundled_model()
    ours, theirs = Steering(model), oracle.SteeringInPython(model, SteeringOptions())
    place, moves, wish, facing, kind = np.zeros(3), np.zeros(3), (0.0, 0.0), None, "idle"
    for frame in range(1500):
        if frame % 45 == 0:
            speed, angle = rng.choice([0.0, 10.0, 20.0, 90.0, 150.0, 400.0]), rng.uniform(-4.0, 4.0)
            wish = (speed * math.sin(angle), speed * math.cos(angle))
            facing = None if rng.random() < 0.5 else float(rng.uniform(-7.0, 7.0))
            moves = rng.normal(0.0, rng.choice([0.0, 2.0]), 3) * (1.0, 1.0, 0.02)
            kind = oracle.steered_type(model, wish, facing)
            assert ours.type(wish, facing) == kind
            kind = str(rng.choice([kind, kind, "walking", "running", "cartwheel", "dance-salsa"]))
        place += moves + np.array([200.0, 0.0, 0.0]) * (rng.random() < 0.005)
        free = bool(rng.random() < 0.02)
        for one in (ours, theirs.springs):
            one.observe(*place.tolist(), free)
        (numbers,), (settled,) = ours.trajectory(kind, wish, facing)
        expected, share = theirs.trajectory(kind, wish, facing)
        np.testing.assert_allclose(numbers, expected, rtol=1e-6, atol=1e-5)
        assert settled == pytest.approx(share, abs=1e-6)
        assert ours.speed == pytest.approx(math.hypot(*theirs.springs.velocity), abs=1e-6)


def test_a_spring_is_half_way_after_its_halflife_and_never_overshoots() -> None:
    y = spring_rate(0.3)
    assert spring(10.0, 0.0, y, 0.3)[0] == pytest.approx(5.0, abs=1e-4)
    ways = [spring(10.0, 0.0, y, t / 100)[0] for t in range(300)]
    assert all(a > b > 0 for a, b in pairwise(ways))


def test_a_spring_in_two_steps_is_one_in_one() -> None:
    y = spring_rate(0.2)
    away, velocity = spring(-3.0, 40.0, y, 0.1)
    assert spring(away, velocity, y, 0.25) == pytest.approx(spring(-3.0, 40.0, y, 0.35))


def test_the_way_of_a_spring_is_the_sum_of_its_distances() -> None:
    y, steps = spring_rate(0.2), 20000
    summed = sum(spring(50.0, -300.0, y, (i + 0.5) / steps)[0] for i in range(steps)) / steps
    assert spring_travel(50.0, -300.0, y, 1.0) == pytest.approx(summed, rel=1e-6)


def test_the_trajectory_begins_at_the_present_velocity() -> None:
    steering = Steering(load_bundled_model(), SteeringOptions(measured_share=0.02))
    for frame in range(120):  # runs along +Z while nobody steers
        steering.observe(0.0, 5.0 * frame, 0.0, True)
    numbers = numbers_of(steering, (0.0, 0.0), None)
    first, last = numbers[1], numbers[11]
    assert 0 < first < 50.0, "it has begun to slow down in the first 10 frames"
    assert first > 30.0, "but is not at rest at once"
    assert last < 1.2 * 300.0 * 0.15 * 2, "and halts in about two halflives"


def test_numbers_are_in_the_heading_frame() -> None:
    steering = Steering(load_bundled_model(), AT_ONCE)
    steering.observe(7.0, 9.0, math.pi / 2, False)  # faces +X
    numbers = numbers_of(steering, (0.0, 100.0), 0.0)  # is to go along +Z, which is to its right
    places, directions = numbers[:12], numbers[12:]
    assert all(x < 0 for x in places[0::2]) and max(map(abs, places[1::2])) < 1e-4
    turns = [math.atan2(s, c) for s, c in zip(directions[0::2], directions[1::2], strict=True)]
    assert all(a > b for a, b in pairwise(turns)), "turns right all the while"
    assert turns[-1] == pytest.approx(-math.pi / 2, abs=0.02)


@pytest.mark.parametrize("speed", [120.0, 300.0])
def test_a_body_that_turns_back_goes_about_where_it_faces(speed: float) -> None:
    options = SteeringOptions()
    track = walk_as_told(Steering(load_bundled_model(), options), (0.0, -speed), math.pi, 120)
    turns = [(b[2] - a[2]) * FPS for a, b in pairwise(track)]
    assert max(map(abs, turns)) < 1.1 * options.turn_speed
    assert track[-1][2] == pytest.approx(math.pi, abs=0.05)
    steps = [(b[0] - a[0], b[1] - a[1], b[2]) for a, b in pairwise(track[10:])]
    ahead = [x * math.sin(heading) + z * math.cos(heading) for x, z, heading in steps]
    assert min(ahead) > 0.0, "it never goes backwards"


def test_an_obedient_body_reaches_velocity_and_facing() -> None:
    track = walk_as_told(Steering(load_bundled_model()), (120.0, 0.0), math.pi / 2, 120)
    (x0, z0, _), (x1, z1, heading) = track[-2:]
    assert (x1 - x0) * FPS == pytest.approx(120.0, rel=0.03)
    assert abs(z1 - z0) * FPS < 1.0
    assert heading == pytest.approx(math.pi / 2, abs=0.03)


def test_one_who_stands_goes_back_to_where_it_stopped() -> None:
    steering = Steering(load_bundled_model())
    steering.observe(0.0, 0.0, 0.3, False)
    numbers_of(steering, (0.0, 0.0), None)
    steering.observe(12.0, 0.0, 0.0, False)  # drifted and turned
    numbers = numbers_of(steering, (0.0, 0.0), None)
    assert -12.5 < numbers[10] < -8.0, "the last place is most of the way back"
    assert math.atan2(numbers[22], numbers[23]) > 0.2, "and it turns back"


def test_one_who_was_carried_off_stays_there() -> None:
    steering = Steering(load_bundled_model())
    steering.observe(0.0, 0.0, 0.0, False)
    numbers_of(steering, (0.0, 0.0), None)
    for _ in range(90):
        steering.observe(300.0, 0.0, 0.0, False)
        numbers = numbers_of(steering, (0.0, 0.0), None)
    assert max(map(abs, numbers[:12])) < 5.0


def test_facing_turns_the_short_way() -> None:
    steering = Steering(load_bundled_model())
    steering.observe(0.0, 0.0, 3.0, False)
    numbers = numbers_of(steering, (0.0, 0.0), -3.0)
    turns = [math.atan2(s, c) for s, c in zip(numbers[12::2], numbers[13::2], strict=True)]
    assert all(0 < turn <= nearest_turn(-6.0) + 1e-6 for turn in turns)


@pytest.mark.parametrize(
    ("velocity", "facing", "kind"),
    [
        ((0.0, 0.0), None, "idle"),
        ((0.0, STANDS_BELOW), 1.0, "idle"),
        ((0.0, -18.0), 0.0, "idle"),
        ((0.0, 60.0), None, "walking"),
        ((80.0, 80.0), None, "walking"),
        ((0.0, 300.0), None, "running"),
        ((-400.0, 0.0), None, "running"),
        ((0.0, -100.0), 0.0, "b-walking"),
        ((0.0, -100.0), math.pi, "walking"),
        ((100.0, 0.0), 0.0, "walking"),
    ],
)
def test_type_by_velocity_and_facing(
    tiny_model: MotionModel, velocity: tuple[float, float], facing: float | None, kind: str
) -> None:
    gaits = {"idle": Gait(4.0, 0.0), "walking": Gait(116.0, 0.0), "running": Gait(312.0, 0.0)}
    gaits["b-walking"] = Gait(103.0, math.pi)
    types = {name: MotionType(gait=gait, steered=True) for name, gait in gaits.items()}
    model = replace(tiny_model, types=types | {"cartwheel": tiny_model.types["cartwheel"]})
    assert steered_type(model, velocity, facing) == kind


def test_a_model_without_the_usual_types_still_moves(tiny_model: MotionModel) -> None:
    gaits = {"limp": Gait(50.0, 0.0), "flip": Gait(50.0, 0.0, 2.0), "sprint": Gait(700.0, 0.0)}
    model = replace(tiny_model, types={name: MotionType(gait=gait) for name, gait in gaits.items()})
    assert steered_type(model, (0.0, 0.0), None) == "limp"
    assert steered_type(model, (600.0, 0.0), None) == "sprint"


def renamed(model: MotionModel, names: dict[str, str]) -> MotionModel:
    """The model with some types under other names."""
    return replace(model, types={names.get(name, name): kind for name, kind in model.types.items()})


def test_usual_gaits_are_found_from_motion_whatever_they_are_called() -> None:
    model = load_bundled_model()
    assert usual_gaits(model) == Gaits("idle", "walking", "running", "b-walking")
    names = {"idle": "running", "walking": "Lauf_02", "running": "zombie", "b-walking": "idle"}
    other = renamed(model, names)
    assert usual_gaits(other) == Gaits("running", "Lauf_02", "zombie", "idle")
    assert walking_type(other) == "Lauf_02"
    assert (
        steered_type(other, (0.0, 0.0), None) == "running"
        and steered_type(other, (0.0, 320.0), None) == "zombie"
    )


def test_a_model_may_lack_gaits() -> None:
    model = load_bundled_model()
    dances = replace(model, types={name: model.types[name] for name in ("dance-salsa", "running")})
    assert usual_gaits(dances) == Gaits(None, None, "running", None)
    assert walking_type(dances) == "running"


def test_feet_hold_the_root_of_a_body_that_does_what_is_wanted() -> None:
    steering = Steering(load_bundled_model())

    def settled(wish: tuple[float, float]) -> float:
        kept = type(steering.words).from_buffer_copy(steering.words)
        _, share = steering.trajectory(FREE, wish, 0.0)
        steering.words = kept
        return float(share[0])

    walk_as_told(steering, (0.0, 130.0), 0.0, 120)
    assert settled((0.0, 130.0)) > 0.9
    # Told to turn, to go back or to speed up, it is let go; to brake or to stand, its feet hold.
    assert settled((130.0, 0.0)) == settled((0.0, -130.0)) == settled((0.0, 160.0)) == 0.0
    assert settled((0.0, 100.0)) == settled((0.0, 0.0)) == 1.0
    shares = []
    for frame in range(60):
        steering.observe(frame * 130.0 / FPS, 260.0, 0.0, False)
        shares.append(steering.trajectory(FREE, (130.0, 0.0), 0.0)[1][0])
    assert shares[0] == 0.0 and min(shares[30:]) > 0.9
