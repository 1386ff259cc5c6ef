"""Acclaim files, which the CMU database gives out: a skeleton (.asf), and its motion (.amc) in a file of its own.

A bone of the skeleton is a joint at its beginning, and its end is where its children begin. Angles are about axes of
the bone's own; the joints of a Motion have the axes of the world.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from motionkit.arrays import Doubles
from motionkit.errors import BvhError, MotionkitError
from motionkit.files import read_bytes
from motionkit.free_memory import check_memory
from motionkit.motion.bvh import BvhFile, motion_to_bvh
from motionkit.motion.bvh_rows import Notes, filled, floats, implausible_value
from motionkit.motion.bvh_text import (
    LONGEST_FRAME,
    MAX_BYTES,
    MAX_JOINTS,
    MAX_NAME,
    POSE_FRAME,
    SHORTEST_FRAME,
    check_duration,
)
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    euler_to_quat,
    quat_continuous,
    quat_inverse,
    quat_multiply,
    quat_normalize,
    quat_rotate,
)
from motionkit.motion.skeleton import Skeleton
from motionkit.names import counted, nfc
from motionkit.reading import report_notes, user_cm

RATE = 120.0  # frames per second of the CMU database; motion files rarely say theirs
INCH = 2.54  # cm; lengths are inches times the length of the skeleton's units
_ROOT = "root"
_CHANNELS = {
    **{"tx": "Xposition", "ty": "Yposition", "tz": "Zposition"},
    **{"rx": "Xrotation", "ry": "Yrotation", "rz": "Zrotation", "l": "length"},
}
_AXES = re.compile(r"[xyz]{3}", re.IGNORECASE)
_FRAME = re.compile(r"[0-9]{1,9}")


@dataclass
class _Bone:
    """A bone, or the root: where it ends (3,), its axes (4,) in the world, and its channels, such as "Xrotation"."""

    end: Doubles = field(default_factory=lambda: np.zeros(3))
    axes: Doubles = field(default_factory=lambda: np.array([1.0, 0.0, 0.0, 0.0]))
    channels: tuple[str, ...] = ()


@dataclass
class _Skeleton:
    """What a skeleton file says.

    Attributes:
        length: its unit of length; 1 if it names none.
        degrees: whether its angles are degrees.
        start: (3,) where the root stands before it moves.
        file: the name of its file.
        bones: by name, the root among them.
        parents: the parent of each bone of the hierarchy, in depth-first order.
    """

    length: float = 1.0
    degrees: bool = True
    start: Doubles = field(default_factory=lambda: np.zeros(3))
    file: str = ""
    bones: dict[str, _Bone] = field(default_factory=lambda: {_ROOT: _Bone()})
    parents: dict[str, str] = field(default_factory=lambda: {_ROOT: ""})

    @property
    def cm(self) -> float:
        """cm per unit of the file; 1 if it names no unit, or the user does."""
        return 1.0 if self.stated_cm is None or user_cm() is not None else self.stated_cm

    @property
    def stated_cm(self) -> float | None:
        """cm per unit of the file; None if it names no unit."""
        return None if self.length == 1.0 else INCH / self.length


def read_acclaim(path: str | Path) -> BvhFile:
    """Read an .amc with the .asf that lies beside it, or an .asf as one frame of its rest pose.

    Lengths become cm if the skeleton says its unit.

    Raises:
        BvhError: one of the files cannot be read; the message names it and the line.
    """
    if Path(path).suffix.lower() == ".asf":
        return _file(_read_skeleton(path), np.zeros((1, 0)), 1.0 / POSE_FRAME, {})
    notes = Notes(path)
    bones_of = skeleton_file(path)
    skeleton = _read_skeleton(bones_of)
    columns, count = {}, 0
    for name in skeleton.parents:
        columns[name] = range(count, count + len(skeleton.bones[name].channels))
        count = columns[name].stop
    values, rate = _read_motion(path, skeleton, columns, notes)
    said = [*notes.lines]
    if not _named_for(path, bones_of):
        said.append(f"the skeleton {bones_of.name}, the only one beside it")
    if not rate:
        said.append(f"{RATE:g} frames a second, because the file does not say its rate")
    report_notes(path, tuple(said))
    return _file(skeleton, values, rate or RATE, columns)


def skeleton_file(path: str | Path) -> Path:
    """The skeleton of a motion file: of its name, of the beginning of it (07.asf of 07_01.amc), or the only one."""
    path = Path(path)
    found = (
        sorted(one for one in path.parent.glob("*") if one.suffix.lower() == ".asf") if path.exists() else []
    )
    stem = path.stem.lower()
    fitting = [one for one in found if _named_for(path, one)]
    if fitting or len(found) == 1:
        return max(fitting or found, key=lambda one: len(one.stem))
    names = " or ".join(f"{one}.asf" for one in dict.fromkeys((stem, stem.partition("_")[0])))
    other = f"; there are {', '.join(one.name for one in found[:4])}" if found else ""
    raise BvhError(path, f"needs its skeleton beside it, {names}{other}" if path.exists() else "no such file")


def _named_for(path: str | Path, skeleton: Path) -> bool:
    """Whether a skeleton has the name of a motion file, or the beginning of it."""
    stem, name = Path(path).stem.lower(), skeleton.stem.lower()
    return stem == name or (stem.startswith(name) and not stem[len(name)].isalnum())


def _lines(path: str | Path, what: str) -> list[str]:
    """The lines of a text file without comments."""
    try:
        data = read_bytes(path, MAX_BYTES, what)
    except MotionkitError as error:
        raise BvhError(path, str(error).removeprefix(f"{path}: ")) from None
    if b"\x00" in data:
        raise BvhError(path, f"has zero bytes, expected {what}", 1)
    text = data.decode("utf-8-sig", "replace").replace("\r\n", "\n").replace("\r", "\n")
    return [line.partition("#")[0] for line in text.split("\n")]


# ---- the skeleton ----


def _read_skeleton(path: str | Path) -> _Skeleton:
    out, notes = _Skeleton(file=Path(path).name), Notes(path)
    lines = _lines(path, "an ASF file")
    section, block = "", _Block()
    for number, line in enumerate(lines, 1):
        words = line.split()
        if not words:
            continue
        if words[0].startswith(":"):
            section, words, block = words[0].lower(), words[1:], _Block()
        if section == ":units" and len(words) > 1:
            _unit(out, words, number, notes)
        elif section == ":root" and words:
            _root(out, block, words, number, notes)
        elif section == ":bonedata" and words:
            block = _bone(out, block, words, number, notes)
        elif section == ":hierarchy" and words and words[0].lower() not in ("begin", "end"):
            _children(out, words, number, path)
    if len(out.parents) < 2:
        raise BvhError(path, "expected an ASF file with :bonedata and :hierarchy, found no bones", len(lines))
    report_notes(path, notes.lines)
    out.parents = _depth_first(out.parents)
    left = len(out.bones) - len(out.parents)
    if left:
        raise BvhError(path, f"{left} of the bones hang from nothing in the :hierarchy", len(lines))
    return out


@dataclass
class _Block:
    """What a bone's block has said so far: words by keyword, each with its line."""

    words: dict[str, tuple[list[str], int]] = field(default_factory=dict)
    open: bool = False


def _numbers(words: list[str], count: int, line: int, what: str, notes: Notes) -> Doubles:
    if len(words) < count:
        raise BvhError(notes.path, f"expected {count} numbers for {what}, found {len(words)}", line)
    return np.array(floats(words[:count], line, what, notes))


def _unit(out: _Skeleton, words: list[str], line: int, notes: Notes) -> None:
    """Read a line of the units: one of them, or several such as `mass 1 length 0.45 angle deg`."""
    key = words[0].lower()
    if len(words) > 2 and key in ("mass", "length", "angle"):
        _unit(out, words[2:], line, notes)
    if key == "length":
        out.length = float(_numbers(words[1:], 1, line, "the length of the units", notes)[0])
        if not 1e-4 <= out.length <= 1e4:
            raise BvhError(
                notes.path, f"expected units of length 0.0001 to 10000, found {words[1][:40]}", line
            )
    elif key == "angle":
        if words[1].lower() not in ("deg", "rad"):
            raise BvhError(notes.path, f"expected deg or rad as angle, found {words[1][:40]!r}", line)
        out.degrees = words[1].lower() == "deg"


def _root(out: _Skeleton, block: _Block, words: list[str], line: int, notes: Notes) -> None:
    key, root = words[0].lower(), out.bones[_ROOT]
    block.words[key] = words[1:], line
    if key == "order":
        root.channels = _channels(words[1:], line, notes)
    elif key == "position":
        out.start = _numbers(words[1:], 3, line, "the position of the root", notes)
    if key in ("orientation", "axis") and "orientation" in block.words:
        turned, at = block.words["orientation"]
        order, _ = block.words.get("axis", (["XYZ"], line))
        root.axes = _axes([*turned[:3], *order[:1]], at, notes, out.degrees)


def _bone(out: _Skeleton, block: _Block, words: list[str], line: int, notes: Notes) -> _Block:
    """Read a line of a bone; returns the block that it belongs to."""
    key = words[0].lower()
    if key == "begin":
        if block.open:
            raise BvhError(notes.path, "found begin before the end of the bone before it", line)
        return _Block(open=True)
    if not block.open:
        raise BvhError(notes.path, f"expected begin, found {words[0][:40]!r}", line)
    if key != "end":
        block.words.setdefault(key, (words[1:], line))
        return block
    name, at = block.words.get("name", ([], line))
    called = nfc("_".join(name))
    if not called or len(called) > MAX_NAME or called in out.bones:
        raise BvhError(notes.path, f"expected a name of its own for a bone, found {called[:40]!r}", at)
    if len(out.bones) >= MAX_JOINTS:
        raise BvhError(notes.path, f"more than {MAX_JOINTS} bones", at)
    entry, length = (block.words.get(word, ([], line)) for word in ("direction", "length"))
    direction = _numbers(entry[0], 3, entry[1], f"the direction of {called}", notes)
    size = float(np.linalg.norm(direction))
    reach = _numbers(length[0], 1, length[1], f"the length of {called}", notes)
    axis, dof = block.words.get("axis", (["0", "0", "0", "XYZ"], line)), block.words.get("dof", ([], line))
    out.bones[called] = _Bone(
        direction / size * reach if size else np.zeros(3),
        _axes(*axis, notes, out.degrees),
        _channels(*dof, notes),
    )
    return _Block()


def _axes(words: list[str], line: int, notes: Notes, degrees: bool) -> Doubles:
    """The axes of a bone (4,): three angles, and the order in which they turn."""
    angles = _numbers(words[:3], 3, line, "the axis", notes)
    order = words[3] if len(words) > 3 else "XYZ"
    if not _AXES.fullmatch(order):
        raise BvhError(notes.path, f"expected an order such as XYZ, found {order[:40]!r}", line)
    return _turn(angles, order.upper(), degrees)


def _turn(angles: Doubles, order: str, degrees: bool) -> Doubles:
    """The rotations (..., 4) of angles (..., N) about fixed axes, one after another."""
    return euler_to_quat((np.deg2rad(angles) if degrees else angles)[..., ::-1], order[::-1])


def _channels(words: list[str], line: int, notes: Notes) -> tuple[str, ...]:
    for word in words:
        if word.lower() not in _CHANNELS:
            raise BvhError(notes.path, f"expected tx to rz or l as a freedom, found {word[:40]!r}", line)
    if len({word.lower() for word in words}) < len(words):
        raise BvhError(notes.path, f"a freedom is listed twice: {' '.join(words)[:60]}", line)
    return tuple(_CHANNELS[word.lower()] for word in words)


def _children(out: _Skeleton, words: list[str], line: int, path: str | Path) -> None:
    names = [nfc(word) for word in words]
    for name in names:
        if name not in out.bones:
            raise BvhError(path, f"the hierarchy has a bone {name[:40]!r} that :bonedata lacks", line)
    for name in names[1:]:
        if name in out.parents:
            raise BvhError(path, f"the bone {name[:40]!r} hangs from two bones", line)
        out.parents[name] = names[0]


def _depth_first(parents: dict[str, str]) -> dict[str, str]:
    """The bones that descend from the root, depth first."""
    below: dict[str, list[str]] = {}
    for name, parent in parents.items():
        below.setdefault(parent, []).append(name)
    found, waiting = {}, [_ROOT]
    while waiting:
        name = waiting.pop()
        found[name] = parents[name]
        waiting += reversed(below.get(name, []))
    return found


# ---- the motion ----


def _read_motion(
    path: str | Path, skeleton: _Skeleton, columns: dict[str, range], notes: Notes
) -> tuple[Doubles, float]:
    """The values (T, C) of a motion file, finite, and its frames per second, 0 if it does not say them."""
    lines = _lines(path, "an AMC file")
    channels = [channel for name in columns for channel in skeleton.bones[name].channels]
    last = max((number for number, line in enumerate(lines, 1) if line.strip()), default=1)
    rate, usual = 0.0, 0
    rows: list[list[float]] = []
    places: list[int] = []  # the line of each frame
    lines_of_bones: dict[str, int] = {}  # line of each bone of the present frame
    for number, line in enumerate(lines, 1):
        words = line.split()
        if not words:
            continue
        key = words[0].lower()
        if key.startswith(":"):
            skeleton.degrees = {":degrees": True, ":radians": False}.get(key, skeleton.degrees)
            if key == ":samples-per-second":
                rate = _rate(words[1:], number, notes)
        elif len(words) == 1 and _FRAME.fullmatch(key):
            usual, lines_of_bones = max(usual, len(lines_of_bones)), {}
            rows.append([float("nan")] * len(channels))
            places.append(number)
        else:
            try:
                _row(rows, lines_of_bones, words, columns, skeleton.file, number, notes)
            except BvhError:
                if number < last or len(rows) < 2 or notes.strict:
                    raise
    if not rows:
        raise BvhError(path, "expected an AMC file with numbered frames, found none", last)
    if len(rows) > 1 and len(lines_of_bones) < usual:
        fault = "the last frame lacks bones; the file is truncated"
        notes.repaired("cut frame", "at the end left out", fault, places[-1])
        rows = rows[:-1]
    if "length" in channels:
        fault = "bones that change their length cannot be read"
        notes.repaired("channel", "of a bone's length left out", fault, places[0], channels.count("length"))
    return _checked(rows, channels, places, rate or RATE, notes), rate


def _row(
    rows: list[list[float]],
    lines_of_bones: dict[str, int],
    words: list[str],
    columns: dict[str, range],
    skeleton: str,
    line: int,
    notes: Notes,
) -> None:
    """Read the angles of a bone into the last row; skeleton is the name of its file."""
    name = nfc(words[0])
    place = columns.get(name)
    if place is None:
        raise BvhError(notes.path, f"the skeleton {skeleton} has no bone {name[:40]!r}", line)
    if not rows:
        raise BvhError(notes.path, f"expected the number of a frame, found {words[0][:40]!r}", line)
    if name in lines_of_bones:
        raise BvhError(
            notes.path, f"{name} is given twice in a frame, first on line {lines_of_bones[name]}", line
        )
    if len(words) - 1 != len(place):
        expected = f"expected {counted(len(place), 'value')} for {name}, as {skeleton} says"
        raise BvhError(notes.path, f"{expected}, found {len(words) - 1}", line)
    lines_of_bones[name] = line
    rows[-1][place.start : place.stop] = floats(words[1:], line, name, notes, unknown=True)


def _checked(
    rows: list[list[float]], channels: list[str], places: list[int], rate: float, notes: Notes
) -> Doubles:
    """The values (T, C) with unknown ones filled; raises BvhError for what cannot be."""
    try:
        check_memory(len(rows), len(channels) // 3, rate)
    except MotionkitError as error:
        raise BvhError(notes.path, str(error), places[0]) from None
    check_duration(notes.path, len(rows), 1.0 / rate, places[0])
    values = np.array(rows)
    values = values if notes.strict else filled(values, channels, notes)
    found = implausible_value(values)
    if found:
        raise BvhError(notes.path, found[1], places[found[0]])
    return values


def _rate(words: list[str], line: int, notes: Notes) -> float:
    rate = float(_numbers(words, 1, line, "the frame rate", notes)[0])
    if not 1.0 / LONGEST_FRAME <= rate <= 1.0 / SHORTEST_FRAME:
        most = f"{1 / SHORTEST_FRAME:,.0f}"
        raise BvhError(notes.path, f"expected 1 to {most} frames a second, found {rate:g}", line)
    return rate


def _file(skeleton: _Skeleton, values: Doubles, rate: float, columns: dict[str, range]) -> BvhFile:
    """The skeleton with the values (T, C) of the columns of its bones."""
    names = tuple(skeleton.parents)
    parents = tuple(names.index(skeleton.parents[name]) if name != _ROOT else -1 for name in names)
    bones = [skeleton.bones[name] for name in names]
    offsets = np.stack([bones[parent].end if parent >= 0 else np.zeros(3) for parent in parents])
    ends = {j: (*bone.end.tolist(),) for j, bone in enumerate(bones) if j not in parents}
    turns = np.zeros((len(values), len(bones), 4))
    turns[..., 0] = 1.0
    places = np.broadcast_to(offsets, (len(values), *offsets.shape)).copy()
    places[:, 0] = skeleton.start
    for joint, (name, bone) in enumerate(zip(names, bones, strict=True)):
        for kind in ("rotation", "position") if name in columns else ():
            picked = [
                (channel[0], column)
                for channel, column in zip(bone.channels, columns[name], strict=True)
                if channel.endswith(kind)
            ]
            order, picked_values = (
                "".join(axis for axis, _ in picked),
                values[:, [column for _, column in picked]],
            )
            if kind == "rotation":
                turned = quat_multiply(bone.axes, _turn(picked_values, order, skeleton.degrees))
                turns[:, joint] = quat_multiply(turned, quat_inverse(bone.axes))
            else:
                moved = np.zeros((len(values), 3))
                moved[:, ["XYZ".index(axis) for axis in order]] = picked_values
                places[:, joint] += quat_rotate(bone.axes, moved) if joint else moved
    motion = Motion(
        Skeleton(names, parents, offsets.astype(np.float32), ends, skeleton.stated_cm),
        quat_continuous(quat_normalize(turns)).astype(np.float32),
        places[:, 0].astype(np.float32),
        rate,
        places.astype(np.float32) if (places[:, 1:] != offsets[1:]).any() else None,
    )
    return motion_to_bvh(motion.scaled(skeleton.cm))
