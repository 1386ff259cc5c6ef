"""Numpy archives: motionkit's own come back, SMPL poses stand on the mean body, anything else is one line."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motionkit.data.labels import find_sources
from motionkit.errors import MotionkitError
from motionkit.export.formats import read_motion, write_motion
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.rotations import expmap_to_quat, quat_multiply, quat_to_expmap
from motionkit.motion.smpl import smpl_skeleton
from motionkit.reading import reading
from motionkit.rig.retarget import retarget_file
from motionkit.rig.upright import describe_motion
from synthetic_motions import make_walk
from synthetic_rigs import FAMILIES, renamed, walk


def amass(frames: int = 40, joints: int = 52, z_up: bool = True) -> dict[str, Any]:
    """A walk as AMASS has it: exponential maps of all joints, in a world with Z up."""
    made = renamed(walk(frames), FAMILIES["smpl"])
    names = smpl_skeleton(hands=True).names
    turns = np.zeros((frames, joints, 3))
    for joint, name in enumerate(made.skeleton.names):
        turns[:, names.index(name)] = quat_to_expmap(made.local_rotations[:, joint].astype(np.float64))
    places = made.root_positions / 100.0
    if z_up:
        tilt = np.broadcast_to(expmap_to_quat(np.array([np.pi / 2, 0.0, 0.0])), (frames, 4))
        turns[:, 0] = quat_to_expmap(quat_multiply(tilt, expmap_to_quat(turns[:, 0])))
        places = places[:, [0, 2, 1]] * [1.0, -1.0, 1.0]
    more = {"betas": np.zeros(16), "gender": np.array({"not": "read"}, dtype=object)}
    return {"poses": turns.reshape(frames, -1), "trans": places, "mocap_framerate": 60.0, **more}


@pytest.mark.parametrize(
    ("joints", "z_up", "kind", "left"),
    [
        (52, True, "SMPL-H", "betas and fingers"),
        (55, True, "SMPL-X", "betas and fingers"),
        (24, True, "SMPL", "betas"),
        (24, False, "SMPL", "betas"),
        (22, True, "SMPL's body", "betas"),
    ],
)
def test_poses_of_smpl(tmp_path: Path, joints: int, z_up: bool, kind: str, left: str) -> None:
    """The mean body of 1.7 m stands where trans has it, in a world that is found; every command maps it."""
    arrays = amass(joints=joints, z_up=z_up)
    np.savez(tmp_path / "a.npz", **arrays)
    told: list[str] = []
    with reading(on_note=told.append):
        motion = read_motion(tmp_path / "a.npz")
        made, report = retarget_file(tmp_path / "a.npz")
    assert told == [f"a.npz: read with poses of {kind} on its mean body; {left} left out"] * 2
    up = "+Z up, and stays so in BVH" if z_up else "+Y up"
    assert (
        describe_motion(motion)
        == f"40 frames at 60 fps; unit: metres, as the format says; {up}; 22 joints found by name (no Neck1)"
    )
    assert len(motion.skeleton) == (24 if joints == 24 else 22) and motion.fps == 60.0
    assert np.allclose(motion.root_positions - arrays["trans"], motion.skeleton.offsets[0], atol=1e-6)
    assert (
        report.scale == 100.0 and report.missing == ("Neck1",) and not any("shape" in n for n in report.notes)
    )
    assert 70.0 < made.root_positions[:, 1].mean() < 105.0 and made.root_positions[:, 1].std() < 3.0


def test_zero_poses_are_the_rest_pose_and_the_halves_of_a_pose_are_read(tmp_path: Path) -> None:
    turns = np.random.default_rng(0).normal(0, 0.3, (5, 66))
    places = np.random.default_rng(1).normal(0, 1, (5, 3))
    np.savez(tmp_path / "zero.npz", poses=np.zeros((5, 72)), trans=places)
    np.savez(tmp_path / "whole.npz", poses=turns, trans=places, mocap_frame_rate=np.array([50]))
    np.savez(tmp_path / "parts.npz", root_orient=turns[:, :3], pose_body=turns[:, 3:], trans=places, fps=50)
    with reading(on_note=(told := []).append):  # type: ignore[attr-defined]
        zero, whole, parts = (read_motion(tmp_path / f"{name}.npz") for name in ("zero", "whole", "parts"))
    assert zero.fps == 30.0 and "30 frames a second, because" in told[0]
    rest = smpl_skeleton(hands=True)
    want = rest.rest_positions() + rest.offsets[0] + places[:, None]
    assert np.allclose(motion_kinematics(zero)[1], want, atol=1e-5)
    assert whole.fps == parts.fps == 50.0 and np.array_equal(whole.local_rotations, parts.local_rotations)


@pytest.mark.parametrize("translates", [False, True])
def test_own_archives_come_back(tmp_path: Path, translates: bool) -> None:
    walked = make_walk(20)
    if translates:
        places = np.broadcast_to(walked.skeleton.offsets, (20, 23, 3)).copy()
        places[:, 4, 2] += np.linspace(0.0, 3.0, 20)
        walked = type(walked)(walked.skeleton, walked.local_rotations, walked.root_positions, 60.0, places)
    write_motion(tmp_path / "a.npz", walked)
    again = read_motion(tmp_path / "a.npz")
    assert again.skeleton.same_hierarchy(walked.skeleton) and again.fps == 60.0
    assert again.skeleton.end_sites.keys() == walked.skeleton.end_sites.keys()
    assert np.abs(motion_kinematics(again)[1] - motion_kinematics(walked)[1]).max() < 1e-3


def test_values_without_a_number_are_filled_as_in_other_files(tmp_path: Path) -> None:
    arrays = amass()
    np.savez(tmp_path / "whole.npz", **arrays)
    arrays["poses"][7, 3:9] = arrays["trans"][9, 1] = np.nan
    np.savez(tmp_path / "holes.npz", **arrays)
    notes: list[str] = []
    with reading(on_note=notes.append):
        whole, holes = (read_motion(tmp_path / f"{name}.npz") for name in ("whole", "holes"))
    assert "7 values without a number filled from neighbouring frames" in notes[-1]
    assert np.abs(motion_kinematics(holes)[1] - motion_kinematics(whole)[1]).max() < 0.05, "metres"
    with reading(strict=True), pytest.raises(MotionkitError, match="a value that is not a number"):
        read_motion(tmp_path / "holes.npz")


def test_values_without_a_number_of_own_archives_are_filled(tmp_path: Path) -> None:
    walked = make_walk(20)
    write_motion(tmp_path / "whole.npz", walked)
    with np.load(tmp_path / "whole.npz") as found:
        arrays = dict(found)
    arrays["local_rotations"][8:] *= -1.0  # the same turns
    arrays["local_rotations"][7, 5, 2] = arrays["root_positions"][3, 1] = np.nan
    np.savez(tmp_path / "holes.npz", **arrays)
    notes: list[str] = []
    with reading(on_note=notes.append):
        holes = read_motion(tmp_path / "holes.npz")
    assert notes == ["holes.npz: read with 5 values without a number filled from neighbouring frames"]
    assert np.abs(motion_kinematics(holes)[1] - motion_kinematics(walked)[1]).max() < 2.0
    with reading(strict=True), pytest.raises(MotionkitError, match="a value that is not a number"):
        read_motion(tmp_path / "holes.npz")


def changed(**arrays: Any) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        np.savez(path, **{name: value for name, value in (amass(4) | arrays).items() if value is not None})

    return write


def own(**arrays: Any) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        write_motion(path, make_walk(4))
        with np.load(path) as found:
            np.savez(path, **(dict(found) | arrays))

    return write


def bomb(path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("poses.npy", bytes(2**20) * 600)


@pytest.mark.parametrize(
    ("write", "said"),
    [
        (lambda path: path.write_bytes(b"PK no archive"), "cannot be read as a numpy archive"),
        (lambda path: np.save(path.open("wb"), np.zeros(3)), "cannot be read as a numpy archive"),
        (
            changed(poses=None),
            "expected local_rotations (motionkit), or poses and trans (AMASS, SMPL), found trans",
        ),
        (changed(trans=None), "has no array 'trans'; it has poses, mocap_framerate, betas, gender"),
        (changed(trans=np.zeros((3, 3))), "expected 'trans' of 4 x 3 numbers, found 3 x 3 of type float64"),
        (changed(poses=np.zeros((4, 100))), "expected poses of 72 (SMPL), 156 (SMPL-H)"),
        (changed(poses=np.zeros((0, 72))), "its array 'poses' has no frames"),
        (changed(poses=np.zeros(4)), "expected 'poses' of any x any numbers, found 4 of type"),
        (changed(poses=np.array([{}] * 4)), "expected 'poses' of any x any numbers, found 4 of type object"),
        (changed(poses=np.full((4, 72), np.nan)), "a value that is not a number up to 10,000,000"),
        (changed(mocap_framerate=0.0), "expected 'mocap_framerate' of 1 to 10,000, found 0"),
        (changed(mocap_framerate=np.zeros(2)), "expected 'mocap_framerate' of one numbers, found 2"),
        (bomb, "its array 'poses' is larger than 512 MB"),
        (own(parents=np.zeros(23, int)), "expected parents before their joints"),
        (own(parents=np.zeros(2, int)), "expected 'parents' of 23 numbers, found 2"),
        (own(joints=np.zeros(23)), "expected 'joints' of any names, found 23 of type float64"),
        (own(local_rotations=np.zeros((4, 23, 4))), "expected unit quaternions"),
        (own(end_joints=np.array([99] * 5)), "expected joints as end_joints"),
        (own(root_positions=np.full((4, 3), np.inf)), "not a number up to"),
    ],
)
def test_faults_are_one_line(tmp_path: Path, write: Callable[[Path], None], said: str) -> None:
    write(tmp_path / "a.npz")
    with pytest.raises(MotionkitError) as told:
        read_motion(tmp_path / "a.npz")
    assert said in str(told.value) and str(told.value).startswith(f"{tmp_path / 'a.npz'}: ")
    assert "\n" not in str(told.value)


def test_bodies_beside_motions_are_no_faults_of_a_folder(tmp_path: Path) -> None:
    """AMASS has an archive of betas in every folder."""
    np.savez(tmp_path / "a_poses.npz", **amass(4))
    np.savez(tmp_path / "shape.npz", betas=np.zeros(16))
    (tmp_path / "damaged.npz").write_bytes(b"PK")
    found = {source.name: source.skip_reason for source in find_sources([tmp_path])[0]}
    assert found == {"a_poses.npz": "", "damaged.npz": "", "shape.npz": "has no motion"}
