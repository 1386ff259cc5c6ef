"""VMC messages, read by a small OSC receiver in this file."""

from __future__ import annotations

import math
import socket
import struct
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.motion.rotations import quat_from_yaw, quat_multiply
from motionkit.motion.skeleton import JOINT_NAMES, Skeleton, canonical_skeleton
from motionkit.play.frames import CharacterState
from motionkit.play.vmc import VmcBody, osc_bundles, osc_message
from motionkit.rig.standing_pose import standing_turns
from play.conftest import PATIENCE

BONES = {"Hips", "Spine", "Chest", "Neck", "Head"} | {
    side + bone
    for side in ("Left", "Right")
    for bone in ("UpperLeg", "LowerLeg", "Foot", "Toes", "Shoulder", "UpperArm", "LowerArm", "Hand")
}
PARENTS = {
    "Spine": "Hips",
    "Chest": "Spine",
    "Neck": "Chest",
    "Head": "Neck",
    "LeftUpperLeg": "Hips",
    "LeftLowerLeg": "LeftUpperLeg",
    "LeftFoot": "LeftLowerLeg",
    "LeftToes": "LeftFoot",
    "LeftShoulder": "Chest",
    "LeftUpperArm": "LeftShoulder",
    "LeftLowerArm": "LeftUpperArm",
    "LeftHand": "LeftLowerArm",
}


def read_string(data: bytes, at: int) -> tuple[str, int]:
    end = data.index(b"\0", at)
    return data[at:end].decode("ascii"), end + 4 - end % 4


def read_osc(data: bytes) -> Iterator[tuple[str, list]]:
    """Address and arguments of all messages in a packet."""
    if data.startswith(b"#bundle\0"):
        at = 16
        while at < len(data):
            (size,) = struct.unpack_from(">i", data, at)
            yield from read_osc(data[at + 4 : at + 4 + size])
            at += 4 + size
        return
    address, at = read_string(data, 0)
    tags, at = read_string(data, at)
    arguments: list = []
    for tag in tags[1:]:
        if tag == "s":
            text, at = read_string(data, at)
            arguments.append(text)
        else:
            arguments.append(struct.unpack_from(">" + tag, data, at)[0])
            at += 4
    assert at == len(data)
    yield address, arguments


def shown(skeleton: Skeleton, rotations: Array, root: list[float], heading: float) -> CharacterState:
    nothing = np.zeros((23, 3), np.float32)
    place = np.array(root, np.float32)
    return CharacterState(
        1, 0, 0, False, None, False, np.zeros(4, np.float32), heading, place, rotations, nothing
    )


def read_pose(body: VmcBody, frame: CharacterState) -> dict[str, list[float]]:
    out = {}
    for bundle in osc_bundles(body.messages(frame, 1.5)):
        for address, arguments in read_osc(bundle):
            if address.endswith("/Pos"):
                out[arguments[0]] = arguments[1:]
    return out


def unity_multiply(a: list[float], b: list[float]) -> list[float]:
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]


def unity_turn(q: list[float], v: list[float]) -> list[float]:
    back = [-q[0], -q[1], -q[2], q[3]]
    return unity_multiply(unity_multiply(q, [*v, 0.0]), back)[:3]


def unity_world(pose: dict[str, list[float]], bone: str) -> tuple[list[float], list[float]]:
    """World position and rotation of a bone in Unity, from the local ones."""
    parent = "root" if bone == "Hips" else PARENTS.get(bone)
    if bone == "root":
        return pose["root"][:3], pose["root"][3:]
    assert parent is not None
    place, turn = unity_world(pose, parent)
    local = pose[bone]
    moved = unity_turn(turn, local[:3])
    return [a + b for a, b in zip(place, moved, strict=True)], unity_multiply(turn, local[3:])


def test_a_message_by_hand() -> None:
    assert osc_message("/a", "hips", 1, 0.5) == b"/a\0\0,sif\0\0\0\0hips\0\0\0\0\0\0\0\1\x3f\0\0\0"


def test_bundles_stay_below_their_limit_and_lose_nothing() -> None:
    messages = [osc_message("/n", i) for i in range(200)]
    bundles = osc_bundles(messages, 300)
    assert all(len(bundle) <= 300 for bundle in bundles) and len(bundles) > 10
    assert [a for bundle in bundles for _, a in read_osc(bundle)] == [[i] for i in range(200)]


def test_a_t_pose_has_no_rotations() -> None:
    skeleton = canonical_skeleton()
    world = standing_turns()
    parents = [max(parent, 0) for parent in skeleton.parents]
    inverse = world[parents] * np.array([1.0, -1.0, -1.0, -1.0], np.float32)
    local = quat_multiply(inverse, world)
    local[0] = world[0]
    pose = read_pose(VmcBody(skeleton), shown(skeleton, local, [0.0, 95.0, 0.0], 0.0))
    assert set(pose) == BONES | {"root"}
    for bone in BONES:
        assert pose[bone][3:] == pytest.approx([0, 0, 0, 1], abs=1e-5), bone
    foot, knee = unity_world(pose, "LeftFoot")[0], unity_world(pose, "LeftLowerLeg")[0]
    assert foot[0] == pytest.approx(knee[0], abs=1e-4) and foot[1] < knee[1], "legs hang straight down"
    assert pose["Hips"][:3] == pytest.approx([0.0, 0.95, 0.0], abs=1e-5), "metres"
    assert unity_world(pose, "LeftHand")[0][0] < -0.5, "left is along -X in Unity"


def test_places_mirror_the_world() -> None:
    skeleton = canonical_skeleton()
    rotations = np.zeros((23, 4), np.float32)
    rotations[:, 0] = 1.0
    turn = 0.7
    rotations[0] = quat_from_yaw(np.array(turn))
    arm = JOINT_NAMES.index("LeftArm")
    rotations[arm] = np.array([math.cos(0.5), 0.0, 0.0, math.sin(0.5)], np.float32)  # raises the left arm
    frame = shown(skeleton, rotations, [120.0, 90.0, -40.0], turn)
    pose = read_pose(VmcBody(skeleton), frame)
    from motionkit.motion.kinematics import forward_kinematics

    _, places = forward_kinematics(rotations, frame.root, skeleton.offsets, skeleton.parents)
    for bone, joint in (("LeftHand", "LeftHand"), ("Head", "Head"), ("LeftToes", "LeftToeBase")):
        x, y, z = (places[JOINT_NAMES.index(joint)] / 100.0).tolist()
        assert unity_world(pose, bone)[0] == pytest.approx([-x, y, z], abs=1e-4), bone
    assert pose["root"][:3] == pytest.approx([-1.2, 0.0, -0.4], abs=1e-5)
    assert pose["Hips"][:3] == pytest.approx([0.0, 0.9, 0.0], abs=1e-5)
    assert pose["Hips"][3:] == pytest.approx([0, 0, 0, 1], abs=1e-5), "the heading is in the root"
    # Mirrored at x: a left turn is about -Y in a left-handed world.
    assert pose["root"][3:] == pytest.approx([0, -math.sin(turn / 2), 0, math.cos(turn / 2)], abs=1e-5)
    raised = unity_turn(unity_world(pose, "LeftUpperArm")[1], [-1.0, 0.0, 0.0])
    assert raised[1] == pytest.approx(math.sin(1.0), abs=1e-4)


def test_frames_arrive_while_a_client_steers(serve: Callable, web: Callable) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(PATIENCE)
        server = serve(vmc=receiver.getsockname())
        client = web(server)
        kept = server.ask(lambda: server.server.live.session.kept)
        assert client.hello["character"] == kept, "the client steers the character that is sent"
        client.ask(do="wish", velocity=[0, 300])
        bones, oks, times = set(), [], []
        while len(times) < 20:
            packet = receiver.recv(65536)
            assert len(packet) <= 1400
            for address, arguments in read_osc(packet):
                if address == "/VMC/Ext/OK":
                    oks.append(arguments)
                elif address == "/VMC/Ext/T":
                    times.append(arguments[0])
                else:
                    assert len(arguments) == 8
                    assert math.isclose(math.hypot(*arguments[4:]), 1.0, abs_tol=1e-3)
                    bones.add(arguments[0])
        assert bones == BONES | {"root"} and oks == [[1]] * 20
        assert times == sorted(times)
        client.socket.close()
        server.wait_until(lambda: not server.server.live.clients)
        assert receiver.recv(65536), "it stands on without a client"


def test_nobody_there_to_receive(serve: Callable, web: Callable) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as closed:
        closed.bind(("127.0.0.1", 0))
        target = closed.getsockname()
    client = web(serve(vmc=target))
    for _ in range(10):
        client.until("frame")
