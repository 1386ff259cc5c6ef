"""Checks the text of a BVH file before it is parsed, so that every error has a line number.

It checks the grammar of the hierarchy without recursion, rewrites the hierarchy in normal form, and reads the motion
block (bvh_rows.py). The output is safe to pass to bvhio and numpy. Faults that do not hide what was meant are repaired
and noted, unless files are read strictly (reading.py).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motionkit.errors import BvhError, MotionkitError
from motionkit.files import check_regular, read_bytes
from motionkit.free_memory import check_memory, check_text
from motionkit.motion.bvh_rows import Notes, floats, read_rows
from motionkit.motion.frame_rate import EXACT_WITHIN, rate_within
from motionkit.motion.motion import longest_seconds
from motionkit.reading import report_notes

MAX_BYTES = 512 * 2**20
MAX_DEPTH = 200
MAX_JOINTS = 2000
MAX_NAME = 200
SHORTEST_FRAME, LONGEST_FRAME = 1e-4, 1.0  # seconds
POSE_FRAME = 1 / 30  # seconds, frame time of a file without motion
CHANNEL_NAMES = {
    f"{axis}{kind}".lower(): f"{axis}{kind}" for axis in "XYZ" for kind in ("position", "rotation")
}
SCALES = tuple(f"{axis}scale" for axis in "xyz")
COMMENTS = ("#", "//")
FRAMES = re.compile(r"frames ?:? ?(.+)", re.IGNORECASE)
FRAME_TIME = re.compile(r"frame time ?:? ?([^ ]+)", re.IGNORECASE)
WHOLE_NUMBER = re.compile(r"[0-9]{1,9}")


@dataclass(frozen=True)
class BvhText:
    """A checked file: a normalised header for bvhio, and the motion block as numbers.

    The header calls the joints j0, j1, ... in file order, because unusual names (with spaces, in Latin-1) may confuse
    the parser; `names` holds the real names. `hierarchy` is the unchanged text of the hierarchy section, None if
    something had to be repaired in it.
    """

    header: str
    names: tuple[str, ...]
    frame_time: float
    values: NDArray[np.float64]
    hierarchy: str | None
    rate_within: float


@dataclass
class _Tree:
    """One root with its joints.

    Attributes:
        out: its normalised text.
        names: the joints, and the line of each.
        columns: (channel, value in the rest pose) of each column of the motion block.
    """

    out: list[str] = field(default_factory=lambda: ["HIERARCHY"])
    names: dict[str, int] = field(default_factory=dict)
    columns: list[tuple[str, float]] = field(default_factory=list)


def read_bvh_text(path: str | Path) -> BvhText:
    """Read and check a BVH file; raises BvhError with the line of the first error."""
    notes = Notes(path)
    lines = _read_lines(path, notes)
    motion_line = _find_motion(path, lines, notes)
    trees = _check_hierarchy(path, lines, motion_line, notes)
    hierarchy = None if notes.lines else "\n".join(lines[:motion_line]) + "\n"
    columns = [column for tree in trees for column in tree.columns]
    frames, frame_time, within, first_row = _check_motion_header(path, lines, motion_line, notes)
    try:
        # A root that moves has two triples of channels; rows end with the last line, which may be empty.
        rows = len(lines) - first_row - (not lines[-1].strip())
        check_memory(rows, max(1, (len(columns) - 3) // 3), 1.0 / frame_time)
    except MotionkitError as error:
        raise BvhError(path, str(error), first_row) from None
    values = read_rows(lines, first_row, frames, [name for name, _ in columns], notes)
    if not len(values):
        values = np.array([[rest for _, rest in columns]])
    check_duration(path, len(values), frame_time, first_row)
    tree = max(trees, key=lambda tree: len(tree.names))
    kept = [chosen is tree and name.lower() not in SCALES for chosen in trees for name, _ in chosen.columns]
    report_notes(path, notes.lines)
    header = "\n".join(tree.out) + f"\nMOTION\nFrames: {len(values)}\nFrame Time: {frame_time!r}\n"
    values = values if all(kept) else values[:, kept]
    return BvhText(header, tuple(tree.names), frame_time, values, hierarchy, within)


def _read_lines(path: str | Path, notes: Notes) -> list[str]:
    """The lines of a file; those that are comments become empty, so that the others keep their numbers."""
    text = _decode(path, _read_bytes(path))
    lines = text.split("\n")
    if notes.strict or not any(mark in text for mark in COMMENTS):
        return lines
    kept = ["" if line.lstrip().startswith(COMMENTS) else line for line in lines]
    removed = sum(line != old for line, old in zip(kept, lines, strict=True))
    if removed:
        notes.repaired("comment line", "left out", "", 1, removed)
    if not any(line.strip() for line in kept):
        raise BvhError(path, "is empty, expected a BVH file that starts with HIERARCHY", 1)
    return kept


def _read_bytes(path: str | Path) -> bytes:
    try:
        check_text(check_regular(path, MAX_BYTES, "a BVH file"))
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


def _find_motion(path: str | Path, lines: list[str], notes: Notes) -> int:
    first = next(i for i, line in enumerate(lines) if line.strip())
    if lines[first].split()[0].upper() != "HIERARCHY":
        found = lines[first].strip()[:40]
        raise BvhError(path, f"expected HIERARCHY, found {found!r}", first + 1)
    for number, line in enumerate(lines):
        if line.strip().upper() == "MOTION":
            return number
    if notes.strict:
        raise BvhError(path, "the file ends before its MOTION section", len(lines))
    return len(lines)


class _HierarchyWalk:
    """Checks the tokens of a hierarchy with an explicit stack and collects the normalised text."""

    def __init__(self, path: str | Path, notes: Notes) -> None:
        self.path = path
        self.notes = notes
        self.trees: list[_Tree] = []
        self.open: list[dict[str, Any]] = []  # joints and end sites not yet closed
        self.pending: dict[str, Any] | None = None  # a joint or end site before its opening bracket

    @property
    def out(self) -> list[str]:
        return self.trees[-1].out

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
            if self.trees and (self.open or self.notes.strict):
                raise self.fail(f"second ROOT {name!r}; expected one character per file", line)
            self.trees.append(_Tree())
        elif not self.open:
            raise self.fail(f"JOINT {name!r} is outside the ROOT", line)
        if self.open and self.open[-1]["end"]:
            raise self.fail(f"{kind} {name!r} is inside an End Site", line)
        names = self.trees[-1].names
        if name in names:
            raise self.fail(
                f"second joint named {name!r} (the first is on line {names[name]}); names must differ", line
            )
        names[name] = line
        if sum(len(tree.names) for tree in self.trees) > MAX_JOINTS:
            raise self.fail(f"more than {MAX_JOINTS} joints", line)
        self._begin_child(f"{kind} {name!r}", line)
        self.pending = {"label": f"{kind} {name}", "end": False, "line": line}
        self.out.append(f"{kind} j{len(names) - 1}")

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
        if parent["offset"] is None:
            raise self.fail(f"{child} comes before the OFFSET of {parent['label']}", line)
        if not parent["channels"]:
            self._write_channels(parent, [])
        parent["children"] = True

    def enter(self, line: int) -> None:
        if self.pending is None:
            raise self.fail("found '{' without a joint before it", line)
        if len(self.open) >= MAX_DEPTH:
            raise self.fail(f"joints nested more than {MAX_DEPTH} levels deep", line)
        self.pending.update(offset=None, channels=False, children=False)
        self.open.append(self.pending)
        self.pending = None
        self.out.append("{")

    def leave(self, line: int) -> None:
        if not self.open:
            raise self.fail("found a '}' too many", line)
        node = self.open.pop()
        if node["offset"] is None:
            raise self.fail(f"{node['label']} has no OFFSET", line)
        if not node["end"] and not node["channels"]:
            self._write_channels(node, [])
        self.out.append("}")

    def offset(self, words: list[str], line: int) -> None:
        node = self._node("OFFSET", line)
        if node["offset"] is not None:
            raise self.fail(f"second OFFSET of {node['label']}", line)
        if len(words) != 3:
            fault = f"expected 3 numbers after OFFSET of {node['label']}, found {len(words)}"
            if len(words) != 6:
                raise self.fail(fault, line)
            self.notes.repaired("OFFSET", "of six numbers cut to the first three", fault, line)
        numbers = floats(words, line, f"OFFSET of {node['label']}", self.notes)[:3]
        node["offset"] = numbers
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
                fault = f"unknown channel {word[:40]!r} of {node['label']}"
                if word.lower() not in SCALES:
                    raise self.fail(fault, line)
                self.notes.repaired("scale channel", "left out", fault, line)
            names.append(CHANNEL_NAMES.get(word.lower(), word.lower()))
        if len(set(names)) != len(names):
            raise self.fail(f"a channel of {node['label']} is listed twice", line)
        if node["offset"] is None:
            raise self.fail(f"CHANNELS of {node['label']} comes before its OFFSET", line)
        self._write_channels(node, names)

    def _write_channels(self, node: dict[str, Any], names: list[str]) -> None:
        node["channels"] = True
        rests = dict(zip((f"{axis}position" for axis in "XYZ"), node["offset"], strict=True))
        self.trees[-1].columns += [(name, 1.0 if name in SCALES else rests.get(name, 0.0)) for name in names]
        kept = [name for name in names if name not in SCALES]
        self.out.append(" ".join(["CHANNELS", str(len(kept)), *kept]))

    def _node(self, word: str, line: int) -> dict[str, Any]:
        if self.pending is not None:
            raise self.fail(f"expected '{{' after {self.pending['label']}, found {word}", line)
        if not self.open:
            raise self.fail(f"{word} is outside a joint", line)
        return self.open[-1]


def _check_hierarchy(path: str | Path, lines: list[str], motion_line: int, notes: Notes) -> list[_Tree]:
    """The trees of a hierarchy; several roots are noted."""
    walk = _HierarchyWalk(path, notes)
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
    if not walk.trees:
        raise BvhError(path, "the hierarchy has no ROOT", motion_line + 1)
    if walk.open or walk.pending is not None:
        node = walk.pending or walk.open[-1]
        raise BvhError(path, f"{node['label']} is not closed before MOTION", motion_line + 1)
    largest = max(walk.trees, key=lambda tree: len(tree.names))
    if not any(name not in SCALES for name, _ in largest.columns):
        raise BvhError(path, "the hierarchy declares no channels", motion_line + 1)
    for tree in walk.trees:
        if tree is not largest:
            root = next(iter(tree.names))
            notes.repaired("joint", f"of the other root {root[:40]} left out", "", 1, len(tree.names))
    return walk.trees


def _check_motion_header(
    path: str | Path, lines: list[str], motion_line: int, notes: Notes
) -> tuple[int, float, float, int]:
    """Declared frames, frame time, the rate_within of its digits, and the line after all."""
    if motion_line >= len(lines):
        notes.repaired("frame", "of the rest pose, because the file has no motion", "", motion_line)
        return 0, POSE_FRAME, EXACT_WITHIN, motion_line
    filled = [i for i in range(motion_line + 1, min(len(lines), motion_line + 20)) if lines[i].strip()]
    frames_line = filled[0] if filled else motion_line + 1
    found = FRAMES.fullmatch(_plain(lines[frames_line])) if filled else None
    if found is None:
        raise BvhError(path, "expected 'Frames: COUNT' after MOTION", frames_line + 1)
    if not WHOLE_NUMBER.fullmatch(found[1]):
        raise BvhError(path, f"expected a whole number of frames, found {found[1][:40]!r}", frames_line + 1)
    frames = int(found[1])
    if frames == 0 and notes.strict:
        raise BvhError(path, "declares zero frames; the file has no motion", frames_line + 1)
    time_line = filled[1] if len(filled) > 1 else frames_line + 1
    found = FRAME_TIME.fullmatch(_plain(lines[time_line])) if len(filled) > 1 else None
    if found is None:
        raise BvhError(path, "expected 'Frame Time: SECONDS' after the frame count", time_line + 1)
    frame_time = floats([found[1]], time_line + 1, "the frame time", notes)[0]
    if not SHORTEST_FRAME <= frame_time <= LONGEST_FRAME:
        raise BvhError(
            path,
            f"expected a frame time between {SHORTEST_FRAME:g} and {LONGEST_FRAME:g} seconds, "
            f"found {found[1][:40]}",
            time_line + 1,
        )
    return frames, frame_time, rate_within(found[1]), time_line + 1


def _plain(line: str) -> str:
    """The line with single spaces; the patterns could take very long on runs of spaces."""
    return " ".join(line.split())


def check_duration(path: str | Path, frames: int, frame_time: float, line: int | None) -> None:
    """Raise BvhError for a recording that would take far more memory at 60 fps than the file itself."""
    longest = longest_seconds(1.0 / frame_time)
    if frames * frame_time > longest * 1.001:  # the margin covers rounded frame times, such as 0.0166667
        raise BvhError(
            path,
            f"{frames} frames of {frame_time:g} s last {frames * frame_time / 3600:.3g} hours, "
            f"expected at most {longest / 3600:g}",
            line,
        )
