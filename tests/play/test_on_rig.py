"""Live characters with the body of a user's rig: their pose on its joints in JSON frames, and their recordings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motionkit.models.model import MotionModel
from motionkit.motion.bvh import read_bvh, write_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_identity
from motionkit.motion.skeleton import JOINT_NAMES, leg_length
from motionkit.play.frames import CharacterState
from motionkit.play.on_rig import LiveRig, with_rig
from motionkit.play.recording import file_bytes
from motionkit.play.requests import parse_request
from motionkit.play.session import Session
from motionkit.rig.on_rig import read_rig
from motionkit.rig.rig import Rig
from synthetic_rigs import FAMILIES, renamed, walk

FEET = ("LeftFoot", "RightFoot", "LeftToeBase", "RightToeBase")


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    """A rig of other names and unit, Z up, with longer shins and a joint that motionkit does not know."""
    motion = renamed(walk(20), FAMILIES["unreal"])
    offsets = motion.skeleton.offsets.copy()
    offsets[[i for i, name in enumerate(motion.skeleton.names) if name.startswith("foot")]] *= 1.2
    skeleton = type(motion.skeleton)(
        motion.skeleton.names, motion.skeleton.parents, offsets, motion.skeleton.end_sites
    )
    moved = Motion(skeleton, motion.local_rotations, motion.root_positions * 1.1, motion.fps)
    write_bvh(tmp_path / "my.bvh", moved.scaled(0.01))
    return read_rig(tmp_path / "my.bvh")


def world(rig: Rig, pose: dict[str, Any]) -> np.ndarray:
    """Where the joints (J, 3) of a pose are, as the page says."""
    rotations, places = (np.array(pose[key], np.float32)[None] for key in ("rotations", "positions"))
    return motion_kinematics(Motion(rig.skeleton, rotations, places[:, 0], 60.0, places))[1][0]


def test_a_pose_is_on_the_joints_of_the_rig(tiny_model: MotionModel, rig: Rig) -> None:
    model = with_rig(tiny_model, rig)
    assert leg_length(model.character("my.bvh")) == pytest.approx(
        leg_length(model.character("default")), rel=1e-3
    )
    session = Session(model, rig.name)
    session.join(1)
    live = LiveRig(rig)
    for _ in range(3):
        (one,) = session.step().characters
    joints = live.as_dict()["joints"]
    assert joints == list(rig.skeleton.names) and len(live.pose(one)["rotations"]) == len(joints)
    places = world(rig, live.pose(one)) * rig.scale
    for name in ("LeftLeg", "RightArm", "Head", *FEET):
        mine, theirs = (
            at - thigh
            for at, thigh in (
                (places[rig.place(name)], places[rig.place("LeftUpLeg")]),
                (one.positions[JOINT_NAMES.index(name)], one.positions[JOINT_NAMES.index("LeftUpLeg")]),
            )
        )
        assert np.allclose(mine, theirs, atol=0.1), (
            name
        )  # cm; a trunk of other bones bends a little otherwise


def hips_between_thighs(rig: Rig) -> Rig:
    """The rig with its hips joint between its thighs, as high as they are, and 3 cm more from ankles down to toes."""
    offsets = rig.skeleton.offsets.copy()
    thighs, toes = (
        [rig.place(f"{side}{part}") for side in ("Left", "Right")] for part in ("UpLeg", "ToeBase")
    )
    offsets[rig.skeleton.children(0)] -= offsets[thighs].mean(axis=0)
    offsets[toes] -= 3.0 / rig.scale * rig.up.astype(np.float32)
    return replace(rig, skeleton=replace(rig.skeleton, offsets=offsets))


def test_feet_stand_on_the_floor_wherever_the_hips_joint_is(tiny_model: MotionModel, rig: Rig) -> None:
    """The body of a rig once stood 10 cm in the air, on its toes, if its hips joint was as high as its thighs."""
    other = hips_between_thighs(rig)
    model = with_rig(tiny_model, other)
    pose = replace(walk(1), local_rotations=quat_identity((1, len(JOINT_NAMES))))
    places = {
        name: motion_kinematics(replace(pose, skeleton=model.character(name)))[1]
        for name in ("default", other.name)
    }
    for foot in ("LeftToeBase", "RightToeBase"):
        joint = JOINT_NAMES.index(foot)
        assert np.allclose(places["default"][0, joint, 1], places[other.name][0, joint, 1], atol=0.1), foot
    live, shown = LiveRig(other), at_frame(pose, 0)
    on_rig = world(other, live.pose(shown)) * other.scale
    for name in ("LeftUpLeg", "RightLeg", "LeftFoot", "RightToeBase"):
        there = places[other.name][0, JOINT_NAMES.index(name)]
        lifted = on_rig[other.place(name)] - there
        assert np.allclose(lifted, live._lift, atol=0.02), name


def at_frame(motion: Motion, frame: int) -> CharacterState:
    """A live character in the pose of a frame."""
    rotations, places = motion.local_rotations[frame], motion_kinematics(motion)[1][frame]
    nothing = np.zeros(4, np.float32)
    return CharacterState(
        1, 0, 0, False, False, False, nothing, 0.0, motion.root_positions[frame], rotations, places
    )


def test_json_frames_have_the_rig(
    tiny_model: MotionModel, rig: Rig, serve: Callable[..., Any], tcp: Callable[..., Any]
) -> None:
    client = tcp(serve(tcp=0, rig=rig, model=with_rig(tiny_model, rig), body=rig.name))
    assert client.hello["rig"]["name"] == "my.bvh"
    assert client.hello["rig"]["parents"] == list(rig.skeleton.parents)
    (shown,) = client.until("frame")["characters"]
    assert len(shown["rig"]["positions"]) == len(rig.skeleton) and len(shown["positions"]) == 23
    client.ask(do="body", body="default")
    assert "rig" not in client.until("frame", lambda f: "rig" not in f["characters"][0])["characters"][0]


def test_without_a_rig_frames_are_as_ever(serve: Callable[..., Any], tcp: Callable[..., Any]) -> None:
    client = tcp(serve(tcp=0))
    assert "rig" not in client.hello and "rig" not in client.until("frame")["characters"][0]


def test_a_recording_of_the_body_is_on_the_rig(tiny_model: MotionModel, rig: Rig, tmp_path: Path) -> None:
    session = Session(with_rig(tiny_model, rig), rig.name)
    session.join(1)
    session.obey(1, parse_request('{"do": "add"}'))
    assert {one.body for one in session.characters.values()} == {rig.name}
    session.obey(1, parse_request('{"do": "record", "on": true}'))
    for _ in range(30):
        session.step()
    recorded = session.obey(1, parse_request('{"do": "record", "on": false}'))
    (tmp_path / "out.bvh").write_bytes(file_bytes(recorded.motion, rig))
    made = read_bvh(tmp_path / "out.bvh")
    assert made.skeleton.names == rig.skeleton.names and len(made.values) == 30
