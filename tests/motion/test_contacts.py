from __future__ import annotations

import numpy as np

from motionkit.arrays import Array
from motionkit.motion.contacts import CONTACT_SPEED, foot_contacts
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.skeleton import FOOT_JOINTS
from synthetic_motions import make_idle, make_jump, make_walk


def body(frames: int = 30) -> Array:
    """Joint positions (T, 23, 3) of standing feet: ankles at 10 cm, toes at 4 cm."""
    positions = np.full((frames, 23, 3), 100.0, np.float32)
    positions[:, FOOT_JOINTS, 1] = np.array([10.0, 4.0, 10.0, 4.0], np.float32)
    return positions


def test_standing_feet_touch() -> None:
    assert foot_contacts(body(), 60.0).all()


def test_a_high_foot_does_not_touch() -> None:
    positions = body()
    positions[:, FOOT_JOINTS[2], 1] = 20.0
    assert foot_contacts(positions, 60.0).mean(0).tolist() == [1.0, 1.0, 0.0, 1.0]


def test_a_fast_foot_does_not_touch() -> None:
    positions = body()
    positions[:, FOOT_JOINTS[1], 2] = 1.2 * CONTACT_SPEED / 60.0 * np.arange(30)
    assert foot_contacts(positions, 60.0).mean(0).tolist() == [1.0, 0.0, 1.0, 1.0]


def test_speed_is_per_second_not_per_frame() -> None:
    positions = body()
    positions[:, FOOT_JOINTS[1], 2] = 0.9 * CONTACT_SPEED / 60.0 * np.arange(30)
    assert foot_contacts(positions, 60.0)[:, 1].all()
    assert not foot_contacts(positions, 120.0)[:, 1].any()


def test_single_frame_flicker_is_removed() -> None:
    positions = body()
    positions[:, FOOT_JOINTS[0], 1] = 13.9
    positions[15, FOOT_JOINTS[0], 1] = 14.1
    assert foot_contacts(positions, 60.0).all()


def test_labels_of_motions() -> None:
    standing = foot_contacts(motion_kinematics(make_idle(60))[1], 60.0)
    assert standing.all()
    hop = foot_contacts(motion_kinematics(make_jump(100, side=1.0))[1], 60.0)
    assert not hop[:, 2:].any(), "the right leg is held up"
    assert 0.1 < float(hop[:, 1].mean()) < 0.9
    walk = foot_contacts(motion_kinematics(make_walk(200))[1], 60.0)
    assert set(np.unique(walk).tolist()) <= {0.0, 1.0}


def test_a_single_frame_is_labelled_by_height() -> None:
    positions = body(1)
    positions[:, FOOT_JOINTS[3], 1] = 30.0
    assert foot_contacts(positions, 60.0).tolist() == [[1.0, 1.0, 1.0, 0.0]]
