"""Broken BVH files with one fault each give one clear error with file and line, and no traceback."""

from __future__ import annotations

import os
import random
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.errors import BvhError, MotionkitError
from motionkit.motion.bvh import bvh_to_motion, motion_to_bvh, read_bvh, write_bvh
from motionkit.motion.motion import resample
from motionkit.reading import reading

# File, the line the message must name, a part of what it must say.
FAULTS = [
    ("binary.bvh", 1, "binary"),
    ("blank.bvh", 1, "is empty"),
    ("brace_close_missing.bvh", 24, "ROOT Hips is not closed"),
    ("brace_close_twice.bvh", 25, "'}' too many"),
    ("brace_open_missing.bvh", 16, "expected '{' after JOINT LeftLeg"),
    ("brace_open_twice.bvh", 17, "'{' without a joint"),
    ("channel_count_wrong.bvh", 9, "CHANNELS of JOINT Spine"),
    ("channels_after_children.bvh", 13, "CHANNELS of JOINT Spine comes after its children"),
    ("channels_of_end_site.bvh", 22, "an End Site has no CHANNELS"),
    ("channels_twice.bvh", 10, "second CHANNELS of JOINT Spine"),
    ("comma_decimals.bvh", 29, "expected numbers for frame 1, found '90,1'"),
    ("duplicate_joint.bvh", 15, "second joint named 'Spine' (the first is on line 6)"),
    ("empty.bvh", 1, "is empty"),
    ("frame_time_missing.bvh", 27, "expected 'Frame Time: SECONDS'"),
    ("frame_time_nan.bvh", 27, "finite"),
    ("frame_time_negative.bvh", 27, "found -0.008333"),
    ("frame_time_zero.bvh", 27, "frame time between 0.0001 and 1 seconds, found 0.0"),
    ("frames_missing.bvh", 26, "expected 'Frames: COUNT'"),
    ("frames_not_a_number.bvh", 26, "whole number of frames, found 'many'"),
    ("huge_frame_count.bvh", 26, "whole number of frames, found '99999999999999999999'"),
    ("infinite.bvh", 29, "value 2 of frame 1 is -inf"),
    ("joint_in_end_site.bvh", 22, "JOINT 'Toe' is inside an End Site"),
    ("joint_outside_root.bvh", 25, "JOINT 'Lost' is outside the ROOT"),
    ("joint_without_name.bvh", 15, "expected a name after JOINT"),
    ("long_row.bvh", 29, "expected 12 values in frame 1, found 13"),
    ("motion_missing.bvh", 30, "ends before its MOTION section"),
    ("nan.bvh", 29, "value 2 of frame 1 is nan"),
    ("nan_offset.bvh", 17, "OFFSET of JOINT LeftLeg, found 'nan'"),
    ("negative_frames.bvh", 26, "whole number of frames, found '-3'"),
    ("no_channels_at_all.bvh", 22, "declares no channels"),
    ("no_root.bvh", 2, "JOINT 'Hips' is outside the ROOT"),
    ("not_a_bvh.bvh", 1, "expected HIERARCHY, found 'solid cube'"),
    ("offset_after_child.bvh", 8, "an End Site comes before the OFFSET of JOINT Spine"),
    ("offset_missing.bvh", 17, "LeftLeg comes before its OFFSET"),
    ("offset_not_a_number.bvh", 17, "OFFSET of JOINT LeftLeg, found 'five'"),
    ("offset_of_end_site_missing.bvh", 21, "End Site has no OFFSET"),
    ("offset_twice.bvh", 18, "second OFFSET of JOINT LeftLeg"),
    ("offset_two_numbers.bvh", 17, "expected 3 numbers after OFFSET of JOINT LeftLeg, found 2"),
    ("overflow.bvh", 29, "value 2 of frame 1 is inf"),
    ("repeated_channel.bvh", 9, "a channel of JOINT Spine is listed twice"),
    ("short_row.bvh", 29, "expected 12 values in frame 1, found 11"),
    ("too_few_rows.bvh", 30, "declares 4 frames but has 3"),
    ("too_many_rows.bvh", 30, "declares 2 frames but has 3"),
    ("truncated_after_motion.bvh", 26, "expected 'Frames: COUNT'"),
    ("truncated_between_rows.bvh", 29, "declares 3 frames but has 2; the file is truncated"),
    ("truncated_in_hierarchy.bvh", 10, "ends before its MOTION section"),
    ("truncated_in_motion_header.bvh", 27, "expected 'Frame Time: SECONDS'"),
    ("truncated_in_row.bvh", 30, "expected 12 values in frame 2, found 5; the file is truncated"),
    ("truncated_in_word.bvh", 9, "ends before its MOTION section"),
    ("truncated_without_rows.bvh", 27, "declares 3 frames but has 0"),
    ("two_roots.bvh", 25, "second ROOT 'Other'"),
    ("underscore_in_number.bvh", 29, "found '90_1'"),
    ("unknown_channel.bvh", 9, "unknown channel 'Wrotation' of JOINT Spine"),
    ("unknown_word.bvh", 9, "found 'CHANELS'"),
    ("utf16.bvh", 1, "UTF-16"),
    ("utf16_no_mark.bvh", 1, "UTF-16"),
    ("word_in_row.bvh", 29, "expected numbers for frame 1, found '9o.1'"),
    ("zero_frames.bvh", 26, "zero frames"),
]


def fault_of(path: Path) -> BvhError:
    """The fault of a file that is read strictly."""
    with pytest.raises(BvhError) as caught, reading(strict=True):
        read_bvh(path)
    message = str(caught.value)
    assert "\n" not in message and message.startswith(str(path)) and len(message) < len(str(path)) + 200
    return caught.value


@pytest.mark.parametrize("name, line, says", FAULTS, ids=[name for name, _, _ in FAULTS])
def test_broken_file(broken_folder: Path, name: str, line: int, says: str) -> None:
    fault = fault_of(broken_folder / name)
    assert fault.line == line
    assert f"{name}:{line}: " in str(fault) and says in str(fault)


def test_every_broken_file_is_tested(broken_folder: Path) -> None:
    assert sorted(path.name for path in broken_folder.glob("*.bvh")) == sorted(
        ["good.bvh", *(name for name, _, _ in FAULTS)]
    )


def test_hierarchy_ten_thousand_deep(tmp_path: Path) -> None:
    path = tmp_path / "deep.bvh"
    opening = "".join(f"JOINT b{i}\n{{\nOFFSET 0 1 0\nCHANNELS 1 Xrotation\n" for i in range(1, 10_000))
    path.write_text(
        "HIERARCHY\nROOT b0\n{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n"
        + opening
        + "}\n" * 10_000
        + "MOTION\nFrames: 1\nFrame Time: 0.01\n"
        + "0 " * 10_000
        + "\n"
    )
    fault = fault_of(path)
    assert "nested more than 200 levels deep" in str(fault) and fault.line == 3 + 4 * 200


def test_too_many_joints(tmp_path: Path) -> None:
    path = tmp_path / "wide.bvh"
    joints = "".join(f"JOINT b{i}\n{{\nOFFSET 0 1 0\n}}\n" for i in range(3000))
    path.write_text(
        "HIERARCHY\nROOT b\n{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n"
        + joints
        + "}\nMOTION\nFrames: 1\nFrame Time: 0.01\n0\n"
    )
    assert "more than 2000 joints" in str(fault_of(path))


def test_folder_and_missing_file(tmp_path: Path) -> None:
    assert "is a folder" in str(fault_of(tmp_path))
    assert "no such file" in str(fault_of(tmp_path / "nowhere.bvh"))


def test_fault_far_down_a_long_file(tmp_path: Path, good_text: str) -> None:
    head = good_text[: good_text.index("0.0 90.0 0.0")].replace("Frames: 3", "Frames: 5000")
    rows = ["0 1 2 3 4 5 6 7 8 9 10 11"] * 5000
    rows[4321] = rows[4321].replace("5", "x5", 1)
    path = tmp_path / "long.bvh"
    path.write_text(head + "\n".join(rows) + "\n")
    assert fault_of(path).line == 28 + 4321


def test_every_truncation_is_refused_or_whole(tmp_path: Path, good_text: str) -> None:
    """A file cut after any byte is refused, except inside the last number, where it cannot be detected."""
    path = tmp_path / "cut.bvh"
    last_number = good_text.rindex(" ") + 2
    for length in range(len(good_text)):
        path.write_text(good_text[:length])
        if length < last_number:
            fault_of(path)
        else:
            assert len(read_bvh(path).values) == 3


def test_random_damage_never_surprises(tmp_path: Path, good_text: str) -> None:
    """Any damage gives a BvhError or a motion of finite numbers: no other exception, no hang."""
    chance = random.Random(0)
    scraps = [
        b"{",
        b"}",
        b"\n",
        b" ",
        b"-",
        b"e",
        b"nan",
        b"\x00",
        b"\xff",
        b"\x1c",
        "\u2028".encode(),
        b"\xc2\xa0",
    ]
    scraps += [
        b"JOINT x",
        b"ROOT",
        b"End Site",
        b"MOTION",
        b"Frames: 2",
        b"CHANNELS 1 Xrotation",
        b"1e400",
        b"\xc2\xb2",
    ]
    path = tmp_path / "damaged.bvh"
    for _ in range(600):
        data = bytearray(good_text.encode())
        for _ in range(chance.randint(1, 3)):
            at, scrap = chance.randrange(len(data)), chance.choice(scraps)
            length = chance.choice([0, 0, 1, len(scrap), 20])
            data[at : at + length] = scrap if chance.random() < 0.7 else b""
        path.write_bytes(data)
        try:
            with reading(strict=chance.random() < 0.5, on_note=lambda note: None):
                motion = bvh_to_motion(read_bvh(path))
        except BvhError as fault:
            assert "\n" not in str(fault)
        else:
            assert np.isfinite(motion.local_rotations).all() and np.isfinite(motion.root_positions).all()


# ---- plausible numbers ----


def changed(folder: Path, text: str, line: int, old: str, new: str) -> Path:
    """A file with one word of one line (counted from 1) changed."""
    lines = text.split("\n")
    assert old in lines[line - 1]
    lines[line - 1] = lines[line - 1].replace(old, new, 1)
    path = folder / "changed.bvh"
    path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize("number", ["1e39", "-1e39", "1e308", "10000001", "-1.5e7"])
def test_numbers_that_no_motion_has(tmp_path: Path, good_text: str, number: str) -> None:
    """A position, angle or offset beyond ten million is refused; the error names its line and value."""
    fault = fault_of(changed(tmp_path, good_text, 29, " 90.1 ", f" {number} "))
    assert fault.line == 29 and "value 2 of frame 1 is" in str(fault) and "up to 10,000,000" in str(fault)
    offset = good_text.split("\n")[16].split()[1]
    fault = fault_of(changed(tmp_path, good_text, 17, f"OFFSET {offset}", f"OFFSET {number}"))
    assert fault.line == 17 and f"found '{number}'" in str(fault) and "10,000,000" in str(fault)


def test_the_largest_numbers_allowed_stay_finite(tmp_path: Path, good_text: str) -> None:
    path = changed(tmp_path, good_text, 29, " 90.1 ", " -1e7 ")
    motion = bvh_to_motion(read_bvh(path))
    assert np.isfinite(np.square(motion.root_positions).sum())


@pytest.mark.parametrize(("time", "frames"), [("10", 3), ("1.01", 3), ("0.00009", 3), ("1", 3605)])
def test_frame_times_that_would_ask_for_memory(
    tmp_path: Path, good_text: str, time: str, frames: int
) -> None:
    head = good_text[: good_text.index("0.0 90.0 0.0")]
    head = head.replace("Frames: 3", f"Frames: {frames}")
    head = "\n".join(
        f"Frame Time: {time}" if line.startswith("Frame Time") else line for line in head.split("\n")
    )
    path = tmp_path / "slow.bvh"
    path.write_text(head + "0 1 2 3 4 5 6 7 8 9 10 11\n" * frames)
    fault = fault_of(path)
    assert fault.line == 27
    assert ("last 1 hours, expected at most 1" if frames > 3 else "frame time between") in str(fault)


def test_a_true_rate_that_makes_a_motion_of_days_is_refused(make_motion) -> None:
    long = replace(make_motion(20), fps=0.001)
    with pytest.raises(MotionkitError, match=r"20 frames at 0\.001 fps last 5\.56 hours"):
        resample(long, 60.0)


def test_names_and_channels_are_told_in_short(tmp_path: Path, good_text: str) -> None:
    fault_of(changed(tmp_path, good_text, 6, "Spine", "S" * 5000))
    path = tmp_path / "changed.bvh"
    path.write_text(good_text.replace("Zrotation", "Z" * 5000, 1))
    fault_of(path)


@pytest.mark.parametrize("data", [b"\xef\xbb\xbf", b"\x1c\x1d", b"\xc2\xa0\n"])
def test_a_file_of_spaces_only_unicode_knows(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "blank.bvh").write_bytes(data)
    assert "is empty" in str(fault_of(tmp_path / "blank.bvh"))


def test_a_glb_is_told_from_other_binary_files(tmp_path: Path) -> None:
    (tmp_path / "walk.glb").write_bytes(b"glTF\x02\x00\x00\x00" + bytes(40))
    fault = str(fault_of(tmp_path / "walk.glb"))
    assert fault.endswith(
        "is a glTF file, expected a BVH file; `motionkit convert` makes one of its animation"
    )
    (tmp_path / "walk.vrma").write_bytes((tmp_path / "walk.glb").read_bytes())
    assert str(fault_of(tmp_path / "walk.vrma")).endswith("is a glTF file, expected a BVH file")


def test_spaces_without_end_in_the_motion_header_take_no_time(tmp_path: Path, good_text: str) -> None:
    path = tmp_path / "spaces.bvh"
    path.write_text(good_text.replace("Frame Time:", "Frame Time" + " " * 400_000 + "x y"))
    assert "expected 'Frame Time: SECONDS'" in str(fault_of(path))


# ---- regular files ----


def test_pipes_devices_and_huge_files_are_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.bvh")
    (tmp_path / "zeros.bvh").symlink_to("/dev/zero")
    with (tmp_path / "sparse.bvh").open("wb") as file:
        file.truncate(2 * 2**30)
    assert "is not a regular file, expected a BVH file" in str(fault_of(tmp_path / "pipe.bvh"))
    assert "is not a regular file" in str(fault_of(tmp_path / "zeros.bvh"))
    assert "has 2 GB, expected a BVH file of at most 512 MB" in str(fault_of(tmp_path / "sparse.bvh"))


# ---- writing ----


@pytest.mark.parametrize("number", [float("nan"), float("inf"), 1e38])
def test_a_motion_that_cannot_be_read_is_not_written(tmp_path: Path, make_motion, number: float) -> None:
    """An invalid position, angle or offset leaves the good file at the path unchanged."""
    path = tmp_path / "good.bvh"
    write_bvh(path, make_motion(4))
    before = path.read_bytes()
    bad_place = make_motion(4)
    bad_place.root_positions[2, 1] = number
    bad_turn = motion_to_bvh(make_motion(4))
    bad_turn.values[3, 7] = number
    bad_offset = motion_to_bvh(make_motion(4))
    bad_offset.skeleton.offsets[3, 1] = number
    for bad, says in ((bad_place, "value 2 of frame 2"), (bad_turn, "frame 3"), (bad_offset, "LeftFoot")):
        with pytest.raises(BvhError, match=f"not written: .*{says}"):
            write_bvh(path, bad)
    assert path.read_bytes() == before and [p.name for p in tmp_path.iterdir()] == ["good.bvh"]
