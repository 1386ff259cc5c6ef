"""Root height: hands stay above the ground, flights fall freely, nothing glides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import motionkit as mk
from motionkit.finish.root_height import HEIGHT, above_ground, in_the_air
from motionkit.metrics.flight import flights
from motionkit.metrics.touch import TOUCH_HEIGHTS, hover_share, touching
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import FOOT_JOINTS, JOINT_NAMES
from synthetic_motions import make_idle, make_walk

HANDS = [JOINT_NAMES.index(side + "Hand") for side in ("Left", "Right")]


def jump(acceleration: float, frames: int = 30) -> Motion:
    """A stiff body that stands, flies for some frames under an acceleration in m/s^2, and stands."""
    still = make_walk(4)
    stand = 20
    count = frames + 2 * stand
    lowest = float(motion_kinematics(still)[1][0, :, 1].min())
    t = np.clip(np.arange(count) - stand, 0, frames)
    heights = -0.5 * 100.0 * acceleration * t * (frames - t) / 60.0**2
    roots = np.repeat(still.root_positions[:1], count, axis=0)
    roots[:, 1] += (heights - lowest + 3.0).astype(np.float32)
    return replace(
        still, local_rotations=np.repeat(still.local_rotations[:1], count, axis=0), root_positions=roots
    )


def fall(motion: Motion) -> float:
    """The acceleration of the only flight of a motion."""
    positions = motion_kinematics(motion)[1]
    (flight,) = flights(positions, ~touching(positions))
    return flight.acceleration


@pytest.mark.parametrize("acceleration", [-13.0, -8.0, -6.0])
def test_a_flight_falls_freely_between_the_same_ends(acceleration: float) -> None:
    before = jump(acceleration)
    assert fall(before) == pytest.approx(acceleration, abs=0.1)
    after = in_the_air(before)
    assert fall(after) == pytest.approx(-9.81, abs=0.8)
    moved = after.root_positions - before.root_positions
    assert np.abs(moved[:, [0, 2]]).max() == 0.0 and np.array_equal(
        after.local_rotations, before.local_rotations
    )
    assert np.abs(moved[:20]).max() == 0.0 and np.abs(moved[-20:]).max() == 0.0, "who stands stays"
    assert (moved[35, 1] > 0.0) == (acceleration > -9.81)


@pytest.mark.parametrize(("frames", "corrected"), [(20, True), (26, True), (60, False)])
def test_a_body_that_leaves_the_ground_too_slowly_for_its_flight_stays(frames: int, corrected: bool) -> None:
    before = jump(-7.0, frames)
    assert np.array_equal(in_the_air(before).root_positions, before.root_positions) != corrected


def test_a_correction_comes_and_goes_smoothly() -> None:
    before = jump(-13.0)
    moved = (in_the_air(before).root_positions - before.root_positions)[:, 1]
    ends = np.flatnonzero(moved)
    assert np.abs(np.diff(moved, n=2)).max() < 0.35 * np.abs(moved).max()
    assert (
        np.abs(moved[ends[0] : ends[0] + 2]).max()
        < 0.3 * np.abs(moved[ends[0] : ends[0] + HEIGHT.ease_frames + 1]).max()
    )


@pytest.mark.parametrize(
    "acceleration", [-9.81 - HEIGHT.flight_error[1] - 1.0, -9.81 + HEIGHT.flight_error[1] + 1.0]
)
def test_what_is_no_flight_stays(acceleration: float) -> None:
    before = jump(acceleration, 40)
    assert np.array_equal(in_the_air(before).root_positions, before.root_positions)


def glide(height: float, frames: int = 14) -> Motion:
    """A stiff body that stands, is lifted so many cm above where it touches, for some frames, and stands."""
    still = make_walk(4)
    stand = 20
    count = frames + 2 * stand
    above = float((motion_kinematics(still)[1][0, :, 1] - TOUCH_HEIGHTS).min())
    t = np.clip(np.arange(count) - stand, 0, frames) / frames
    roots = np.repeat(still.root_positions[:1], count, axis=0)
    roots[:, 1] += (
        -HEIGHT.standing_depth - above + (height + HEIGHT.standing_depth) * np.sin(np.pi * t) ** 0.25
    ).astype(np.float32)
    return replace(
        still, local_rotations=np.repeat(still.local_rotations[:1], count, axis=0), root_positions=roots
    )


def test_a_body_that_glides_comes_down() -> None:
    before = glide(4.0)
    after = in_the_air(before)
    shares = [hover_share(motion_kinematics(motion)[1]).value for motion in (before, after)]
    assert shares[0] is not None and shares[0] > 0.15 and shares[1] is not None and shares[1] < 0.05
    moved = after.root_positions - before.root_positions
    assert np.abs(moved[:, [0, 2]]).max() == 0.0 and moved[:, 1].max() <= 1e-4
    assert np.abs(moved[:12]).max() == 0.0 and np.abs(moved[-12:]).max() == 0.0, "who stands stays"
    assert np.array_equal(after.local_rotations, before.local_rotations)


def test_what_flies_or_stands_does_not_in_the_air() -> None:
    short = glide(4.0).cut(24, 30)
    for motion in (
        glide(HEIGHT.floating_height + 1.0),
        glide(-0.5),
        jump(-9.81),
        jump(-9.81, 8),
        short,
        short.cut(0, 1),
    ):
        assert in_the_air(motion) is motion


def test_a_flight_at_the_end_of_a_motion_stays() -> None:
    whole = jump(-13.0)
    for cut in (whole.cut(30, len(whole)), whole.cut(0, 45), whole.cut(0, 2)):
        assert np.array_equal(in_the_air(cut).root_positions, cut.root_positions)


def test_synthesized_jumps_fall_freely_unless_feet_are_free() -> None:
    held = mk.synthesize("jumping-b:6", seed=3)
    positions = motion_kinematics(held.motion)[1]
    found = flights(positions, ~touching(positions))
    assert found and all(abs(each.error) < 1.5 for each in found if abs(each.error) < HEIGHT.flight_error[1])


def test_a_hand_in_the_floor_raises_the_body_softly() -> None:
    """A body that lies down with its arms 12 cm under the floor for ten frames."""
    motion = make_idle(120)
    roots = motion.root_positions.copy()
    positions = motion_kinematics(motion)[1]
    down = float(positions[:, HANDS, 1].min()) + 12.0
    roots[50:60, 1] -= down
    sunk = replace(motion, root_positions=roots)
    lifted = above_ground(sunk)
    rest = [joint for joint in range(23) if joint not in FOOT_JOINTS]
    low = motion_kinematics(lifted)[1][:, rest, 1].min(axis=1)
    assert float(low.min()) > -1e-3
    rise = (lifted.root_positions - sunk.root_positions)[:, 1]
    assert float(rise[50:60].max()) < float(-(positions[:, rest, 1] - down).min()) + 1e-3, (
        "no more than needed"
    )
    assert np.abs(rise[:29]).max() < 1e-6 and np.abs(rise[81:]).max() < 1e-6
    assert np.abs(np.diff(rise)).max() < 0.15 * rise.max(), "within a third of a second up and down"
