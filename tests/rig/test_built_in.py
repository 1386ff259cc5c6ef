"""The built-in rigs: motion on each and back, feet on the floor, all formats, and the rest pose as first frame."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.arrays import normalized
from motionkit.editing.rest_frame import with_rest_frame, with_rest_pose
from motionkit.errors import MotionkitError
from motionkit.export.clip import rig_clip
from motionkit.export.formats import WRITERS, read_motion
from motionkit.finish.on_rig import on_rig
from motionkit.motion.bvh import bvh_to_motion, read_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.leg_ik import TOE
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_angle, quat_rotate, quat_to_matrix
from motionkit.motion.skeleton import JOINT_NAMES
from motionkit.rig.built_in import BUILT_IN, rig_file
from motionkit.rig.on_rig import read_rig
from motionkit.rig.retarget import retarget
from motionkit.rig.rig import Rig
from motionkit.rig.soles import Sole
from motionkit.rig.standing_pose import ARMS
from motionkit.rig.to_rig import to_rig
from motionkit.rig.up_axis import turned_world, up_turn
from synthetic_motions import make_cartwheel, make_walk

SIDES = ("Left", "Right")
LIMBS = (("UpLeg", "Leg"), ("Leg", "Foot"), ("Arm", "ForeArm"), ("ForeArm", "Hand"))
BONES = [(f"{side}{upper}", f"{side}{lower}") for side, (upper, lower) in product(SIDES, LIMBS)]
MAKERS = pytest.mark.parametrize("make", [make_walk, make_cartwheel])


@pytest.fixture(params=BUILT_IN)
def rig(request: pytest.FixtureRequest) -> Rig:
    return mk.read_rig(f"@{request.param}")


def test_a_rig_is_a_person_of_175_cm(rig: Rig) -> None:
    """All joints but the second one of the neck are found by name, and left and right are alike."""
    assert set(rig.joints.missing()) <= {"Neck1"} and {rig.joints.found(n) for n in rig.joints.places} == {
        "name"
    }
    places = motion_kinematics(bvh_to_motion(read_bvh(rig_file(f"@{Path(rig.name).stem}"))))[1][0]
    for name, joint in rig.joints.places.items():
        mirrored = rig.place(name.replace("Left", "x").replace("Right", "Left").replace("x", "Right"))
        assert np.allclose(places[joint], places[mirrored] * [-1, 1, 1], atol=3e-5), name
    head, toe = rig.place("Head"), rig.place("LeftToeBase")
    assert head is not None and toe is not None
    assert 154 < places[head, 1] < 160 and 2.5 < places[toe, 1] < 2.8
    assert rig.leg == pytest.approx(84.585, abs=0.001)


@MAKERS
def test_limbs_keep_their_directions(rig: Rig, make: Callable[[], Motion]) -> None:
    source = make()
    here, there = motion_kinematics(source)[1], motion_kinematics(to_rig(source, rig))[1]
    for upper, lower in BONES:
        one = here[:, JOINT_NAMES.index(lower)] - here[:, JOINT_NAMES.index(upper)]
        other = there[:, rig.place(lower)] - there[:, rig.place(upper)]
        assert np.abs(normalized(one) - normalized(other)).max() < 4e-6, upper


@MAKERS
def test_back_from_a_file(rig: Rig, make: Callable[[], Motion], tmp_path: Path) -> None:
    source = make()
    mk.write(tmp_path / "out.bvh", mk.retarget(source, rig, ik=False, fps=source.fps))
    back = retarget(read_bvh(tmp_path / "out.bvh"), rig=rig)[0]
    index = [JOINT_NAMES.index(name) for name in rig.joints.places]
    one, other = (motion_kinematics(motion)[0][:, index] for motion in (source, back))
    assert np.rad2deg(quat_angle(one, other)).max() < 2e-4
    assert np.abs(back.root_positions - source.root_positions).max() < 2e-4


@MAKERS
def test_feet_are_on_the_floor(rig: Rig, make: Callable[[], Motion]) -> None:
    places = motion_kinematics(on_rig(make(), rig))[1]
    lower = places[:, [rig.place(f"{side}ToeBase") for side in SIDES], 1].min(axis=1)
    assert rig.stance is not None
    assert abs(np.quantile(lower, 0.25) - rig.stance / rig.scale) < TOE.slack and lower.min() > 2.3


def test_a_rest_frame_stands_also_where_the_rest_pose_has_another_up() -> None:
    """A rest pose along Y in a file whose floor has Z up."""
    quarter = np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0], np.float32)
    motion = turned_world(make_walk(60), quarter)
    made = motion_kinematics(with_rest_frame(motion))[1]
    hips, head = made[:2, 0], made[:2, JOINT_NAMES.index("Head")]
    assert (head - hips)[:, 2] == pytest.approx((head - hips)[1, 2], abs=3.0)
    assert made[0, :, 2].min() > -2.0


@pytest.mark.parametrize("ending", [ending for ending in WRITERS if ending not in (".vrm", ".fbx")])
def test_every_format(rig: Rig, ending: str, tmp_path: Path) -> None:
    """All formats but a .vrm, which is an avatar with a body of its own, and FBX, which needs Blender."""
    made = on_rig(make_walk(10), rig)
    path = tmp_path / f"out{ending}"
    mk.write(path, rig_clip(made, rig, "walk"))
    assert path.stat().st_size > 9000
    if ending in (".bvh", ".glb"):
        again = read_motion(path)
        assert set(again.skeleton.names) >= set(made.skeleton.names)
        index = [again.skeleton.index(name) for name in made.skeleton.names]
        there = motion_kinematics(again)[1][:, index]
        assert np.abs(there - motion_kinematics(made)[1]).max() < 1e-4


def test_lafan1_has_the_axes_that_retargeters_expect() -> None:
    """X along the bones; Y ahead in the spine and legs, up in the toes, and back in the arms of a T-pose."""
    bvh = read_bvh(rig_file("@lafan1"))
    axes = quat_to_matrix(motion_kinematics(bvh_to_motion(bvh))[0][0])
    right, up, ahead = -np.eye(3)[0], np.eye(3)[1], np.eye(3)[2]
    wanted = {"Hips": (up, ahead), "Spine2": (up, ahead), "LeftLeg": (-up, ahead), "RightLeg": (-up, ahead)}
    wanted |= {"LeftToe": (ahead, up), "LeftForeArm": (-right, -ahead), "RightForeArm": (right, -ahead)}
    for name, (x, y) in wanted.items():
        turn = axes[bvh.skeleton.index(name)]
        assert turn[:, 0] @ x > 0.994 and turn[:, 1] @ y > 0.999, name
    assert bvh.fps == pytest.approx(30.0)


def test_a_rest_frame_stands_on_soles(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mesh tells where the sole is, whatever height the toe joint has."""
    rig = read_rig("@mixamo")
    soles = tuple(Sole(np.zeros((0, 3)), np.zeros((0, 3)), depth, 4.0) for depth in (5.0, 6.5))
    monkeypatch.setattr("motionkit.editing.rest_frame.read_soles", lambda _: soles)
    places = motion_kinematics(with_rest_frame(on_rig(make_walk(60), rig), rig))[1]
    toes = [places[0, rig.joints.places[f"{side}ToeBase"], 1] * rig.scale for side in ("Left", "Right")]
    assert min(toes[0] - 5.0, toes[1] - 6.5) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("known", [True, False])
def test_a_rest_frame_stands_where_the_motion_begins(rig: Rig, known: bool) -> None:
    made = on_rig(make_walk(60, speed=20.0, swing=0.1, phase=1.0), rig)
    made = with_rest_frame(made, rig if known else None)
    assert len(made) == 61
    _, places = motion_kinematics(made)
    hips, toes = rig.place("Hips"), [rig.place(f"{side}ToeBase") for side in SIDES]
    assert np.abs(places[0, hips] - places[1, hips])[[0, 2]].max() < 1e-5
    assert rig.stance is not None
    assert np.allclose(places[0, toes, 1], rig.stance / rig.scale, atol=0.2)
    if not Path(rig.name).stem == "lafan1":
        assert np.abs(made.local_rotations[0, :, 1:]).max() == 0.0
    elif known:
        arms = places[0, rig.place("LeftHand")] - places[0, rig.place("LeftArm")]
        assert normalized(arms)[0] > 0.99999
    again = with_rest_frame(on_rig(make_walk(60, speed=20.0, swing=0.1, phase=1.0), rig), rig)
    assert np.array_equal(again.local_rotations[1:], made.local_rotations[1:])


@pytest.mark.parametrize(("name", "low"), ARMS.items())
def test_another_rest_pose_keeps_the_motion(rig: Rig, name: str, low: float) -> None:
    """Every joint stays where it was; the pose without rotations has arms so many degrees down and vertical legs."""
    made = on_rig(make_walk(60, phase=1.0), rig)
    with_final_rest = with_rest_pose(with_rest_frame(made, rig, name), name, rig)
    assert np.abs(motion_kinematics(with_final_rest)[1][1:] - motion_kinematics(made)[1]).max() < 2e-4
    assert np.abs(with_final_rest.local_rotations[0, :, 1:]).max() < 1e-6
    places = quat_rotate(up_turn(rig.up), with_final_rest.skeleton.rest_positions())
    arm, leg = math.radians(low), {"UpLeg": "Leg", "Leg": "Foot"}
    for side, left in (("Left", 1.0), ("Right", -1.0)):
        ways = dict.fromkeys(leg, (0.0, -1.0, 0.0)) | {"Arm": (left * math.cos(arm), -math.sin(arm), 0.0)}
        for part, way in ways.items():
            bone = places[rig.place(side + leg.get(part, "ForeArm"))] - places[rig.place(side + part)]
            assert normalized(bone) @ np.array(way) > 0.99999, part


def test_an_unknown_rig_has_a_hint() -> None:
    with pytest.raises(
        MotionkitError, match=r"unknown rig '@miximo'; did you mean '@mixamo'\? \(known: @mixamo, @u"
    ):
        mk.read_rig("@miximo")
