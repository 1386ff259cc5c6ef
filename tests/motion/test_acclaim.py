"""Acclaim files (.asf, .amc): the motion that was written, its skeleton wherever it lies, and files with faults."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from motionkit.errors import BvhError
from motionkit.motion.bvh import bvh_to_motion
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.reading import reading
from motionkit.rig.on_rig import read_rig
from motionkit.rig.read_file import read_file
from motionkit.rig.retarget import retarget_file
from synthetic_acclaim import CMU_NAMES, write_acclaim
from synthetic_motions import make_walk


def read(path: Path, **manner: object) -> tuple[Motion, list[str]]:
    """A file's motion, and what was told of it."""
    told: list[str] = []
    with reading(on_note=told.append, **manner):
        return bvh_to_motion(read_file(path)), told


def places(motion: Motion, names: list[str]) -> np.ndarray:
    return motion_kinematics(motion)[1][:, [motion.skeleton.index(name) for name in names]]


def test_world_positions_in_cm_by_axes_of_bones_units_and_orders(tmp_path: Path) -> None:
    """Like the motion that was written to 1e-4 cm, times 1 / 0.45 if lengths have no unit; and as it is in radians."""
    walk = make_walk(40)
    names = [CMU_NAMES[name] for name in walk.skeleton.names]
    made = write_acclaim(tmp_path, walk, rate=":SAMPLES-PER-SECOND 60\n")
    found, told = read(made)
    assert found.fps == 60.0 and not told
    assert np.abs(places(found, names) - places(walk, list(walk.skeleton.names))).max() < 1e-4
    as_it_is, _ = read(made, cm=1.0)
    assert np.allclose(as_it_is.root_positions, walk.root_positions * (0.45 / 2.54), atol=1e-5)
    lines = made.read_text().replace(":DEGREES", ":RADIANS").split("\n")
    turned = [
        " ".join([words[0], *(f"{np.deg2rad(float(word)):.12f}" for word in words[1:])])
        if len(words := line.split()) == 4
        else line
        for line in lines
        if not line.startswith("root")
    ]
    made.write_text("\n".join(turned))
    in_radians, told = read(made)
    assert np.abs(in_radians.local_rotations[:, 1:] - found.local_rotations[:, 1:]).max() < 1e-5
    assert "6 channels without any number set to zero" in told[0]


def test_every_way_in_knows_the_body(tmp_path: Path) -> None:
    """A rig without motion, a motion with its notes, retargeting by the names."""
    made = write_acclaim(tmp_path, make_walk(60))
    _, told = read(made)
    assert told == ["07_01.amc: read with 120 frames a second, because the file does not say its rate"]
    rig = read_rig(tmp_path / "07.asf")
    assert rig.joints.missing() == () and not rig.joints.by_shape and len(rig.skeleton) == 45
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        motion, report = retarget_file(made)
    assert report.scale == 1.0 and report.missing == () and len(motion) == 60


@pytest.mark.parametrize(
    ("skeletons", "taken"),
    [
        (("07.asf", "7.asf", "07_01_x.asf"), "07.asf"),
        (("07_01.ASF", "07.asf"), "07_01.ASF"),
        (("other.asf",), "other.asf"),
        (("a.asf", "b.asf"), "needs its skeleton beside it, 07_01.asf or 07.asf; there are a.asf, b.asf"),
        ((), "needs its skeleton beside it"),
    ],
)
def test_the_skeleton_beside_it(tmp_path: Path, skeletons: tuple[str, ...], taken: str) -> None:
    made = write_acclaim(tmp_path, make_walk(3))
    text = (tmp_path / "07.asf").read_text()
    (tmp_path / "07.asf").unlink()
    for name in skeletons:
        (tmp_path / name).write_text(text if name == taken else ":nothing")
    if taken.lower().endswith(".asf") and " " not in taken:
        motion, told = read(made)
        assert len(motion) == 3
        alone = "the skeleton other.asf, the only one beside it"
        assert (alone in told[0]) == (taken == "other.asf"), told
    else:
        with pytest.raises(BvhError, match=taken):
            read(made)


@pytest.mark.parametrize(
    ("name", "old", "new", "line", "said"),
    [
        ("07.asf", "length 0.45", "length 0", 6, "expected units of length"),
        ("07.asf", "length 0.45", "length x", 6, "expected numbers for the length of the units, found 'x'"),
        ("07.asf", "angle deg", "angle turn", 7, "expected deg or rad"),
        ("07.asf", "order TX", "order TX TX", 11, "a freedom is listed twice"),
        ("07.asf", "name link1", "name root", 18, "expected a name of its own for a bone, found 'root'"),
        ("07.asf", "end\nbegin", "begin", 22, "found begin before the end"),
        ("07.asf", "dof rx", "dof qx", 65, "expected tx to rz or l as a freedom, found 'qx'"),
        ("07.asf", "root link1", "root to_x", 0, "has a bone 'to_x' that :bonedata lacks"),
        ("07.asf", "root link1", "lfemur link1", 0, "bones hang from nothing"),
        ("07.asf", ":bonedata", ":bones", 0, "has a bone 'link1' that :bonedata lacks"),
        ("07.asf", ":hierarchy", ":tree", 0, "found no bones"),
        ("07_01.amc", "\n1\n", "\none\n", 4, "the skeleton 07.asf has no bone 'one'"),
        ("07_01.amc", "\n1\n", "\n", 4, "expected the number of a frame, found 'root'"),
        ("07_01.amc", "lfemur", "lfemur 1", 6, "expected 3 values for lfemur, as 07.asf says, found 4"),
        ("07_01.amc", "lfemur", "root", 6, "root is given twice in a frame, first on line 5"),
        ("07_01.amc", "lfemur ", "lfemur 1e9 2 3 # ", 6, "expected finite numbers up to 10,000,000"),
        ("07_01.amc", "lfemur ", "lfemur x", 6, "expected numbers for lfemur"),
        ("07_01.amc", ":DEGREES", ":SAMPLES-PER-SECOND 1e6", 3, "expected 1 to 10,000 frames a second"),
        ("07_01.amc", "root", "\0", 1, "has zero bytes"),
    ],
)
def test_faults_name_file_and_line(
    tmp_path: Path, name: str, old: str, new: str, line: int, said: str
) -> None:
    made = write_acclaim(tmp_path, make_walk(3))
    text = (tmp_path / name).read_text()
    assert old in text
    (tmp_path / name).write_text(text.replace(old, new, 1))
    with pytest.raises(BvhError) as told:
        read(made)
    assert said in str(told.value) and f"{name}:{line or ''}" in str(told.value), told.value


@pytest.mark.parametrize(
    ("change", "frames", "said"),
    [
        (lambda text: text[: text.rindex("lhumerus")], 3, "1 cut frame at the end left out"),
        (lambda text: text[: text.rindex("lhumerus") + 20], 3, "1 cut frame at the end left out"),
        (lambda text: text.replace("rfemur", "rfemur nan #", 1), 3, "3 values without a number filled"),
        (
            lambda text: text.replace(text[text.index("rfemur") :].split("\n")[0], "", 1),
            4,
            "3 values without",
        ),
    ],
)
def test_faults_that_are_settled(tmp_path: Path, change: object, frames: int, said: str) -> None:
    made = write_acclaim(tmp_path, make_walk(4))
    made.write_text(change(made.read_text()))
    if "nan" in made.read_text():
        made.write_text(made.read_text().replace("rfemur nan #", "rfemur nan nan nan #"))
        frames = 4
    motion, told = read(made)
    assert len(motion) == frames and said in told[0]
    with pytest.raises(BvhError):
        read(made, strict=True)


def test_lines_in_another_order_or_together_say_the_same(tmp_path: Path) -> None:
    """An orientation before its axis, and all units on one line."""
    made = write_acclaim(tmp_path, make_walk(10))
    skeleton = tmp_path / "07.asf"
    text = skeleton.read_text().replace("axis XYZ\nposition", "axis ZYX\nposition")
    turned = text.replace("orientation 0 0 0", "orientation 10 20 30")
    skeleton.write_text(turned)
    usual, _ = read(made)
    for old, new in (
        ("axis ZYX\nposition 0 0 0\norientation 10 20 30", "orientation 10 20 30\naxis ZYX\nposition 0 0 0"),
        ("mass 1.0\nlength 0.45\nangle deg", "mass 1.0 length 0.45 angle deg"),
    ):
        assert old in turned
        skeleton.write_text(turned.replace(old, new))
        found, _ = read(made)
        assert np.abs(motion_kinematics(found)[1] - motion_kinematics(usual)[1]).max() < 1e-4


def test_a_bone_that_is_moved_and_stays_there(tmp_path: Path) -> None:
    made = write_acclaim(tmp_path, make_walk(5))
    usual, _ = read(made)
    skeleton = tmp_path / "07.asf"
    text = skeleton.read_text()
    at = text.index("name lfemur")
    skeleton.write_text(text[:at] + text[at:].replace("dof ", "dof tx ty tz ", 1))
    lines = made.read_text().split("\n")
    moved = [
        line.replace("lfemur ", "lfemur 0 0 2 ", 1) if line.startswith("lfemur ") else line for line in lines
    ]
    made.write_text("\n".join(moved))
    found, _ = read(made)
    hip = motion_kinematics(found)[1] - motion_kinematics(usual)[1]
    distance = np.linalg.norm(hip[:, found.skeleton.index("lfemur")], axis=-1)
    assert distance == pytest.approx(np.full(5, 2.0 * 2.54 / 0.45), rel=1e-3)
