"""Reading and writing BVH: every accepted variant, round trips, atomic writes."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import bvhio
import numpy as np
import pytest

from motionkit.errors import BvhError, MotionkitError
from motionkit.export.formats import read_motion, write_motion
from motionkit.files import atomic_write
from motionkit.motion.bvh import BvhFile, bvh_to_motion, motion_to_bvh, read_bvh, write_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_angle
from motionkit.motion.skeleton import Skeleton
from synthetic_motions import make_walk


def same_file(a: BvhFile, b: BvhFile) -> bool:
    """Whether two files are equal, up to the digits written."""
    return (
        a.skeleton.same_hierarchy(b.skeleton)
        and a.channels == b.channels
        and bool(np.allclose(a.skeleton.offsets, b.skeleton.offsets, atol=1e-6))
        and a.skeleton.end_sites == b.skeleton.end_sites
        and bool(np.allclose(a.values, b.values, atol=1e-6))
        and abs(a.frame_time - b.frame_time) < 1e-9
    )


def test_what_a_plain_file_says(broken_folder: Path) -> None:
    bvh = read_bvh(broken_folder / "good.bvh")
    assert bvh.skeleton.names == ("Hips", "Spine", "LeftLeg")
    assert bvh.skeleton.parents == (-1, 0, 0)
    assert bvh.skeleton.offsets.tolist() == [[0, 0, 0], [0, 10, 0], [3, -5, 0]]
    assert bvh.skeleton.end_sites == {1: (0.0, 5.0, 0.0), 2: (0.0, -5.0, 0.0)}
    assert bvh.channels[1] == ("Zrotation", "Yrotation", "Xrotation")
    assert bvh.values.shape == (3, 12) and bvh.values[1, 1] == 90.1
    assert bvh.fps == 120.0


VARIANTS: dict[str, Callable[[str], bytes]] = {
    "crlf": lambda text: text.replace("\n", "\r\n").encode(),
    "old mac": lambda text: text.replace("\n", "\r").encode(),
    "byte order mark": lambda text: b"\xef\xbb\xbf" + text.encode(),
    "spaces for tabs": lambda text: text.replace("\t", "    ").encode(),
    "no indent": lambda text: text.replace("\t", "").encode(),
    "tabs between values": lambda text: text.replace(" ", "\t").replace("End\tSite", "End Site").encode(),
    "double spaces, spaces at the end": lambda text: text.replace(" ", "  ").replace("\n", "  \n").encode(),
    "no leading zeros": lambda text: text.replace(" 0.", " .").encode(),
    "no fraction": lambda text: text.replace(".0 ", ". ").encode(),
    "plus signs": lambda text: text.replace(" 10.0", " +10.0").encode(),
    "scientific": lambda text: text.replace("90.1", "9.01e1").replace("90.2", "9.02E+01").encode(),
    "blank lines at the end": lambda text: (text + "\n\n  \n\t\n").encode(),
    "blank lines everywhere": lambda text: text.replace("\n", "\n\n").encode(),
    "blank lines first": lambda text: ("\n\n" + text).encode(),
    "no last newline": lambda text: text.rstrip("\n").encode(),
    "upper case": lambda text: text.upper().replace("HIPS", "Hips").encode(),
    "lower case channels": lambda text: text.replace("Zrotation", "zrotation").encode(),
    "lower case end site": lambda text: text.replace("End Site", "end site").encode(),
    "named end site": lambda text: text.replace("End Site", "End Site SpineEnd").encode(),
    "brace on the line of the joint": lambda text: text.replace("\n{", " {").replace("\n\t{", " {").encode(),
    "braces without spaces": lambda text: (
        text.replace("Hips\n{\n", "Hips{\n").replace("}\n}\nM", "}}\nM").encode()
    ),
    "all braces packed": lambda text: text.replace(
        "\t\t\tOFFSET 0.0 5.0 0.0\n\t\t}", "\t\t\tOFFSET 0.0 5.0 0.0}"
    ).encode(),
    "no space after colons": lambda text: (
        text.replace("Frames: ", "Frames:").replace("Time: ", "Time:").encode()
    ),
    "root beside hierarchy": lambda text: text.replace("HIERARCHY\nROOT", "HIERARCHY ROOT").encode(),
}


@pytest.mark.parametrize("variant", VARIANTS)
def test_accepted_variants_say_the_same(
    tmp_path: Path, broken_folder: Path, good_text: str, variant: str
) -> None:
    path = tmp_path / "clip.bvh"
    path.write_bytes(VARIANTS[variant](good_text))
    expected, found = read_bvh(broken_folder / "good.bvh"), read_bvh(path)
    if variant == "upper case":
        found = replace(found, skeleton=replace(found.skeleton, names=expected.skeleton.names))
    assert same_file(found, expected)


@pytest.mark.parametrize(
    "written, encoding, read",
    [
        ("Bein_außen", "latin-1", "Bein_außen"),
        ("Pied_arrière", "utf-8", "Pied_arrière"),
        ("左足", "utf-8", "左足"),
        ("Left Leg 01", "ascii", "Left_Leg_01"),
        ("mixamorig:LeftLeg", "ascii", "mixamorig:LeftLeg"),
        ("End", "ascii", "End"),
        ("MOTION", "ascii", "MOTION"),
    ],
)
def test_names(tmp_path: Path, good_text: str, written: str, encoding: str, read: str) -> None:
    path = tmp_path / "clip.bvh"
    path.write_bytes(good_text.replace("LeftLeg", written).encode(encoding))
    bvh = read_bvh(path)
    assert bvh.skeleton.names == ("Hips", "Spine", read)
    write_bvh(tmp_path / "again.bvh", bvh)
    assert same_file(read_bvh(tmp_path / "again.bvh"), bvh)


def test_joint_without_channels_and_leaf_without_end_site(tmp_path: Path, good_text: str) -> None:
    text = good_text.replace("\t\tCHANNELS 3 Zrotation Yrotation Xrotation\n", "\t\tCHANNELS 0\n", 1)
    text = text.replace("\t\tEnd Site\n\t\t{\n\t\t\tOFFSET 0.0 -5.0 0.0\n\t\t}\n", "")
    rows = ["0 1 2 3 4 5 6 7 8", "1 2 3 4 5 6 7 8 9", "2 3 4 5 6 7 8 9 10"]
    path = tmp_path / "clip.bvh"
    path.write_text(text[: text.index("0.0 90.0 0.0 1.0")] + "\n".join(rows) + "\n")
    bvh = read_bvh(path)
    assert bvh.channels[1] == () and bvh.values.shape == (3, 9)
    motion = bvh_to_motion(bvh)
    assert quat_angle(motion.local_rotations[:, 1], np.array([1.0, 0, 0, 0], np.float32)).max() == 0
    # Without the CHANNELS line at all it is the same.
    path.write_text(path.read_text().replace("\t\tCHANNELS 0\n", ""))
    assert read_bvh(path).channels == bvh.channels


def test_hinge_joints_of_one_channel(tmp_path: Path, good_text: str) -> None:
    text = good_text.replace("CHANNELS 3 Zrotation Yrotation Xrotation", "CHANNELS 1 Xrotation", 1)
    lines = [" ".join(line.split()[:10]) if line[:1].isdigit() else line for line in text.split("\n")]
    path = tmp_path / "clip.bvh"
    path.write_text("\n".join(lines))
    motion = bvh_to_motion(read_bvh(path))
    angle = quat_angle(motion.local_rotations[:, 1], np.array([1.0, 0, 0, 0], np.float32))
    assert np.rad2deg(angle).tolist() == pytest.approx([4.0, 4.5, 5.0], abs=1e-4)


def test_six_channel_joints_move(tmp_path: Path, good_text: str) -> None:
    inner = "CHANNELS 3 Zrotation Yrotation Xrotation"
    text = good_text.replace(
        inner, "CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation", 1
    )
    lines = text.split("\n")
    for i, line in enumerate(lines):
        if line[:1].isdigit():
            words = line.split()
            lines[i] = " ".join([*words[:6], "0.5", "11.0", "-2.0", *words[6:]])
    path = tmp_path / "clip.bvh"
    path.write_text("\n".join(lines))
    motion = bvh_to_motion(read_bvh(path))
    assert motion.local_positions is not None
    assert motion.local_positions[2, 1].tolist() == pytest.approx([0.5, 11.0, -2.0])
    assert motion.local_positions[2, 2].tolist() == pytest.approx([3.0, -5.0, 0.0])
    write_bvh(tmp_path / "again.bvh", motion)
    again = bvh_to_motion(read_bvh(tmp_path / "again.bvh"))
    assert np.abs(motion_kinematics(again)[1] - motion_kinematics(motion)[1]).max() < 1e-3


def test_single_joint_and_single_frame(tmp_path: Path) -> None:
    path = tmp_path / "clip.bvh"
    path.write_text(
        "HIERARCHY\nROOT Only\n{\nOFFSET 0 0 0\nCHANNELS 3 Xposition Yposition Zposition\n}\n"
        "MOTION\nFrames: 1\nFrame Time: 0.04\n1 2 3\n"
    )
    bvh = read_bvh(path)
    assert bvh.values.tolist() == [[1.0, 2.0, 3.0]] and bvh.fps == 25.0
    assert bvh_to_motion(bvh).root_positions.tolist() == [[1.0, 2.0, 3.0]]


@pytest.mark.parametrize(
    "frame_time, fps",
    [
        ("0.008333333", 120),
        ("0.0083333", 120),
        (".0333333", 30),
        ("0.0166667", 60),
        ("0.01", 100),
        ("4e-2", 25),
        ("0.033367", 30 * 1000 / 1001),
        ("0.041708", 24 * 1000 / 1001),
        ("0.0166833", 60 * 1000 / 1001),
        ("0.0333", 30),
        ("0.0334", 30),
        ("0.0417", 24),
        ("0.0167", 60),
        ("0.04004", 25),
        ("0.0168067227", 59.5),
        ("0.016000", 62.5),
        ("0.016", 62),
    ],
)
def test_rate_is_that_of_video_or_a_whole_one(
    tmp_path: Path, good_text: str, frame_time: str, fps: float
) -> None:
    path = tmp_path / "clip.bvh"
    path.write_text(good_text.replace("0.008333333", frame_time))
    assert read_bvh(path).fps == pytest.approx(fps, rel=1e-9)


@pytest.mark.parametrize("fps", [25.0, 59.5, 62.5, 99.7, 23.98])
def test_a_rate_is_written_as_it_is(tmp_path: Path, make_motion: Callable[..., Motion], fps: float) -> None:
    for ending in (".bvh", ".npz", ".glb"):
        write_motion(tmp_path / f"a{ending}", replace(make_motion(frames=40), fps=fps))
        assert read_motion(tmp_path / f"a{ending}").fps == pytest.approx(fps, rel=1e-6)


@pytest.mark.parametrize("fps", [0.5, 20_000.0])
def test_a_rate_that_cannot_be_read_is_not_written(
    tmp_path: Path, make_motion: Callable[..., Motion], fps: float
) -> None:
    with pytest.raises(BvhError, match=r"seconds per frame, expected 0\.0001 to 1"):
        write_bvh(tmp_path / "clip.bvh", replace(make_motion(frames=5), fps=fps))
    assert not list(tmp_path.iterdir())


def test_file_round_trip_is_exact(tmp_path: Path, broken_folder: Path) -> None:
    bvh = read_bvh(broken_folder / "good.bvh")
    write_bvh(tmp_path / "once.bvh", bvh)
    write_bvh(tmp_path / "twice.bvh", read_bvh(tmp_path / "once.bvh"))
    assert same_file(read_bvh(tmp_path / "once.bvh"), bvh)
    assert (tmp_path / "once.bvh").read_bytes() == (tmp_path / "twice.bvh").read_bytes()


def test_motion_round_trip(tmp_path: Path, make_motion: Callable[..., Motion]) -> None:
    motion = make_motion(frames=90, swing=1.2)
    write_bvh(tmp_path / "clip.bvh", motion)
    back = bvh_to_motion(read_bvh(tmp_path / "clip.bvh"))
    assert back.fps == motion.fps and back.skeleton.same_hierarchy(motion.skeleton)
    assert np.rad2deg(quat_angle(back.local_rotations, motion.local_rotations)).max() < 1e-3
    assert np.abs(motion_kinematics(back)[1] - motion_kinematics(motion)[1]).max() < 1e-3


def test_written_file_keeps_importers_happy(tmp_path: Path, make_motion: Callable[..., Motion]) -> None:
    write_bvh(tmp_path / "clip.bvh", make_motion(frames=5))
    text = (tmp_path / "clip.bvh").read_text()
    assert text.count("ROOT ") == 1 and text.count("{") == text.count("}")
    assert text.count("End Site") == 5  # head, hands and toes
    assert text.count("CHANNELS") == 23 and "CHANNELS 6 Xposition Yposition Zposition Zrotation" in text
    root = bvhio.readAsHierarchy(str(tmp_path / "clip.bvh"))
    assert len(root.layout()) == 23


def test_angles_are_unrolled_over_time(make_motion: Callable[..., Motion]) -> None:
    still = make_motion(frames=200)
    turns = np.linspace(0, 6 * np.pi, 200, dtype=np.float32)
    rotations = still.local_rotations.copy()
    rotations[:, 0] = np.stack([np.cos(turns / 2), 0 * turns, np.sin(turns / 2), 0 * turns], axis=-1)
    bvh = motion_to_bvh(replace(still, local_rotations=rotations))
    assert np.abs(np.diff(bvh.values[:, 3:], axis=0)).max() < 30.0
    assert np.ptp(bvh.values[:, 4]) > 1000.0


def test_scale_on_the_way_in_and_out(tmp_path: Path, broken_folder: Path) -> None:
    bvh = read_bvh(broken_folder / "good.bvh")
    motion = bvh_to_motion(bvh, scale=2.0)
    assert motion.skeleton.offsets[1].tolist() == [0.0, 20.0, 0.0]
    assert motion.root_positions[0].tolist() == [0.0, 180.0, 0.0]
    for source in (motion, replace(bvh, skeleton=bvh.skeleton.scaled(2.0))):
        write_bvh(tmp_path / "clip.bvh", source, scale=0.5)
        assert read_bvh(tmp_path / "clip.bvh").skeleton.offsets[1].tolist() == [0.0, 10.0, 0.0]


def test_deep_but_sensible_hierarchy(tmp_path: Path, make_motion: Callable[..., Motion]) -> None:
    names = tuple(f"Bone{i}" for i in range(150))
    chain = Skeleton(names, tuple(range(-1, 149)), np.tile(np.float32([0.0, 1.0, 0.0]), (150, 1)))
    write_bvh(tmp_path / "chain.bvh", make_motion(frames=2, skeleton=chain))
    assert read_bvh(tmp_path / "chain.bvh").skeleton.parents == chain.parents


def test_any_order_of_joints_is_written_as_a_tree(tmp_path: Path, make_motion: Callable[..., Motion]) -> None:
    names, parents = ("Root", "Left", "Right", "LeftEnd", "RightEnd"), (-1, 0, 0, 1, 2)
    rig = Skeleton(names, parents, np.arange(15.0, dtype=np.float32).reshape(5, 3), {3: (1.0, 0.0, 0.0)})
    motion = make_motion(frames=4, skeleton=rig)
    write_bvh(tmp_path / "clip.bvh", motion)
    back = bvh_to_motion(read_bvh(tmp_path / "clip.bvh"))
    assert back.skeleton.names == ("Root", "Left", "LeftEnd", "Right", "RightEnd")
    assert back.skeleton.end_sites[2] == (1.0, 0.0, 0.0)
    order = [names.index(name) for name in back.skeleton.names]
    expected = motion_kinematics(motion)[1][:, order]
    assert np.abs(motion_kinematics(back)[1] - expected).max() < 1e-3


def test_agrees_with_bvhio_on_every_number(tmp_path: Path, make_motion: Callable[..., Motion]) -> None:
    path = tmp_path / "clip.bvh"
    write_bvh(path, make_motion(frames=6))
    ours, theirs = read_bvh(path), bvhio.readAsBvh(str(path))
    assert theirs.FrameCount == 6
    assert [joint.Name for joint, _, _ in theirs.Root.layout()] == list(ours.skeleton.names)


def full_disk(*_: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("existing", [False, True])
@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_full_disk_leaves_nothing_behind(
    tmp_path: Path,
    make_motion: Callable[..., Motion],
    monkeypatch: pytest.MonkeyPatch,
    call: str,
    existing: bool,
) -> None:
    path = tmp_path / "clip.bvh"
    if existing:
        path.write_text("what was there")
    monkeypatch.setattr(os, call, full_disk)
    with pytest.raises(MotionkitError, match=r"cannot be written.*No space left") as fault:
        write_bvh(path, make_motion(frames=3))
    assert str(path) in str(fault.value) and "\n" not in str(fault.value)
    assert [entry.name for entry in tmp_path.iterdir()] == (["clip.bvh"] if existing else [])
    assert not existing or path.read_text() == "what was there"


def test_fault_while_writing_leaves_nothing_behind(tmp_path: Path) -> None:
    path = tmp_path / "clip.bvh"
    path.write_text("what was there")
    with pytest.raises(KeyboardInterrupt), atomic_write(path) as file:
        file.write("half")
        raise KeyboardInterrupt
    assert path.read_text() == "what was there" and len(list(tmp_path.iterdir())) == 1


def test_writing_to_wrong_places(tmp_path: Path, make_motion: Callable[..., Motion]) -> None:
    motion = make_motion(frames=2)
    with pytest.raises(MotionkitError, match="is a folder"):
        write_bvh(tmp_path, motion)
    (tmp_path / "file").write_text("")
    with pytest.raises(MotionkitError, match=r"cannot be written \(.*file is not a folder"):
        write_bvh(tmp_path / "file" / "clip.bvh", motion)
    with pytest.raises(MotionkitError, match="not a regular file"):
        write_bvh("/dev/full", motion)
    assert Path("/dev/full").is_char_device()


def test_writing_through_a_link_keeps_the_link(tmp_path: Path, make_motion: Callable[..., Motion]) -> None:
    link, target = tmp_path / "link.bvh", tmp_path / "target.bvh"
    target.write_text("old")
    link.symlink_to(target)
    write_bvh(link, make_motion(frames=2))
    assert link.is_symlink() and len(read_bvh(target).values) == 2


def test_rotation_channels_that_cannot_be_written(make_motion: Callable[..., Motion]) -> None:
    channels = (("Xposition", "Yposition", "Zposition"), *[("Xrotation",)] * 22)
    with pytest.raises(BvhError, match=r"LeftUpLeg.*expected 3"):
        motion_to_bvh(make_motion(frames=2), channels)


def test_position_channels_that_hold_nothing_leave_the_offsets(tmp_path: Path) -> None:
    """Six channels a joint, of which those of all joints but the root are zero."""
    walk = make_walk(20)
    moving = replace(walk, local_positions=np.tile(walk.skeleton.offsets, (20, 1, 1)))
    moving.local_positions[:, 0] = walk.root_positions
    write_bvh(tmp_path / "six.bvh", moving)
    six = read_bvh(tmp_path / "six.bvh")
    empty = six.values.copy()
    for joint, (names, columns) in enumerate(zip(six.channels, six.columns(), strict=True)):
        if joint:
            empty[:, [column for name, column in zip(names, columns, strict=True) if "position" in name]] = (
                0.0
            )
    text = (tmp_path / "six.bvh").read_text()
    head = text[: text.index("Frame Time")] + f"Frame Time: {1 / 60:.6f}\n"
    rows = "\n".join(" ".join(f"{value:.6f}" for value in row) for row in empty)
    (tmp_path / "empty.bvh").write_text(head + rows + "\n")
    found, usual = (bvh_to_motion(read_bvh(tmp_path / name)) for name in ("empty.bvh", "six.bvh"))
    assert np.abs(motion_kinematics(found)[1] - motion_kinematics(usual)[1]).max() < 1e-3
