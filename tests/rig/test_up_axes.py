"""A clip with another axis up is edited as the same clip with Y up."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.editing.fix import fix_motion
from motionkit.editing.root_motion import in_place
from motionkit.export.formats import read_motion
from motionkit.motion.bvh import motion_to_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_inverse
from motionkit.reading import reading
from motionkit.rig.mirror import mirror_motion
from motionkit.rig.retarget import retarget
from motionkit.rig.units import motion_unit
from motionkit.rig.up_axis import named_up, turned_world, up_axis, up_name, up_turn
from motionkit.rig.upright import Upright, in_metres

pytestmark = pytest.mark.thorough

WALK = Path(__file__).resolve().parents[2] / "examples" / "data" / "06_06.bvh"
AXES = {"X": (1, 0, 0), "-X": (-1, 0, 0), "Z": (0, 0, 1), "-Z": (0, 0, -1)}


@pytest.fixture(scope="module")
def walk() -> Motion:
    return read_motion(WALK).cut(20, 200)


@pytest.fixture(params=AXES)
def up(request: pytest.FixtureRequest) -> np.ndarray:
    return np.array(AXES[request.param], np.float32)


def tilted(motion: Motion, up: np.ndarray) -> Motion:
    return turned_world(motion, quat_inverse(up_turn(up)))


def positions(motion: Motion) -> np.ndarray:
    return motion_kinematics(motion)[1]


def test_the_axis_is_seen(walk: Motion, up: np.ndarray) -> None:
    made = tilted(walk, up)
    assert up_axis(positions(made), made.skeleton).tolist() == up.tolist()
    assert in_metres(made).note.endswith(f"; {up_name(up)} up")
    assert np.abs(positions(in_metres(made).motion) - positions(in_metres(walk).motion)).max() < 1e-4
    assert np.abs(positions(Upright.of(made).back(Upright.of(made).motion)) - positions(made)).max() < 1e-3


def test_a_body_upside_down_for_a_whole_clip_keeps_its_axis(walk: Motion) -> None:
    handstand = turned_world(walk, np.array([0.0, 1.0, 0.0, 0.0], np.float32))
    assert positions(handstand)[..., 1] == pytest.approx(-positions(walk)[..., 1], abs=1e-3)
    assert up_axis(positions(handstand), handstand.skeleton).tolist() == [0.0, 1.0, 0.0]


@pytest.mark.parametrize("turn", [0.0, 0.5 * np.pi, 1.0])
def test_a_body_on_the_floor_for_a_whole_clip_keeps_its_axis(walk: Motion, turn: float) -> None:
    still = replace(walk.cut(0, 60), root_positions=np.repeat(walk.root_positions[:1], 60, axis=0))
    lying = turned_world(still, np.array([0.5**0.5, 0.5**0.5, 0.0, 0.0], np.float32)).turned(turn)
    away = np.array([60.0, 3.0 - positions(lying)[..., 1].min(), -40.0], np.float32)
    lying = replace(lying, root_positions=lying.root_positions + away)
    assert np.ptp(positions(lying)[..., 1]) < 0.6 * np.ptp(positions(walk)[..., 1])
    assert up_axis(positions(lying), lying.skeleton).tolist() == [0.0, 1.0, 0.0]
    assert retarget(motion_to_bvh(lying))[1].notes == retarget(motion_to_bvh(walk))[1].notes


@pytest.mark.parametrize("name", ["+Y", "+Z"])
def test_a_body_that_bends_forward_keeps_its_axis(walk: Motion, name: str) -> None:
    """The rest pose is along Y in either file; the ground tells a kneeling body in a Z-up world from a lying one."""
    still = replace(walk.cut(0, 60), root_positions=np.repeat(walk.root_positions[:1], 60, axis=0))
    lean = np.array([np.cos(0.35), np.sin(0.35), 0.0, 0.0], np.float32)
    bent = turned_world(still, lean)
    away = np.array([150.0, 3.0 - positions(bent)[..., 1].min(), 200.0], np.float32)
    made = tilted(replace(bent, root_positions=bent.root_positions + away), named_up(name))
    assert up_name(up_axis(positions(made), made.skeleton)) == name


def test_what_the_user_says_overrides_what_is_found(walk: Motion) -> None:
    with reading(up="-Z", cm=10.0):
        brought, upright = in_metres(walk), Upright.of(walk)
        assert brought.scale == pytest.approx(0.1) and brought.up.tolist() == [0.0, 0.0, -1.0]
        hips = 10.0 * positions(turned_world(walk, up_turn(brought.up)))[:, 0]
        assert (
            np.abs(upright.positions[:, 0] - hips).max() < 3.0
        )  # canonical hips lie elsewhere between the thighs
    assert in_metres(walk).scale == pytest.approx(0.01 * motion_unit(walk)[0])


def test_repairs_are_the_same(walk: Motion, up: np.ndarray) -> None:
    wanted, made = fix_motion(walk), fix_motion(tilted(walk, up))
    moved = np.abs(positions(wanted.motion) - positions(walk)).max()
    assert moved > 0.1, "nothing was repaired"
    assert np.abs(positions(made.motion) - positions(tilted(wanted.motion, up))).max() < 0.02 * moved


def test_in_place_is_the_same(walk: Motion, up: np.ndarray) -> None:
    wanted, made = in_place(walk), in_place(tilted(walk, up))
    assert np.abs(positions(made) - positions(tilted(wanted, up))).max() < 1e-3


def test_a_mirrored_clip_stays_upright(walk: Motion, up: np.ndarray) -> None:
    made = mirror_motion(tilted(walk, up))
    assert up_axis(positions(made), made.skeleton).tolist() == up.tolist()
    wanted = positions(mirror_motion(walk))[..., 1]
    assert np.abs(positions(made) @ up - wanted).max() < 1e-3
