"""Checks the text of a BVH file before it is parsed, so that every error has a line number.

It checks the grammar of the hierarchy without recursion, rewrites the hierarchy in normal form, and checks the motion
block as bytes. The output is safe to pass to bvhio and numpy.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motionkit.errors import BvhError, MotionkitError
from motionkit.files import read_bytes
from motionkit.motion.motion import longest_seconds

MAX_BYTES = 512 * 2**20
MAX_DEPTH = 200
MAX_JOINTS = 2000
MAX_NAME = 200
# Limit of offsets, positions (10 km in millimetres) and angles (28,000 turns in degrees). No real file reaches it in
# any unit, and results stay far within the range of float32.
MAX_NUMBER = 1e7
SHORTEST_FRAME, LONGEST_FRAME = 1e-4, 1.0  # seconds
CHANNEL_NAMES = {
    f"{axis}{kind}".lower(): f"{axis}{kind}" for axis in "XYZ" for kind in ("position", "rotation")
}
FRAMES = re.compile(r"frames ?:? ?(.+)", re.IGNORECASE)
FRAME_TIME = re.compile(r"frame time ?:? ?([^ ]+)", re.IGNORECASE)
WHOLE_NUMBER = re.compile(r"[0-9]{1,9}")


@dataclass(frozen=True)
class BvhText:
    """A checked file: a normalised header for bvhio, and the motion block as numbers.

    The header calls the joints j0, j1, ... in file order, because unusual names (with spaces, in Latin-1) may confuse
    the parser; `names` holds the real names.
    """

    header: str
    names: tuple[str, ...]
    channel_count: int
    frames: int
    frame_time: float
    values: NDArray[np.float64]


def read_bvh_text(path: str | Path) -> BvhText:
    """Read and check a BVH file; raises BvhError with the line of the first error."""
    data = _read_bytes(path)
    text = _decode(path, data)
    lines = text.split("\n")
    motion_line = _find_motion(path, lines)
    header, names, channels = _check_hierarchy(path, lines, motion_line)
    frames, frame_time, first_row = _check_motion_header(path, lines, motion_line)
    values = _read_rows(path, lines, first_row, frames, channels)
    _check_duration(path, frames, frame_time, first_row)
    header += f"MOTION\nFrames: {frames}\nFrame Time: {frame_time!r}\n"
    return BvhText(header, names, channels, frames, frame_time, values)


def read_hierarchy(path: str | Path) -> str:
    """The unchanged text of a BVH file's hierarchy section; raises BvhError as read_bvh_text does."""
    lines = _decode(path, _read_bytes(path)).split("\n")
    return "\n".join(lines[: _find_motion(path, lines)]) + "\n"


def _read_bytes(path: str | Path) -> bytes:
    try:
        data = read_bytes(path, MAX_BYTES, "a BVH file")
    except MotionkitError as error:
        raise BvhError(path, str(error).removeprefix(f"{path}: ")) from None
    if not data or data.isspace():
        raise BvhError(path, "is empty, expected a BVH file that starts with HIERARCHY", 1)
    return data


def _decode(path: str | Path, data: bytes) -> str:
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise BvhError(path, "is UTF-16 text, expected ASCII, UTF-8 or Latin-1; save it as UTF-8", 1)
    if data.startswith(b"glTF"):
        # convert reads .glb files, but no avatars or VRM animations.
        how = (
            "; `motionkit convert` makes one of its animation" if Path(path).suffix.lower() == ".glb" else ""
        )
        raise BvhError(path, f"is a glTF file, expected a BVH file{how}")
    if b"\x00" in data:
        raise BvhError(path, "has zero bytes, expected text; this is a binary or UTF-16 file", 1)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    if not text.strip():  # only Unicode spaces
        raise BvhError(path, "is empty, expected a BVH file that starts with HIERARCHY", 1)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _find_motion(path: str | Path, lines: list[str]) -> int:
    first = next(i for i, line in enumerate(lines) if line.strip())
    if lines[first].split()[0].upper() != "HIERARCHY":
        found = lines[first].strip()[:40]
        raise BvhError(path, f"expected HIERARCHY, found {found!r}", first + 1)
    for number, line in enumerate(lines):
        if line.strip().upper() == "MOTION":
            return number
    raise BvhError(path, "the file ends before its MOTION section", len(lines))


def _floats(path: str | Path, words: list[str], line: int, what: str) -> list[float]:
    numbers = []
    for word in words:
        try:
            number = float(word.replace("_", "?"))  # Python would read 1_0 as 10
        except ValueError:
            raise BvhError(path, f"expected numbers for {what}, found {word[:40]!r}", line) from None
        if not abs(number) <= MAX_NUMBER:
            raise BvhError(
                path, f"expected finite numbers up to {MAX_NUMBER:,.0f} for {what}, found {word[:40]!r}", line
            )
        numbers.append(number)
    return numbers


class _HierarchyWalk:
    """Checks the tokens of a hierarchy with an explicit stack and collects the normalised text."""

    def __init__(self, path: str | Path) -> None:
        self.path = path
        self.out: list[str] = ["HIERARCHY"]
        self.names: dict[str, int] = {}
        self.open: list[dict[str, Any]] = []  # joints and end sites not yet closed
        self.pending: dict[str, Any] | None = None  # a joint or end site before its opening bracket
        self.roots = 0
        self.channels = 0

    def fail(self, message: str, line: int) -> BvhError:
        return BvhError(self.path, message, line)

    def name(self, kind: str, words: list[str], line: int) -> None:
        if self.pending is not None:
            raise self.fail(f"expected '{{' after {self.pending['label']}, found {kind}", line)
        name = "_".join(words)
        if not name:
            raise self.fail(f"expected a name after {kind}", line)
        if len(name) > MAX_NAME:
            raise self.fail(
                f"expected a name of at most {MAX_NAME} characters after {kind}, found {len(name)}", line
            )
        if kind == "ROOT":
            self.roots += 1
            if self.roots > 1:
                raise self.fail(f"second ROOT {name!r}; expected one character per file", line)
        elif not self.open:
            raise self.fail(f"JOINT {name!r} is outside the ROOT", line)
        if self.open and self.open[-1]["end"]:
            raise self.fail(f"{kind} {name!r} is inside an End Site", line)
        if name in self.names:
            raise self.fail(
                f"second joint named {name!r} (the first is on line {self.names[name]}); names must differ",
                line,
            )
        self.names[name] = line
        if len(self.names) > MAX_JOINTS:
            raise self.fail(f"more than {MAX_JOINTS} joints", line)
        self._begin_child(f"{kind} {name!r}", line)
        self.pending = {"label": f"{kind} {name}", "end": False, "line": line}
        self.out.append(f"{kind} j{len(self.names) - 1}")

    def end_site(self, line: int) -> None:
        if self.pending is not None or not self.open or self.open[-1]["end"]:
            raise self.fail("an End Site is outside a joint", line)
        self._begin_child("an End Site", line)
        self.pending = {"label": "End Site", "end": True, "line": line}
        self.out.append("End Site")

    def _begin_child(self, child: str, line: int) -> None:
        """Complete the parent, because bvhio needs its OFFSET and CHANNELS before any child."""
        if not self.open:
            return
        parent = self.open[-1]
        if not parent["offset"]:
            raise self.fail(f"{child} comes before the OFFSET of {parent['label']}", line)
        if not parent["channels"]:
            self._write_channels(parent, [])
        parent["children"] = True

    def enter(self, line: int) -> None:
        if self.pending is None:
            raise self.fail("found '{' without a joint before it", line)
        if len(self.open) >= MAX_DEPTH:
            raise self.fail(f"joints nested more than {MAX_DEPTH} levels deep", line)
        self.pending.update(offset=False, channels=False, children=False)
        self.open.append(self.pending)
        self.pending = None
        self.out.append("{")

    def leave(self, line: int) -> None:
        if not self.open:
            raise self.fail("found a '}' too many", line)
        node = self.open.pop()
        if not node["offset"]:
            raise self.fail(f"{node['label']} has no OFFSET", line)
        if not node["end"] and not node["channels"]:
            self._write_channels(node, [])
        self.out.append("}")

    def offset(self, words: list[str], line: int) -> None:
        node = self._node("OFFSET", line)
        if node["offset"]:
            raise self.fail(f"second OFFSET of {node['label']}", line)
        if len(words) != 3:
            raise self.fail(f"expected 3 numbers after OFFSET of {node['label']}, found {len(words)}", line)
        numbers = _floats(self.path, words, line, f"OFFSET of {node['label']}")
        node["offset"] = True
        self.out.append("OFFSET " + " ".join(repr(number) for number in numbers))

    def channel_list(self, words: list[str], line: int) -> None:
        node = self._node("CHANNELS", line)
        if node["end"]:
            raise self.fail("an End Site has no CHANNELS", line)
        if node["children"]:  # the order of the columns would be ambiguous
            raise self.fail(f"CHANNELS of {node['label']} comes after its children", line)
        if node["channels"]:
            raise self.fail(f"second CHANNELS of {node['label']}", line)
        if not words or words[0] != str(len(words) - 1):
            raise self.fail(
                f"expected a count and that many names after CHANNELS of {node['label']}, "
                f"found {' '.join(words)[:60]!r}",
                line,
            )
        names = []
        for word in words[1:]:
            if word.lower() not in CHANNEL_NAMES:
                raise self.fail(f"unknown channel {word[:40]!r} of {node['label']}", line)
            names.append(CHANNEL_NAMES[word.lower()])
        if len(set(names)) != len(names):
            raise self.fail(f"a channel of {node['label']} is listed twice", line)
        if not node["offset"]:
            raise self.fail(f"CHANNELS of {node['label']} comes before its OFFSET", line)
        self._write_channels(node, names)

    def _write_channels(self, node: dict[str, Any], names: list[str]) -> None:
        node["channels"] = True
        self.channels += len(names)
        self.out.append(" ".join(["CHANNELS", str(len(names)), *names]))

    def _node(self, word: str, line: int) -> dict[str, Any]:
        if self.pending is not None:
            raise self.fail(f"expected '{{' after {self.pending['label']}, found {word}", line)
        if not self.open:
            raise self.fail(f"{word} is outside a joint", line)
        return self.open[-1]


def _check_hierarchy(
    path: str | Path, lines: list[str], motion_line: int
) -> tuple[str, tuple[str, ...], int]:
    walk = _HierarchyWalk(path)
    started = False
    for number in range(motion_line):
        line = number + 1
        words = lines[number].replace("{", " { ").replace("}", " } ").split()
        while words:
            word = words[0]
            key = word.upper()
            if key == "HIERARCHY" and not started:
                started, words = True, words[1:]
            elif word == "{":
                walk.enter(line)
                words = words[1:]
            elif word == "}":
                walk.leave(line)
                words = words[1:]
            else:
                brace = next((i for i, w in enumerate(words) if w in "{}"), len(words))
                arguments, words = words[1:brace], words[brace:]
                if key in ("ROOT", "JOINT"):
                    walk.name(key, arguments, line)
                elif key == "END":
                    walk.end_site(line)
                elif key == "OFFSET":
                    walk.offset(arguments, line)
                elif key == "CHANNELS":
                    walk.channel_list(arguments, line)
                else:
                    raise BvhError(
                        path, f"expected ROOT, JOINT, OFFSET, CHANNELS or End Site, found {word[:40]!r}", line
                    )
    if walk.roots == 0:
        raise BvhError(path, "the hierarchy has no ROOT", motion_line + 1)
    if walk.open or walk.pending is not None:
        node = walk.pending or walk.open[-1]
        raise BvhError(path, f"{node['label']} is not closed before MOTION", motion_line + 1)
    if walk.channels == 0:
        raise BvhError(path, "the hierarchy declares no channels", motion_line + 1)
    return "\n".join(walk.out) + "\n", tuple(walk.names), walk.channels


def _check_motion_header(path: str | Path, lines: list[str], motion_line: int) -> tuple[int, float, int]:
    filled = [i for i in range(motion_line + 1, min(len(lines), motion_line + 20)) if lines[i].strip()]
    frames_line = filled[0] if filled else motion_line + 1
    found = FRAMES.fullmatch(_plain(lines[frames_line])) if filled else None
    if found is None:
        raise BvhError(path, "expected 'Frames: COUNT' after MOTION", frames_line + 1)
    if not WHOLE_NUMBER.fullmatch(found[1]):
        raise BvhError(path, f"expected a whole number of frames, found {found[1][:40]!r}", frames_line + 1)
    frames = int(found[1])
    if frames == 0:
        raise BvhError(path, "declares zero frames; the file has no motion", frames_line + 1)
    time_line = filled[1] if len(filled) > 1 else frames_line + 1
    found = FRAME_TIME.fullmatch(_plain(lines[time_line])) if len(filled) > 1 else None
    if found is None:
        raise BvhError(path, "expected 'Frame Time: SECONDS' after the frame count", time_line + 1)
    frame_time = _floats(path, [found[1]], time_line + 1, "the frame time")[0]
    if not SHORTEST_FRAME <= frame_time <= LONGEST_FRAME:
        raise BvhError(
            path,
            f"expected a frame time between {SHORTEST_FRAME:g} and {LONGEST_FRAME:g} seconds, "
            f"found {found[1][:40]}",
            time_line + 1,
        )
    return frames, frame_time, time_line + 1


def _plain(line: str) -> str:
    """The line with single spaces; the patterns could take very long on runs of spaces."""
    return " ".join(line.split())


def _check_duration(path: str | Path, frames: int, frame_time: float, line: int) -> None:
    """Raise BvhError for a recording that would take far more memory at 60 fps than the file itself."""
    longest = longest_seconds(1.0 / frame_time)
    if frames * frame_time > longest * 1.001:  # the margin covers rounded frame times, such as 0.0166667
        raise BvhError(
            path,
            f"{frames} frames of {frame_time:g} s last {frames * frame_time / 3600:.3g} hours, "
            f"expected at most {longest / 3600:g}",
            line,
        )


def _read_rows(
    path: str | Path, lines: list[str], first_row: int, frames: int, channels: int
) -> NDArray[np.float64]:
    rows = [i for i in range(first_row, len(lines)) if lines[i].strip()]
    if len(rows) < frames:
        last = rows[-1] + 1 if rows else first_row
        raise BvhError(path, f"declares {frames} frames but has {len(rows)}; the file is truncated", last)
    if len(rows) > frames:
        raise BvhError(path, f"declares {frames} frames but has {len(rows)}", rows[frames] + 1)
    counts = _words_per_line(lines, rows)
    wrong = np.flatnonzero(counts != channels)
    if wrong.size:
        row = int(wrong[0])
        tail = "; the file is truncated" if row == frames - 1 and counts[row] < channels else ""
        raise BvhError(
            path, f"expected {channels} values in frame {row}, found {int(counts[row])}{tail}", rows[row] + 1
        )
    values = _parse_values(path, lines, rows)
    found = implausible_value(values)
    if found:
        raise BvhError(path, found[1], rows[found[0]] + 1)
    return values


def implausible_value(values: NDArray[np.float64]) -> tuple[int, str] | None:
    """The first frame of a motion block (T, C) with an implausible value, and a message; None if all are plausible."""
    if not values.size or (values.min() >= -MAX_NUMBER and values.max() <= MAX_NUMBER):  # False for NaN
        return None
    row = int(np.flatnonzero(~(np.abs(values) <= MAX_NUMBER).all(axis=1))[0])
    column = int(np.flatnonzero(~(np.abs(values[row]) <= MAX_NUMBER))[0])
    number = values[row, column]
    wanted = f"a number up to {MAX_NUMBER:,.0f}" if np.isfinite(number) else "a finite number"
    return row, f"value {column + 1} of frame {row} is {number:g}, expected {wanted}"


def _words_per_line(lines: list[str], rows: list[int]) -> NDArray[np.int64]:
    """Number of words in each row, counted in bytes, which is far faster than splitting every line."""
    block = "\n".join(lines[i] for i in rows).encode("utf-8", "replace")
    data = np.frombuffer(b"\n" + block, dtype=np.uint8)
    space = data <= 32
    starts = space[:-1] & ~space[1:]
    line_of = np.cumsum(data[:-1] == 10) - 1
    return np.bincount(line_of[starts], minlength=len(rows))


def _parse_values(path: str | Path, lines: list[str], rows: list[int]) -> NDArray[np.float64]:
    try:
        return np.loadtxt((lines[i] for i in rows), dtype=np.float64, ndmin=2, comments=None)
    except ValueError:
        for row, i in enumerate(rows):
            _floats(path, lines[i].split(), i + 1, f"frame {row}")
        raise BvhError(path, "the motion block is not numbers", rows[0] + 1) from None
