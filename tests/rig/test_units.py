"""Detection of units from leg lengths."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.export.formats import read_motion, write_motion
from motionkit.motion.bvh import POSITION_CHANNELS, bvh_to_motion, motion_to_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.rotations import quat_inverse, quat_multiply, quat_rotate
from motionkit.motion.skeleton import LEG_TO_STATURE, canonical_skeleton, leg_length
from motionkit.reading import reading
from motionkit.rig.retarget import retarget_file, to_local
from motionkit.rig.units import SHORTEST, TALLEST, UNITS, Unit, guess_scale, motion_unit
from motionkit.rig.up_axis import named_up, turned_world, up_turn
from motionkit.rig.upright import Upright, in_metres


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("height", [150.0, 172.0, 195.0])
def test_a_human_in_any_known_unit_is_recognised(unit: Unit, height: float) -> None:
    leg = LEG_TO_STATURE * height / unit.cm
    scale, source = guess_scale(leg)
    assert scale == unit.cm
    assert unit.name in source


def test_the_canonical_skeleton_is_in_centimetres() -> None:
    leg = leg_length(canonical_skeleton())
    assert guess_scale(leg)[0] == 1.0
    assert SHORTEST < leg / LEG_TO_STATURE < TALLEST


@pytest.mark.parametrize("leg", [0.02, 3.9, 1e6])
def test_no_known_unit_scales_to_a_typical_body_and_says_so(leg: float) -> None:
    scale, source = guess_scale(leg)
    assert leg * scale / LEG_TO_STATURE == pytest.approx(172.0)
    assert "no known unit" in source


@pytest.mark.parametrize("ending", ["glb", "npz"])
def test_formats_that_say_their_unit_and_up_axis_are_believed(
    make_motion, tmp_path: Path, ending: str
) -> None:
    """A doll that lies on its back stays 50 cm tall, and lies."""
    lying = turned_world(make_motion(30), up_turn(named_up("+Z"))).scaled(0.3)
    lying = replace(lying, skeleton=replace(lying.skeleton, cm=1.0, up="+Y"))
    write_motion(tmp_path / f"a.{ending}", lying)
    motion = read_motion(tmp_path / f"a.{ending}")
    found = in_metres(motion)
    assert found.up.tolist() == [0.0, 1.0, 0.0] and found.note.endswith("as the format says")
    assert np.abs(motion_kinematics(found.motion)[1] * 100.0 - motion_kinematics(lying)[1]).max() < 0.01
    assert retarget_file(tmp_path / f"a.{ending}")[1].scale == (1.0 if ending == "npz" else 100.0)
    upright = Upright.of(motion)
    back = upright.back(upright.motion)
    assert np.abs(motion_kinematics(back)[1] - motion_kinematics(motion)[1]).max() < 1e-3
    with reading(up="+Z", cm=2.0):
        assert in_metres(motion).up.tolist() == [0.0, 0.0, 1.0] and motion_unit(motion)[0] == 2.0


def test_a_format_is_not_believed_where_all_bodies_stand_along_another_axis(
    make_motion, tmp_path: Path
) -> None:
    """As of programs that write Z up into a .glb."""
    motion = make_motion(30)
    tilt = quat_inverse(up_turn(named_up("+Z")))
    skeleton = replace(
        motion.skeleton, offsets=quat_rotate(tilt, motion.skeleton.offsets), end_sites={}, up="+Y"
    )
    turned = quat_multiply(motion_kinematics(turned_world(motion, tilt))[0], quat_inverse(tilt))
    written = replace(motion, skeleton=skeleton, local_rotations=to_local(turned))
    assert in_metres(written).up.tolist() == [0.0, 0.0, 1.0]


def test_legs_are_measured_where_channels_put_the_joints(make_motion) -> None:
    motion = make_motion(10)
    places = np.broadcast_to(motion.skeleton.offsets, (10, 23, 3)).copy()
    channels = ((*POSITION_CHANNELS, "Zrotation", "Yrotation", "Xrotation"),) * 23
    names = tuple(f"b_{name}" for name in motion.skeleton.names)  # of another rig
    for factor in (0.0, 0.3):
        skeleton = replace(motion.skeleton.scaled(factor), names=names)
        small = bvh_to_motion(
            motion_to_bvh(replace(motion, skeleton=skeleton, local_positions=places), channels)
        )
        assert motion_unit(small)[0] == 1.0
