"""Motion types of the frames of each file, from a labels.csv or from folder and file names."""

from __future__ import annotations

import csv
import math
import os
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

from motionkit.errors import DatasetError, MotionkitError
from motionkit.files import files_below, read_text
from motionkit.names import nfc
from motionkit.reading import ALL, user_animation
from motionkit.rig.gltf import GltfFile
from motionkit.rig.read_file import ENDINGS, endings_text, holds_motion, is_gltf
from motionkit.rig.read_glb import clip_lengths
from motionkit.rig.sides import other_side

MAX_FRAME = 10**9
MAX_NAME = 100
REQUIRED_COLUMNS = ("file", "start_frame", "end_frame", "type")
SPLITS = ("train", "validation", "test", "")


@dataclass(frozen=True)
class Segment:
    """Frames start to end (exclusive) of one type, at the file's own rate; an end of -1 is the file's end.

    split is "train", "validation", "test" or "" (undecided). fps replaces a wrong rate in the file's header.
    """

    start: int
    end: int
    type: str
    subject: str = ""
    fps: float | None = None
    split: str = ""


BEYOND_END = "labelled up to frame"


def beyond_end(segments: Sequence[Segment], frames: int) -> str:
    """What is wrong with segments that begin or end after a clip's last frame; "" if none does.

    One frame beyond the end is allowed, for tables that count from 1 or include the end frame. More means that the
    table belongs to another clip or frame rate.
    """
    last = max((max(segment.end, segment.start + 1) for segment in segments), default=0)
    return f"{BEYOND_END} {last:,}, but the clip has {frames:,}" if last > frames + 1 else ""


@dataclass(frozen=True)
class SourceFile:
    """A file with its segments; a file without segments is skipped, and skip_reason says why.

    clip is the animation of a .glb or .vrm; name then ends in "#" and that name, unless the file has no other.
    """

    path: Path
    name: str
    segments: tuple[Segment, ...]
    skip_reason: str = ""
    clip: str | None = None


def find_sources(folders: Sequence[Path], labels: Path | None = None) -> tuple[list[SourceFile], Path | None]:
    """All files of motion below the folders with their segments, each once, and the label table if there is one.

    By default a labels.csv in one of the folders or their parents is used. Without a table, the type of a file is
    the name of its folder. For a file directly in a given folder it is the file's name without its number, or the
    animation's, if a file has several. Which of them are taken, motionkit.reading says. A file that the table names
    below the folders, but that is not there, is among those skipped.

    Raises:
        DatasetError: there are no files, or the label table is invalid.
    """
    found: list[tuple[Path, Path]] = []
    for folder in folders:
        if folder.exists() and not folder.is_dir():  # a pipe is refused later, as it is read
            found.append((folder, folder.parent))
            continue
        found.extend((path, folder) for path in files_below(folder, ENDINGS))
    once: dict[str, tuple[Path, Path]] = {}
    for path, folder in found:  # one of the folders may be inside another
        once.setdefault(_key(path), (path, folder))
    found = list(once.values())
    if not found:
        raise DatasetError(f"{', '.join(str(f) for f in folders)}: no {endings_text()} files found")
    table = labels if labels is not None else _nearby_labels(folders)
    if table is None:
        return _distinct([source for path, folder in found for source in _by_name(path, folder)]), None
    return _distinct(_labelled(found, folders, table)), table


def _labelled(found: list[tuple[Path, Path]], folders: Sequence[Path], table: Path) -> list[SourceFile]:
    """Files, each with its folder, by a label table; and those skipped that it names below the folders in vain."""
    rows = read_labels(table)
    paths = _paths(table, rows)
    files = [
        (path, folder, clip, f"#{clip}" if several else "")
        for path, folder in found
        for clip, several in _clips(path)
    ]
    here = {_key(path) + nfc(mark) for path, _, _, mark in files}
    # A row whose path leads nowhere may mean a file of its name elsewhere.
    others = {key: name for key, name in paths.items() if key not in here}
    counts, alike = Counter(map(_base, others.values())), Counter(_base(f[0].name + f[3]) for f in files)
    by_name = {_base(name): rows[name] for name in others.values() if counts[_base(name)] == 1}
    sources = []
    for path, folder, clip, mark in files:
        name = path.relative_to(folder.parent).as_posix() if path.is_relative_to(folder.parent) else path.name
        key, base = _key(path) + nfc(mark), _base(path.name + mark)
        segments, reason = rows[paths[key]] if key in paths else by_name.get(base, []), f"not in {table.name}"
        if segments and key not in paths and alike[base] > 1:
            segments, reason = (
                [],
                f"{table.name} does not tell its folder, but {alike[base]} files have this name",
            )
        sources.append(SourceFile(path, name + mark, tuple(segments), "" if segments else reason, clip))
    roots = tuple(_key(folder) + os.sep for folder in folders)
    for key, name in others.items():
        if _base(name) not in alike and key.startswith(roots):
            whole = "#" in name and _key(table.parent / name.partition("#")[0]) in here
            reason = f"in {table.name}, but there is no such file"
            reason = "animations have types of their own only with --clip all" if whole else reason
            sources.append(SourceFile(table.parent / name, name, (), reason))
    return sources


def _base(name: str) -> str:
    """The file name in a path, with its animation if one is named, for comparison."""
    return nfc(Path(name).name).lower()


def _distinct(sources: list[SourceFile]) -> list[SourceFile]:
    """The files; those of one name below several folders are named from where their paths part."""
    counts = Counter(source.name for source in sources)
    alike = [_key(source.path) for source in sources if counts[source.name] > 1]
    if not alike:
        return sources
    part = os.path.commonpath(alike)

    def renamed(source: SourceFile) -> SourceFile:
        if counts[source.name] == 1:
            return source
        mark = f"#{source.clip}" if source.name.endswith(f"#{source.clip}") else ""
        return replace(source, name=Path(os.path.relpath(_key(source.path), part)).as_posix() + mark)

    return list(map(renamed, sources))


def _clips(path: Path) -> list[tuple[str | None, bool]]:
    """The animations of a file to read, None for its only one; and whether the file is read more than once.

    There is none in a character without animations, or an archive without motion. A file that cannot be read is left to
    whoever reads it.
    """
    if not is_gltf(path):
        return [(None, False)] if holds_motion(path) else []
    try:
        names = [name for name, _ in clip_lengths(GltfFile(path))]
    except MotionkitError:
        return [(None, False)]
    several = len(names) > 1 and user_animation() == ALL
    return [(name if several else None, several) for name in (names if several else names[:1])]


def _paths(table: Path, rows: Iterable[str]) -> dict[str, str]:
    """The name in each row by its path; raises DatasetError if the table has one file under two names."""
    names: dict[str, str] = {}
    for name in rows:
        other = names.setdefault(_key(table.parent / name), name)
        if other != name:
            raise DatasetError(f"{table}: {other} and {name} are the same file, expected one name for it")
    return names


def _key(path: Path) -> str:
    """The path in NFC with links resolved; unresolved if the system cannot, as for a name that is too long."""
    try:
        return nfc(str(path.resolve()))
    except (OSError, RuntimeError):  # before Python 3.13 a loop of links is a RuntimeError
        return nfc(str(path))


def _nearby_labels(folders: Sequence[Path]) -> Path | None:
    found: dict[str, Path] = {}
    for folder in folders:
        base = folder if folder.is_dir() else folder.parent
        places = (place / "labels.csv" for place in (base, base.resolve().parent))
        if table := next((place for place in places if place.is_file()), None):
            found.setdefault(_key(table), table)
    if len(found) > 1:
        raise DatasetError(
            f"{' and '.join(map(str, found.values()))}: expected one table; give it with --labels"
        )
    return next(iter(found.values()), None)


def _by_name(path: Path, folder: Path) -> list[SourceFile]:
    """A file, or each of its animations, with the type that its names give."""
    inside, found = path.relative_to(folder), []
    for clip, several in _clips(path):
        kind = nfc(inside.parent.name or type_from_file_name(clip if clip and several else path.stem))
        fault = type_fault(kind)
        if fault:
            raise DatasetError(f"{path}: the folder or file name gives the motion type {fault}; rename it")
        name = inside.as_posix() + (f"#{clip}" if several else "")
        found.append(SourceFile(path, name, (Segment(0, -1, kind),), clip=clip))
    reason = "has no animation" if is_gltf(path) else "has no motion"
    return found or [SourceFile(path, inside.as_posix(), (), reason)]


def type_from_file_name(stem: str) -> str:
    """The motion type that a file name means: "Walk_Fast-02" gives "walk-fast"."""
    words = [word for word in re.split(r"[\s_\-.,:;]+", stem) if word]
    words = [re.sub(r"\d+$", "", word) for word in words]
    return "-".join(word.lower() for word in words if word) or "motion"


def type_fault(kind: str) -> str:
    """Why a motion type cannot have this name; "" if it can.

    Commands take types as running:4,cartwheel:3, so a name must not contain ':' or ','.
    """
    marks = [mark for mark in ",:" if mark in kind]
    if marks:
        return f"{kind[:40]!r}, which contains {' and '.join(map(repr, marks))}"
    return _name_fault(kind)


def _name_fault(name: str) -> str:
    if not name.strip() or name != name.strip():
        return f"{name[:40]!r}, which is empty or has spaces around it"
    if len(name) > MAX_NAME:
        return f"{name[:40]!r}..., which has {len(name)} characters, expected at most {MAX_NAME}"
    # isprintable() is False for the surrogates of undecodable bytes too.
    return "" if name.isprintable() else f"{name[:40]!r}, which has unprintable characters"


def read_labels(path: Path) -> dict[str, list[Segment]]:
    """Segments by file name, as the label table spells it, sorted by start.

    Raises:
        DatasetError: columns are missing, a value is invalid, or segments overlap; the message names the line.
    """
    text = read_text(path, "a label table", DatasetError)
    reader = csv.DictReader(text.splitlines())
    if reader.fieldnames:
        reader.fieldnames = [name.strip().lower() for name in reader.fieldnames]
    found: dict[str, list[tuple[Segment, int]]] = {}
    try:
        missing = [name for name in REQUIRED_COLUMNS if name not in (reader.fieldnames or [])]
        if missing:
            semicolons = "; its columns are to be separated by commas" if ";" in text.split("\n")[0] else ""
            raise DatasetError(
                f"{path}:1: the label table lacks the columns {', '.join(missing)}{semicolons}"
            )
        for row in reader:
            name = (row["file"] or "").strip()
            more = [
                text for text in row.get(None, []) if text.strip()
            ]  # beyond the columns of the first line
            if more:
                raise DatasetError(
                    f"{path}:{reader.line_num}: expected {len(reader.fieldnames or [])} values, found "
                    f"{more[0].strip()[:40]!r} after them; a value with a comma needs quotation marks"
                )
            if not name:
                raise DatasetError(f"{path}:{reader.line_num}: expected a file name, found none")
            if not name.isprintable():
                raise DatasetError(f"{path}:{reader.line_num}: expected a file name, found {name[:40]!r}")
            segment = _segment(path, reader.line_num, row)
            found.setdefault(name, []).append((segment, reader.line_num))
    except csv.Error as error:
        raise DatasetError(f"{path}:{reader.line_num + 1}: not a table row ({error})") from None
    for name, entries in found.items():
        rates = {segment.fps: line for segment, line in reversed(entries) if segment.fps}
        if len(rates) > 1:
            words = " and ".join(f"{rate:g}" for rate in sorted(rates))
            raise DatasetError(f"{path}:{max(rates.values())}: expected one fps for {name}, found {words}")
        entries.sort(key=lambda entry: entry[0].start)
        for (a, line_a), (b, line_b) in pairwise(entries):
            if a.end == -1 or a.end > b.start:
                line = max(line_a, line_b)
                raise DatasetError(f"{path}:{line}: segments of {name} overlap at frame {b.start}")
    return {name: [segment for segment, _ in entries] for name, entries in found.items()}


def _segment(path: Path, line: int, row: dict[str, str]) -> Segment:
    def number(key: str) -> float | None:
        word = (row.get(key) or "").strip()
        if not word:
            return None
        try:
            value = float(word.replace("_", "?"))  # float("1_0") would be 10
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise DatasetError(f"{path}:{line}: expected a number for {key}, found {word[:40]!r}")
        return value

    def frame(key: str) -> int | None:
        value = number(key)
        if value is not None and not (abs(value) <= MAX_FRAME and value == int(value)):
            raise DatasetError(
                f"{path}:{line}: expected a whole number up to {MAX_FRAME:,} for {key}, found {row[key][:40]!r}"
            )
        return None if value is None else int(value)

    start, end, fps = frame("start_frame"), frame("end_frame"), number("fps")
    kind = nfc((row["type"] or "").strip())
    split = (row.get("split") or "").strip().lower()
    if not kind:
        raise DatasetError(f"{path}:{line}: expected a motion type, found none")
    if type_fault(kind):
        raise DatasetError(f"{path}:{line}: expected a motion type, found {type_fault(kind)}")
    if split not in SPLITS:
        raise DatasetError(
            f"{path}:{line}: expected train, validation, test or nothing for split, found {split[:40]!r}"
        )
    first, last = start or 0, -1 if end is None else end
    if first < 0 or (last != -1 and last <= first):
        raise DatasetError(f"{path}:{line}: expected start_frame < end_frame, found {first} and {last}")
    if fps is not None and not 1 <= fps <= 1000:
        raise DatasetError(f"{path}:{line}: expected fps between 1 and 1000, found {fps:g}")
    subject = nfc((row.get("subject") or "").strip())
    if subject and _name_fault(subject):
        raise DatasetError(f"{path}:{line}: expected a subject, found {_name_fault(subject)}")
    return Segment(first, last, kind, subject, fps, split)


def mirrored_type(kind: str) -> str:
    """The type of a mirrored motion: jumping-l becomes jumping-r, kickL becomes kickR, walking stays walking."""
    words = re.split(r"([\s_\-.]+|(?<=[a-z])(?=[A-Z])|(?=[左右])|(?<=[左右]))", kind)
    return "".join(other_side(word) for word in words)
